//! Converts distorted photographs to pinhole photographs of the same size.
//!
//! The pinhole camera shows the largest axis-aligned window that lies completely inside the photograph. Every new
//! pixel therefore has a source, and no alpha is invented.

use glam::DVec2;

use crate::distortion::Distortion;
use relume_scene::{Camera, ImageRgba};

/// Largest distance of a window's edge from the axis, in units of depth (62 degrees). In a wider window most pixels
/// of a perspective image would show its outermost degrees.
const MAX_REACH: f64 = 1.9;

/// Image points sampled along each side of the photograph.
const SIDE_SAMPLES: usize = 65;

/// The pinhole camera and image for a distorted one. `camera` has the distorted image's focal lengths and principal
/// point.
///
/// # Errors
/// The reason, if the coefficients fold the image over itself or leave no window.
pub(super) fn undistort(
    camera: &Camera,
    lens: &Distortion,
    image: &ImageRgba,
) -> Result<(Camera, ImageRgba), String> {
    let undistorted = pinhole(camera, lens)?;
    let source = |x: u32, y: u32| {
        let u = (f64::from(x) + 0.5 - undistorted.cx) / undistorted.fx;
        let v = (f64::from(y) + 0.5 - undistorted.cy) / undistorted.fy;
        to_pixel(camera, lens.distort(DVec2::new(u, v)))
    };
    let mut pixels = Vec::with_capacity(image.pixels.len());
    for y in 0..image.height {
        pixels.extend((0..image.width).map(|x| bilinear(image, source(x, y))));
    }
    Ok((undistorted, ImageRgba { width: image.width, height: image.height, pixels }))
}

/// The pinhole camera for a distorted one.
///
/// # Errors
/// As [`undistort`].
pub(super) fn pinhole(camera: &Camera, lens: &Distortion) -> Result<Camera, String> {
    let window = inner_window(camera, lens)?;
    let (low, size) = (window.0, window.1 - window.0);
    let (fx, fy) = (f64::from(camera.width) / size.x, f64::from(camera.height) / size.y);
    check_window(camera, lens, window)?;
    Ok(Camera { fx, fy, cx: -low.x * fx, cy: -low.y * fy, ..*camera })
}

fn to_pixel(camera: &Camera, p: DVec2) -> DVec2 {
    DVec2::new(camera.fx * p.x + camera.cx, camera.fy * p.y + camera.cy)
}

