//! A camera for the engines' f32 kernels.

use relume_layout::constants::{ENLARGED_LOW_PASS, MAX_ENLARGEMENT};
use relume_scene::{Camera, ShadingOptions};

/// A camera in f32, with the projection options.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RasterCamera {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Focal lengths, pixels.
    pub focal: [f32; 2],
    /// Principal point, pixels.
    pub centre_px: [f32; 2],
    /// World-to-camera rotation, row-major.
    pub rotation: [[f32; 3]; 3],
    /// World-to-camera translation.
    pub translation: [f32; 3],
    /// Camera centre, world.
    pub centre: [f32; 3],
    /// Limits of x/z and y/z inside the projection's Jacobian.
    pub ratio_limits: [[f32; 2]; 2],
    /// Screen-space low-pass, px^2.
    pub low_pass: f32,
    /// True where the opacity compensates for the low-pass.
    pub low_pass_compensation: bool,
}

impl RasterCamera {
    /// The f32 form of `camera`.
    pub fn new(camera: &Camera, options: &ShadingOptions) -> Self {
        let r = camera.rotation;
        let limits = |size: u32, c: f64, f: f64| {
            let w = f64::from(size);
            [(-c / f - 0.15 * w / f) as f32, ((w - c) / f + 0.15 * w / f) as f32]
        };
        Self {
            width: camera.width as usize,
            height: camera.height as usize,
            focal: [camera.fx as f32, camera.fy as f32],
            centre_px: [camera.cx as f32, camera.cy as f32],
            rotation: std::array::from_fn(|k| r.row(k).to_array().map(|v| v as f32)),
            translation: camera.translation.to_array().map(|v| v as f32),
            centre: camera.centre().to_array().map(|v| v as f32),
            ratio_limits: [
                limits(camera.width, camera.cx, camera.fx),
                limits(camera.height, camera.cy, camera.fy),
            ],
            low_pass: options.low_pass,
            low_pass_compensation: options.low_pass_compensation,
        }
    }

    /// Low-pass of a Gaussian at `depth`, px^2: 0.7 of that of the photograph that shows it largest, with `sampling_rate` pixels per unit of
    /// length, where this camera shows it larger (docs/MODEL.md, section 2). A rate of 0 is unknown; projection omits negative ones.
    #[inline]
    pub fn low_pass_of(&self, depth: f32, sampling_rate: f32) -> f32 {
        if !(sampling_rate > 0.0) {
            return self.low_pass;
        }
        let enlargement = (self.focal[0] * self.focal[1]).sqrt() / (depth * sampling_rate);
        let enlargement = enlargement.min(MAX_ENLARGEMENT);
        self.low_pass * (ENLARGED_LOW_PASS * enlargement * enlargement).max(1.0)
    }

    /// Camera coordinates of a world point: `R x + t`. Models lie around the origin, so for a far-away camera this form keeps
    /// the digits of `x` that `R (x - centre)` would lose.
    #[inline]
    pub fn to_camera(&self, x: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|k| (0..3).map(|c| self.rotation[k][c] * x[c]).sum::<f32>() + self.translation[k])
    }

    /// Key that orders world points by depth: the bits of `r_3 . x`, the part of depth that differs between points. For a
    /// far-away camera the depths of a model differ in their last digits only; this part keeps all digits.
    #[inline]
    pub fn depth_key(&self, x: [f32; 3]) -> u32 {
        let along: f32 = (0..3).map(|c| self.rotation[2][c] * x[c]).sum();
        // Adding zero turns -0 into 0. Positive floats then have the order of their bits, negative ones the reverse order.
        let bits = (along + 0.0).to_bits();
        if bits >> 31 == 0 { bits | 1 << 31 } else { !bits }
    }

    /// World direction through pixel centre (`x`, `y`), z_c = 1, not normalised.
    #[inline]
    pub fn ray(&self, x: usize, y: usize) -> [f32; 3] {
        self.ray_through([x as f32 + 0.5, y as f32 + 0.5])
    }

    /// The same through any point of the image, pixels from its upper left corner.
    #[inline]
    pub fn ray_through(&self, [x, y]: [f32; 2]) -> [f32; 3] {
        let u = (x - self.centre_px[0]) / self.focal[0];
        let v = (y - self.centre_px[1]) / self.focal[1];
        std::array::from_fn(|c| u * self.rotation[0][c] + v * self.rotation[1][c] + self.rotation[2][c])
    }
}
