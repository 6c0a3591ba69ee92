//! Numbers that both f32 engines follow (docs/MODEL.md). The build script compiles this file as well and generates the
//! shaders' constants from it (`build/generated.rs`).

/// Side of a tile, pixels.
pub const TILE: usize = 16;

/// Nearest camera depth that is drawn, world units.
pub const NEAR: f32 = 0.05;
/// Farthest camera depth that is drawn: its cube is still finite in f32.
pub const FAR: f32 = 1e12;
/// Farthest a projected mean may lie from the image's corner, pixels.
pub const MAX_PIXEL_DISTANCE: f32 = 1e12;
/// Largest variance of a splat on screen, px^2: its square is still finite in f32.
pub const MAX_SCREEN_VARIANCE: f32 = 1e18;
/// Determinants of screen covariances up to this count as 0, px^4.
pub const MIN_DETERMINANT: f32 = 1e-12;
/// Limit of the absolute ln of a standard deviation.
pub const LOG_SCALE_LIMIT: f32 = 60.0;
/// Alpha below this is treated as nothing.
pub const ALPHA_MIN: f32 = 1.0 / 255.0;
/// Alpha is capped here.
pub const ALPHA_MAX: f32 = 0.99;
/// A pixel whose transmittance is below this may be left; the weight missed is less than this in all.
pub const TRANSMITTANCE_STOP: f32 = 1e-4;

/// When blending leaves a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EarlyStop {
    /// Once its transmittance is below [`TRANSMITTANCE_STOP`].
    WhenSaturated,
    /// Never.
    Never,
}

/// Pixels of less coverage are not shaded.
pub const MIN_COVERAGE: f32 = 1e-3;
/// Least n . v of the specular term.
pub const MIN_NOV: f32 = 1e-4;

/// No Gaussian hides the direction of a probe.
pub const NO_HIT: u32 = u32::MAX;
/// Transmittance towards a direction below this is none.
pub const MIN_TRANSMITTANCE: f32 = 1e-3;
/// A variance beyond this is no occluder, world units^2.
pub const MAX_OCCLUDER_VARIANCE: f32 = 1e12;
/// Depth of a ray's tree of boxes over 2^32 Gaussians, and one more.
pub const TREE_DEPTH: usize = 34;
/// Blocked share of a direction below which nothing is gathered from it.
pub const MIN_BLOCKED_SHARE: f32 = 0.02;

/// Largest relative distance of a depth on a Gaussian's plane from its centre's depth; beyond, the plane is seen edge-on.
pub const MAX_PLANE_DEPTH_ERROR: f32 = 0.05;
/// Largest relative distance of the depth of a pixel's mean plane from that of the Gaussian it sees; beyond, the pixel mixes
/// surfaces.
pub const MAX_MEAN_DEPTH_ERROR: f32 = 0.02;
/// Queries towards small lights start this far from the surface, world units: the planes of neighbours lie a little before and
/// behind it.
pub const LIFT: f32 = 0.005;
/// Places within a pixel from which a small light is looked for, pixels from its centre.
pub const SHADOW_SAMPLE_OFFSETS: [[f32; 2]; 4] =
    [[-0.125, -0.375], [0.375, -0.125], [-0.375, 0.125], [0.125, 0.375]];

/// Decay of Adam's first moment (Kingma and Ba 2015).
pub const ADAM_BETA1: f32 = 0.9;
/// Decay of Adam's second moment.
pub const ADAM_BETA2: f32 = 0.999;
/// What Adam adds to the root of the second moment.
pub const ADAM_EPSILON: f32 = 1e-15;

/// Clamp of `Q` and of `1 - p` in the aggregation term (Eq. 24).
pub const AGGREGATION_EPSILON: f32 = 1e-6;
/// Gaussians with less summed weight in a view get no backward label from it.
pub const MIN_LABEL_WEIGHT: f32 = 1e-3;
/// Visibility is kept this far from 0 and 1 inside the logarithms of the label term (Eq. 15).
pub const LABEL_MARGIN: f32 = 1e-3;
/// The same for a visibility that is a sigmoid.
pub const SIGMOID_MARGIN: f32 = 1e-6;

/// Coverage below which the depth of a pixel's plane is not trusted.
pub const TRUSTED_COVERAGE: f32 = 0.5;
/// Neighbouring depths further apart than this fraction are an edge, not a surface.
pub const MAX_DEPTH_STEP: f32 = 0.05;

/// Factor of a halved Gaussian's standard deviation along the axis of the split.
pub const HALF_SCALE_ALONG: f32 = 0.55;
/// Factor across that axis.
pub const HALF_SCALE_ACROSS: f32 = 0.9;
/// A half's transmittance is the whole's to this power.
pub const HALF_OPACITY_EXPONENT: f32 = 0.7;

/// Taps of the window of structural similarity (Wang et al. 2004).
pub const SSIM_TAPS: usize = 11;
/// Its constant next to means.
pub const SSIM_C1: f32 = 0.01 * 0.01;
/// Its constant next to variances.
pub const SSIM_C2: f32 = 0.03 * 0.03;

/// The window: `exp(-(i - 5)^2 / (2 1.5^2))`, normalised.
pub fn ssim_window() -> [f32; SSIM_TAPS] {
    let raw: [f64; SSIM_TAPS] = std::array::from_fn(|i| (-(i as f64 - 5.0).powi(2) / 4.5).exp());
    let total: f64 = raw.iter().sum();
    raw.map(|v| (v / total) as f32)
}
