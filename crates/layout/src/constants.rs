//! Constants of both f32 engines (docs/MODEL.md). The build script of `relume-engine` generates the shaders' constants from
//! them (`build/generated.rs`).

/// Side of a tile, pixels.
pub const TILE: usize = 16;

/// Nearest camera depth that is drawn, world units.
pub const NEAR: f32 = 0.05;
/// Farthest camera depth that is drawn, world units: its cube is still finite in f32.
pub const FAR: f32 = 1e12;
/// Largest distance of a projected mean from the image's corner, pixels.
pub const MAX_PIXEL_DISTANCE: f32 = 1e12;
/// Largest variance of a splat on screen, px^2: its square is still finite in f32.
pub const MAX_SCREEN_VARIANCE: f32 = 1e18;
/// Width of the low-pass of a Gaussian that a frame enlarges: its share of the low-pass of the photograph that shows the Gaussian
/// largest. 1 is the Gaussian as that photograph shows it; the kernel of bicubic enlargement is narrower, too.
pub const ENLARGED_LOW_PASS: f32 = 0.7;
/// Largest factor by which the low-pass of a Gaussian widens with the enlargement over its photographs: its square times the
/// largest low-pass stays far below the largest f32.
pub const MAX_ENLARGEMENT: f32 = 1e6;
/// Determinants of screen covariances up to this count as 0, px^4.
pub const MIN_DETERMINANT: f32 = 1e-12;
/// Limit of the absolute ln of a standard deviation.
pub const LOG_SCALE_LIMIT: f32 = 60.0;
/// Smaller alphas count as 0.
pub const ALPHA_MIN: f32 = 1.0 / 255.0;
/// Largest alpha; larger ones are clamped to it.
pub const ALPHA_MAX: f32 = 0.99;
/// Blending may stop at a pixel whose transmittance is below this. The missed weights sum to less than this.
pub const TRANSMITTANCE_STOP: f32 = 1e-4;

/// When blending stops at a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EarlyStop {
    /// Once its transmittance is below [`TRANSMITTANCE_STOP`].
    WhenSaturated,
    /// Never.
    Never,
}

/// Pixels with less coverage are not shaded.
pub const MIN_COVERAGE: f32 = 1e-3;
/// Smallest `n . v` in the specular term.
pub const MIN_NOV: f32 = 1e-4;

/// Index that means: no Gaussian hides the direction of a probe.
pub const NO_HIT: u32 = u32::MAX;
/// A smaller transmittance towards a direction counts as 0.
pub const MIN_TRANSMITTANCE: f32 = 1e-3;
/// A Gaussian with a larger variance is no occluder, world units^2.
pub const MAX_OCCLUDER_VARIANCE: f32 = 1e12;
/// Depth of the bounding-volume tree over 2^32 Gaussians, plus one.
pub const TREE_DEPTH: usize = 34;
/// Smallest blocked share of a direction from which light is gathered.
pub const MIN_BLOCKED_SHARE: f32 = 0.02;

/// Level of [`SPECULAR_LEVELS`](crate::light::SPECULAR_LEVELS) that has the radiance around a direction of a probe.
pub const SKY_SHADOW_LEVEL: usize = 1;

/// Largest relative difference between a depth on a Gaussian's plane and its centre's depth. Beyond it the camera sees the
/// plane edge-on.
pub const MAX_PLANE_DEPTH_ERROR: f32 = 0.05;
/// Largest relative difference between the depth of a pixel's mean plane and that of the Gaussian it sees. Beyond it the
/// pixel mixes several surfaces.
pub const MAX_MEAN_DEPTH_ERROR: f32 = 0.02;
/// Distance from the surface at which rays towards small lights start, world units: the planes of neighbours lie slightly in
/// front of the surface and behind it.
pub const LIFT: f32 = 0.005;
/// Start points, within a pixel, of rays towards small lights, pixels from its centre.
pub const SHADOW_SAMPLE_OFFSETS: [[f32; 2]; 4] =
    [[-0.125, -0.375], [0.375, -0.125], [-0.375, 0.125], [0.125, 0.375]];

/// Decay of Adam's first moment (Kingma and Ba 2015).
pub const ADAM_BETA1: f32 = 0.9;
/// Decay of Adam's second moment.
pub const ADAM_BETA2: f32 = 0.999;
/// Adam's addend to the root of the second moment.
pub const ADAM_EPSILON: f32 = 1e-15;

/// Clamp of `Q` and of `1 - p` in the aggregation term (Eq. 24).
pub const AGGREGATION_EPSILON: f32 = 1e-6;
/// A Gaussian with a smaller summed weight in a view gets no backward label from that view.
pub const MIN_LABEL_WEIGHT: f32 = 1e-3;
/// Margin by which visibility is clamped away from 0 and 1 in the logarithms of the label term (Eq. 15).
pub const LABEL_MARGIN: f32 = 1e-3;
/// The same margin for a visibility that is a sigmoid.
pub const SIGMOID_MARGIN: f32 = 1e-6;

/// Smallest coverage at which the depth of a pixel's plane is used.
pub const TRUSTED_COVERAGE: f32 = 0.5;
/// Largest relative difference of neighbouring depths on one surface; a larger one is an edge.
pub const MAX_DEPTH_STEP: f32 = 0.05;

/// Factor of a halved Gaussian's standard deviation along the axis of the split.
pub const HALF_SCALE_ALONG: f32 = 0.55;
/// Factor of the standard deviations across that axis.
pub const HALF_SCALE_ACROSS: f32 = 0.9;
/// The transmittance of a half is that of the whole Gaussian to this power.
pub const HALF_OPACITY_EXPONENT: f32 = 0.7;

/// Taps of the SSIM window (Wang et al. 2004).
pub const SSIM_TAPS: usize = 11;
/// SSIM's constant `C1`, added to the terms of means.
pub const SSIM_C1: f32 = 0.01 * 0.01;
/// SSIM's constant `C2`, added to the terms of variances.
pub const SSIM_C2: f32 = 0.03 * 0.03;

/// The SSIM window: `exp(-(i - 5)^2 / (2 1.5^2))`, normalised.
pub fn ssim_window() -> [f32; SSIM_TAPS] {
    let raw: [f64; SSIM_TAPS] = std::array::from_fn(|i| (-(i as f64 - 5.0).powi(2) / 4.5).exp());
    let total: f64 = raw.iter().sum();
    raw.map(|v| (v / total) as f32)
}
