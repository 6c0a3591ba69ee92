//! Motion vectors of the frames of a sequence. The model stands still, so only the cameras move.

use glam::{DVec2, DVec3};

use relume_scene::Camera;

/// The cameras before and after a frame in its sequence.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Neighbours {
    /// Camera of the previous frame.
    pub previous: Option<Camera>,
    /// Camera of the next frame.
    pub next: Option<Camera>,
}

/// Motion of the surface points of a frame, pixels, row-major: to the next frame, right and up, then to the previous frame, right and up.
/// At an end of the sequence the missing motion is the reverse of the other one. Zero where `depths` has no surface, and towards a camera
/// behind which the point lies. `points` has three coordinates per pixel, capture units.
pub(super) fn motion(camera: &Camera, points: &[f32], depths: &[f32], neighbours: &Neighbours) -> Vec<f32> {
    let width = camera.width as usize;
    let pixel = |(i, (point, depth)): (usize, (&[f32; 3], &f32))| {
        if !depth.is_finite() {
            return [0.0; 4];
        }
        let point = DVec3::from_array(point.map(f64::from));
        let here = DVec2::new((i % width) as f64, (i / width) as f64) + 0.5;
        let to = |other: Option<Camera>| {
            let other = other?.resized(camera.width, camera.height);
            Some(projected(&other, point).map_or(DVec2::ZERO, |place| place - here))
        };
        let (next, previous) = (to(neighbours.next), to(neighbours.previous));
        let forward = next.or(previous.map(|v| -v)).unwrap_or_default();
        let backward = previous.or(next.map(|v| -v)).unwrap_or_default();
        [forward.x, -forward.y, backward.x, -backward.y].map(|v| v as f32)
    };
    points.as_chunks::<3>().0.iter().zip(depths).enumerate().flat_map(pixel).collect()
}

/// Place of a point in the image of `camera`, pixels from the upper left corner; `None` behind the camera.
fn projected(camera: &Camera, point: DVec3) -> Option<DVec2> {
    let p = camera.rotation * point + camera.translation;
    let place = DVec2::new(camera.fx * p.x / p.z + camera.cx, camera.fy * p.y / p.z + camera.cy);
    (p.z > 0.0 && place.is_finite()).then_some(place)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(eye: DVec3) -> Camera {
        Camera {
            rotation: camera_axes(),
            ..Camera::look_at(eye, eye - DVec3::X, DVec3::Z, 0.8, (40, 30)).unwrap()
        }
    }

    /// Looks along -x, with y to the right and z up.
    fn camera_axes() -> glam::DMat3 {
        Camera::look_at(DVec3::X, DVec3::ZERO, DVec3::Z, 0.8, (40, 30)).unwrap().rotation
    }

    #[test]
    fn a_camera_that_moves_right_moves_the_picture_left() {
        let here = camera(DVec3::X * 4.0);
        let next = camera(DVec3::new(4.0, 0.1, 0.2));
        let point = DVec3::ZERO.as_vec3().to_array();
        let points = [point; 40 * 30].as_flattened().to_vec();
        let mut depths = vec![4.0; 40 * 30];
        depths[0] = f32::INFINITY;
        let neighbours = Neighbours { previous: None, next: Some(next) };
        let plane = motion(&here, &points, &depths, &neighbours);
        // The pixel whose upper left corner is the centre of the image, half a pixel from the point.
        let at = 4 * (15 * 40 + 20);
        let step = here.fx / 4.0;
        let wanted = [-0.1 * step - 0.5, -(0.2 * step - 0.5)];
        let errors = [f64::from(plane[at]) - wanted[0], f64::from(plane[at + 1]) - wanted[1]];
        assert!(errors.iter().all(|error| error.abs() < 1e-4), "{errors:?}");
        assert_eq!([plane[at + 2], plane[at + 3]], [-plane[at], -plane[at + 1]], "the reverse at an end");
        assert_eq!(plane[..4], [0.0; 4], "an empty pixel");
        let behind = Neighbours { previous: None, next: Some(camera(DVec3::X * -4.0)) };
        assert_eq!(motion(&here, &points, &depths, &behind)[at..at + 4], [0.0; 4]);
    }
}
