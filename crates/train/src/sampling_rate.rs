//! The finest sampling of each Gaussian in the photographs. A frame that shows a Gaussian larger than every photograph did must not
//! show details that no pixel constrained: they would be needles (Yu et al. 2024, Mip-Splatting, section 5.1).

use glam::DVec3;
use rayon::prelude::*;

use relume_layout::constants::NEAR;
use relume_scene::{Camera, Field, Gaussians};

/// Stores the sampling rate of each Gaussian: the largest number of pixels per unit of length among the cameras that have its centre
/// in their image, or among all cameras if none has. Hidden Gaussians keep their negative sign.
pub(crate) fn measure(gaussians: &mut Gaussians, cameras: &[&Camera]) {
    let signed = |i: usize| {
        let rate = rate(DVec3::from(gaussians.get::<3>(Field::Mean, i).map(f64::from)), cameras);
        if gaussians.is_photographed(i) { rate } else { -rate }
    };
    let rates: Vec<f32> = (0..gaussians.len()).into_par_iter().map(signed).collect();
    gaussians.field_mut(Field::SamplingRate).copy_from_slice(&rates);
}

/// Pixels per unit of length at `point`; 0 without cameras.
fn rate(point: DVec3, cameras: &[&Camera]) -> f32 {
    let (mut shown, mut near) = (0.0f64, 0.0f64);
    for camera in cameras {
        let at_camera = camera.rotation * point + camera.translation;
        let focal = (camera.fx * camera.fy).sqrt();
        near = near.max(focal / at_camera.length().max(f64::from(NEAR)));
        if is_in_image(camera, at_camera) {
            shown = shown.max(focal / at_camera.z);
        }
    }
    (if shown > 0.0 { shown } else { near }) as f32
}

/// True if the image of a point in camera coordinates contains it.
pub(crate) fn is_in_image(camera: &Camera, p: DVec3) -> bool {
    let inside = |at: f64, size: u32| (0.0..=f64::from(size)).contains(&at);
    p.z > f64::from(NEAR)
        && inside(camera.fx * p.x / p.z + camera.cx, camera.width)
        && inside(camera.fy * p.y / p.z + camera.cy, camera.height)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sampling_rate_is_that_of_the_nearest_camera_that_sees() {
        let from =
            |eye: DVec3, target: DVec3| Camera::look_at(eye, target, DVec3::Z, 0.8, (100, 100)).unwrap();
        let near = from(DVec3::X * 2.0, DVec3::ZERO);
        let far = from(DVec3::X * 4.0, DVec3::ZERO);
        // It is nearest and looks away.
        let away = from(DVec3::X, DVec3::X * 2.0);
        let focal = near.fx;
        let mut gaussians = Gaussians::zeroed(2, 1, 0, 0);
        gaussians.row_mut(Field::Mean, 1).copy_from_slice(&[0.0, 0.0, 50.0]);
        measure(&mut gaussians, &[&far, &near, &away]);
        let rates = gaussians.field(Field::SamplingRate);
        assert!((f64::from(rates[0]) / (focal / 2.0) - 1.0).abs() < 1e-6, "{rates:?}");
        // No camera sees the second one; its nearest camera is about 50 units away.
        assert!((f64::from(rates[1]) / (focal / 50.0) - 1.0).abs() < 0.01, "{rates:?}");
        measure(&mut gaussians, &[&far]);
        assert!(
            (f64::from(gaussians.field(Field::SamplingRate)[0]) / (focal / 4.0) - 1.0).abs() < 1e-6,
            "the control"
        );
        gaussians.row_mut(Field::SamplingRate, 1)[0] = -1.0;
        measure(&mut gaussians, &[&far]);
        assert!(
            (f64::from(gaussians.field(Field::SamplingRate)[1]) / (focal / -50.0) - 1.0).abs() < 0.1,
            "hidden"
        );
        measure(&mut gaussians, &[]);
        assert_eq!(gaussians.field(Field::SamplingRate), [0.0, 0.0]);
    }
}