/// Corners, on the plane of depth 1, of the largest window inside the image's undistorted outline.
fn inner_window(camera: &Camera, lens: &Distortion) -> Result<(DVec2, DVec2), String> {
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    let undistorted = |x: f64, y: f64| {
        let distorted = DVec2::new((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy);
        lens.undistort(distorted)
            .ok_or_else(|| "these coefficients cannot be inverted over the whole image".to_owned())
    };
    let mut low = DVec2::splat(-MAX_REACH);
    let mut high = DVec2::splat(MAX_REACH);
    for i in 0..SIDE_SAMPLES {
        let t = i as f64 / (SIDE_SAMPLES - 1) as f64;
        low.x = low.x.max(undistorted(0.0, t * h)?.x);
        high.x = high.x.min(undistorted(w, t * h)?.x);
        low.y = low.y.max(undistorted(t * w, 0.0)?.y);
        high.y = high.y.min(undistorted(t * w, h)?.y);
    }
    if !(high - low).cmpgt(DVec2::splat(1e-6)).all() {
        return Err("these coefficients leave no usable part of the image".to_owned());
    }
    Ok((low, high))
}

/// Refuses a lens that folds the image over itself or that needs pixels more than one pixel outside it.
fn check_window(camera: &Camera, lens: &Distortion, (low, high): (DVec2, DVec2)) -> Result<(), String> {
    const GRID: usize = 16;
    let limit = DVec2::new(f64::from(camera.width), f64::from(camera.height)) + 1.0;
    for i in 0..=GRID * GRID + 2 * GRID {
        let t = DVec2::new((i % (GRID + 1)) as f64, (i / (GRID + 1)) as f64) / GRID as f64;
        let p = low + (high - low) * t;
        let pixel = to_pixel(camera, lens.distort(p));
        let inside = pixel.cmpge(DVec2::splat(-1.0)).all() && pixel.cmple(limit).all();
        if !inside || lens.jacobian(p).determinant() <= 0.0 {
            return Err("these coefficients fold the image over itself".to_owned());
        }
    }
    Ok(())
}

/// Bilinear lookup with pixel centres at +0.5, clamped at the edges; colours are weighted by alpha.
fn bilinear(image: &ImageRgba, at: DVec2) -> [f32; 4] {
    let p =
        (at - 0.5).clamp(DVec2::ZERO, DVec2::new(f64::from(image.width - 1), f64::from(image.height - 1)));
    let (x, y) = (p.x as usize, p.y as usize);
    let (fx, fy) = ((p.x - x as f64) as f32, (p.y - y as f64) as f32);
    let right = (x + 1).min(image.width as usize - 1);
    let below = (y + 1).min(image.height as usize - 1);
    let corners = [
        (x, y, (1.0 - fx) * (1.0 - fy)),
        (right, y, fx * (1.0 - fy)),
        (x, below, (1.0 - fx) * fy),
        (right, below, fx * fy),
    ];
    let (mut colour, mut alpha) = ([0.0f32; 3], 0.0);
    for (x, y, weight) in corners {
        let p = image.pixels[y * image.width as usize + x];
        alpha += weight * p[3];
        (0..3).for_each(|k| colour[k] += weight * p[3] * p[k]);
    }
    let divisor = if alpha > 0.0 { alpha } else { 1.0 };
    // Rounding of the weights must not make an opaque image transparent.
    let alpha = if alpha > 1.0 - 1e-6 { 1.0 } else { alpha };
    [colour[0] / divisor, colour[1] / divisor, colour[2] / divisor, alpha]
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use relume_compare::worst;

    use super::*;

    const PHONE: Distortion =
        Distortion::RadialTangential { k: [0.0578, -0.0805, 0.01, 0.0], p: [-0.00098, 0.00016] };
    const WIDE: Distortion = Distortion::RadialTangential { k: [-0.28, 0.08, 0.0, 0.0], p: [0.0; 2] };
    const FISHEYE: Distortion = Distortion::Fisheye { k: [0.05, -0.01, 0.002, 0.0] };

    fn camera() -> Camera {
        let pose = Camera::look_at(DVec3::new(3.0, 1.0, 2.0), DVec3::ZERO, DVec3::Z, 0.9, (96, 64)).unwrap();
        Camera { fx: 80.0, fy: 82.0, cx: 46.0, cy: 33.5, ..pose }
    }

    /// An image whose red and green encode the pixel position.
    fn coordinates() -> ImageRgba {
        let pixel = |i: u32| [(i % 96) as f32 / 100.0, (i / 96) as f32 / 100.0, 0.5, 1.0];
        ImageRgba { width: 96, height: 64, pixels: (0..96 * 64).map(pixel).collect() }
    }

    /// Largest distance between the pixel at which a lens images a point and the one that the undistorted image shows
    /// there.
    fn error(lens: &Distortion, truth: &Distortion) -> f64 {
        let distorted = camera();
        let (undistorted, image) = undistort(&distorted, lens, &coordinates()).unwrap();
        let mut errors = Vec::new();
        for y in 2..62 {
            for x in 2..94 {
                let d = undistorted.rotation * undistorted.ray(x, y);
                let seen = to_pixel(&distorted, truth.distort(DVec2::new(d.x / d.z, d.y / d.z))) - 0.5;
                let p = image.pixels[(y * 96 + x) as usize];
                let shown = DVec2::new(f64::from(p[0]) * 100.0, f64::from(p[1]) * 100.0);
                let inside = seen.clamp(DVec2::ZERO, DVec2::new(95.0, 63.0));
                errors.push((shown - inside).length());
                assert_eq!(p[3], 1.0);
            }
        }
        worst(errors)
    }

    #[test]
    fn undistorted_pixels_show_the_distorted_image_along_their_ray() {
        for lens in [PHONE, WIDE, FISHEYE] {
            assert!(error(&lens, &lens) < 1e-3, "{lens:?}: {}", error(&lens, &lens));
            let control = error(&lens, &Distortion::None);
            assert!(
                control.is_finite() && control > 0.1,
                "the comparison must notice a wrong lens: {control}"
            );
        }
    }

    #[test]
    fn lens_that_folds_the_image_is_refused() {
        for k in [[-5.0, 0.0, 0.0, 0.0], [1e9, -1e12, 0.0, 0.0], [f64::MAX, 0.0, 0.0, 0.0]] {
            let lens = Distortion::RadialTangential { k, p: [0.0; 2] };
            assert!(undistort(&camera(), &lens, &coordinates()).is_err(), "{k:?}");
        }
    }
}
