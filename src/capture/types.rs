//! What every importer produces, whatever the layout it read.

use std::collections::BTreeMap;

use glam::DVec3;

use crate::scene::{Camera, EnvMap};

/// A display-referred RGBA image: sRGB-curve colour and straight alpha, both in [0, 1], row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageRgba {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Row-major pixels `r g b a`.
    pub pixels: Vec<[f32; 4]>,
}

/// A row-major image of `C` floats a pixel, for ground-truth layers.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane<const C: usize> {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Row-major values.
    pub values: Vec<[f32; C]>,
}

/// Ground truth that a synthetic set may carry for a view. Everything optional.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GroundTruthView {
    /// The view under other lights, by light name: sRGB, straight alpha.
    pub relit: BTreeMap<String, ImageRgba>,
    /// Base colour, **linear** Rec.709 (importers decode sRGB-encoded albedo).
    pub albedo: Option<Plane<3>>,
    /// World-space unit shading normal; zero where nothing is.
    pub normal: Option<Plane<3>>,
    /// Metalness and roughness, linear.
    pub metallic_roughness: Option<Plane<2>>,
    /// Cosine-weighted sky visibility in [0, 1].
    pub ambient_occlusion: Option<Plane<1>>,
    /// Distance along the view axis, capture units; 0 where nothing is.
    pub depth: Option<Plane<1>>,
}

/// One photograph with its pose.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureView {
    /// The image's name in the capture, e.g. `train_007/rgba.png`.
    pub name: String,
    /// Pose and intrinsics at the image's resolution, distortion already removed.
    pub camera: Camera,
    /// The photograph.
    pub image: ImageRgba,
    /// Ground-truth layers, when the set has them.
    pub truth: GroundTruthView,
}

/// Where the scene is, capture units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scene3dBounds {
    /// Centre of the region of interest.
    pub centre: DVec3,
    /// Radius of the region of interest.
    pub radius: f64,
}

/// A capture ready to train on: +Z up, OpenCV cameras, no distortion left.
#[derive(Debug, Clone, PartialEq)]
pub struct Capture {
    /// What was recognised: `nerf-synthetic`, `tensoir`, `nerfstudio`, `colmap`, `synthetic`.
    pub layout: String,
    /// Views to train on.
    pub train: Vec<CaptureView>,
    /// Held-out views.
    pub test: Vec<CaptureView>,
    /// Sparse points with linear Rec.709 colours, when the capture has them.
    pub points: Vec<(DVec3, [f32; 3])>,
    /// Where the subject is.
    pub bounds: Scene3dBounds,
    /// True when the images' alpha channel carries a mask.
    pub has_alpha: bool,
    /// Lights named in the ground truth, when found beside the capture.
    pub lights: BTreeMap<String, EnvMap>,
    /// The light of the photographs, where it was measured; no importer sets it.
    pub lit_by: Option<EnvMap>,
    /// Things a user should know but that did not stop the import, e.g. missing images by name.
    pub warnings: Vec<String>,
}

impl ImageRgba {
    /// RGB over a solid display-referred background.
    pub fn over(&self, background: [f32; 3]) -> Vec<[f32; 3]> {
        let blend = |p: &[f32; 4]| std::array::from_fn(|k| p[k] * p[3] + background[k] * (1.0 - p[3]));
        self.pixels.iter().map(blend).collect()
    }

    /// The image reduced to `width` x `height` by area averaging with premultiplied alpha.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        if (width, height) == (self.width, self.height) {
            return self.clone();
        }
        let premultiplied =
            self.pixels.iter().map(|p| [p[0] * p[3], p[1] * p[3], p[2] * p[3], p[3]]).collect();
        let plane = Plane { width: self.width, height: self.height, values: premultiplied };
        let small = plane.resized(width, height);
        let straight = |p: [f32; 4]| {
            let a = p[3].max(1e-8);
            [(p[0] / a).min(1.0), (p[1] / a).min(1.0), (p[2] / a).min(1.0), p[3].min(1.0)]
        };
        Self { width, height, pixels: small.values.into_iter().map(straight).collect() }
    }
}

impl<const C: usize> Plane<C> {
    /// The image reduced to `width` x `height` by exact area averaging.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let rows = spans(self.height, height);
        let columns = spans(self.width, width);
        let mut values = Vec::with_capacity(rows.len() * columns.len());
        for row in &rows {
            for column in &columns {
                let mut sum = [0.0f64; C];
                for &(y, wy) in row {
                    for &(x, wx) in column {
                        let v = &self.values[y * self.width as usize + x];
                        (0..C).for_each(|k| sum[k] += f64::from(v[k]) * wx * wy);
                    }
                }
                values.push(sum.map(|s| s as f32));
            }
        }
        Self { width, height, values }
    }
}

/// For each new cell, the old cells under it and their shares, summing to 1.
fn spans(from: u32, to: u32) -> Vec<Vec<(usize, f64)>> {
    let ratio = f64::from(from) / f64::from(to);
    (0..to)
        .map(|i| {
            let (lo, hi) = (f64::from(i) * ratio, f64::from(i + 1) * ratio);
            let last = (hi.ceil() as usize).min(from as usize);
            let share = |j: usize| (hi.min(j as f64 + 1.0) - lo.max(j as f64)).max(0.0) / ratio;
            (lo as usize..last).map(|j| (j, share(j))).filter(|&(_, w)| w > 1e-9).collect()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resizing_keeps_the_mean_and_ignores_colour_under_zero_alpha() {
        let mut pixels = vec![[1.0, 0.0, 0.0, 1.0]; 16];
        pixels[5] = [0.0, 1.0, 0.0, 0.0];
        let image = ImageRgba { width: 4, height: 4, pixels };
        let small = image.resized(2, 2);
        assert!(small.pixels.iter().all(|p| (p[0] - 1.0).abs() < 1e-6 && p[1] == 0.0));
        let mean: f32 = small.pixels.iter().map(|p| p[3]).sum::<f32>() / 4.0;
        assert!((mean - 15.0 / 16.0).abs() < 1e-6);
    }
}
