//! Finds the directions from which the subject of a capture was photographed.

use glam::DVec3;

use crate::bounds::{quantile, square_half_angle};
use relume_scene::{Camera, PhotographedDirection, PhotographedViews, direction_of};

/// Largest number of directions in a record.
const MAX_PHOTOGRAPHS: usize = 400;
/// Least share of the photographs that must show the subject. In a room that was photographed from its middle, few show one point.
const MIN_SHARE: f64 = 0.75;
/// Distance outside the image, relative to its side, at which the centre of the subject still counts as shown.
const MARGIN: f64 = 0.25;

/// The directions of `photographs`, a name and a camera each, around a subject with this centre and radius, in the units and axes of
/// the cameras. Photographs that do not show the centre are omitted. Of more than 400, those are kept that cover all directions
/// best. `None` if the photographs are fewer than two or too few of them show the centre.
pub fn photographed_views(
    photographs: &[(&str, &Camera)],
    target: DVec3,
    radius: f64,
) -> Option<PhotographedViews> {
    let showing: Vec<_> = photographs.iter().filter(|(_, camera)| shows(camera, target)).collect();
    if showing.len() < 2 || (showing.len() as f64) < MIN_SHARE * photographs.len() as f64 {
        return None;
    }
    let median = |value: &dyn Fn(&Camera) -> f64| {
        quantile(showing.iter().map(|(_, camera)| value(camera)).collect(), 0.5)
    };
    let away = |camera: &Camera| camera.centre() - target;
    let direction = |(name, camera): &(&str, &Camera)| {
        let d = away(camera);
        PhotographedDirection {
            name: (*name).to_owned(),
            azimuth_deg: angle(d.y.atan2(d.x)),
            elevation_deg: angle(d.z.atan2(d.truncate().length())),
        }
    };
    let all: Vec<PhotographedDirection> = showing.iter().map(|photograph| direction(photograph)).collect();
    let elevation_deg = quantile(all.iter().map(|d| d.elevation_deg).collect(), 0.5);
    let azimuth_deg = all.first()?.azimuth_deg;
    PhotographedViews {
        target: DVec3::from_array(target.to_array().map(significant)),
        radius: significant(radius),
        distance: significant(median(&|camera| away(camera).length())),
        azimuth_deg,
        elevation_deg,
        fov_deg: angle(median(&|camera| 2.0 * square_half_angle(camera))),
        photographs: covering(all, MAX_PHOTOGRAPHS),
    }
    .checked()
}

/// Whether a camera shows a point, which may be a little outside its image.
fn shows(camera: &Camera, point: DVec3) -> bool {
    let p = camera.rotation * point + camera.translation;
    let is_inside = |along: f64, focal: f64, principal: f64, side: u32| {
        let (at, side) = (focal * along / p.z + principal, f64::from(side));
        (-MARGIN * side..=(1.0 + MARGIN) * side).contains(&at)
    };
    p.z > 0.0
        && is_inside(p.x, camera.fx, camera.cx, camera.width)
        && is_inside(p.y, camera.fy, camera.cy, camera.height)
}

/// At most `most` directions, each the farthest from those before it, in their original order; the first is always kept.
fn covering(all: Vec<PhotographedDirection>, most: usize) -> Vec<PhotographedDirection> {
    if all.len() <= most {
        return all;
    }
    let units: Vec<DVec3> = all.iter().map(|d| direction_of(d.azimuth_deg, d.elevation_deg)).collect();
    let mut nearness = vec![f64::NEG_INFINITY; all.len()];
    let mut is_kept = vec![false; all.len()];
    let mut next = 0;
    for _ in 0..most {
        is_kept[next] = true;
        nearness.iter_mut().zip(&units).for_each(|(most, unit)| *most = most.max(unit.dot(units[next])));
        let others = (0..all.len()).filter(|i| !is_kept[*i]);
        let Some(farthest) = others.min_by(|a, b| nearness[*a].total_cmp(&nearness[*b])) else { break };
        next = farthest;
    }
    all.into_iter().zip(is_kept).filter_map(|(direction, is_kept)| is_kept.then_some(direction)).collect()
}

/// Radians as degrees with three decimals, so that the record is short and the same after writing to and reading from JSON.
fn angle(radians: f64) -> f64 {
    (radians.to_degrees() * 1e3).round() / 1e3 + 0.0
}

/// A length with seven significant digits.
fn significant(length: f64) -> f64 {
    format!("{length:.6e}").parse().unwrap_or(length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shown_ball;
    use relume_scene::FRAME_MARGIN;

    const FOV: f64 = 0.7;
    /// Of a square picture with the area of one of 60 x 40 pixels, of which `FOV` is the shorter side: tan(0.35) sqrt(1.5) = 0.44707.
    const SQUARE_FOV: f64 = 0.840_824;

    /// A camera 3 units from `target` that looks at it, or away from it.
    fn camera(target: DVec3, azimuth_deg: f64, elevation_deg: f64, is_inwards: bool) -> Camera {
        let eye = target + 3.0 * direction_of(azimuth_deg, elevation_deg);
        let to = if is_inwards { target } else { 2.0 * eye - target };
        Camera::look_at(eye, to, DVec3::Z, FOV, (60, 40)).unwrap()
    }

    fn views(cameras: &[Camera]) -> Option<PhotographedViews> {
        let (target, radius) = shown_ball(&cameras.iter().collect::<Vec<_>>())?;
        let names: Vec<String> = (0..cameras.len()).map(|i| format!("IMG_{i:04}.jpg")).collect();
        let named: Vec<_> = names.iter().map(String::as_str).zip(cameras).collect();
        photographed_views(&named, target, radius)
    }

    #[test]
    fn ring_of_cameras_has_its_elevation_distance_and_start() {
        let target = DVec3::new(5.0, -1.0, 2.0);
        let ring: Vec<Camera> =
            (0..12).map(|i| camera(target, 200.0 + 30.0 * f64::from(i), 25.0, true)).collect();
        let found = views(&ring).unwrap();
        assert!((found.target - target).length() < 1e-5 && (found.distance - 3.0).abs() < 1e-5, "{found:?}");
        assert!((found.elevation_deg - 25.0).abs() < 2e-3);
        assert!((found.azimuth_deg - -160.0).abs() < 2e-3, "that of the first photograph");
        assert!((found.fov_deg - SQUARE_FOV.to_degrees()).abs() < 2e-3, "{}", found.fov_deg);
        assert!((found.radius - 3.0 * (0.5 * SQUARE_FOV).sin() / FRAME_MARGIN).abs() < 1e-5);
        let (distance, fov) = found.distance_and_fov();
        assert!(
            (distance - 3.0).abs() < 1e-4 && (fov - SQUARE_FOV.to_degrees()).abs() < 2e-3,
            "a view as the photographs"
        );
        assert_eq!(found.photographs.len(), 12);
        let nearest = found.nearest(direction_of(230.0 + 14.0, 25.0)).unwrap();
        assert!((12.0..14.0).contains(&nearest.angle_deg) && nearest.name == "IMG_0001.jpg", "{nearest:?}");
        let text = serde_json::to_string(&found).unwrap();
        assert_eq!(serde_json::from_str::<PhotographedViews>(&text).unwrap(), found, "the same from JSON");
    }

    #[test]
    fn arc_of_cameras_leaves_its_other_side_unseen() {
        let arc: Vec<Camera> = (0..7).map(|i| camera(DVec3::ZERO, 10.0 * f64::from(i), 40.0, true)).collect();
        let found = views(&arc).unwrap();
        let eye = |azimuth: f64| 3.0 * direction_of(azimuth, 40.0);
        assert_eq!(found.unseen(eye(33.0)), None, "the control: between two photographs");
        let behind = found.unseen(eye(210.0)).unwrap();
        assert!(behind.angle_deg > 80.0, "{behind:?}");
    }

    #[test]
    fn median_is_not_moved_by_a_photograph_from_above() {
        let mut ring: Vec<Camera> =
            (0..9).map(|i| camera(DVec3::ZERO, 40.0 * f64::from(i), 20.0, true)).collect();
        ring.push(camera(DVec3::ZERO, 0.0, 85.0, true));
        let found = views(&ring).unwrap();
        assert!((found.elevation_deg - 20.0).abs() < 0.5, "{}", found.elevation_deg);
        assert_eq!(found.photographs.len(), 10, "it is still a photographed direction");
    }

    #[test]
    fn cameras_that_look_outwards_have_no_record() {
        let ring = |is_inwards: bool| -> Vec<Camera> {
            (0..12).map(|i| camera(DVec3::ZERO, 30.0 * f64::from(i), 5.0, is_inwards)).collect()
        };
        assert!(views(&ring(true)).is_some(), "the control");
        assert_eq!(views(&ring(false)), None);
        // Half of them look at the middle of the room.
        let mixed: Vec<Camera> =
            (0..12).map(|i| camera(DVec3::ZERO, 30.0 * f64::from(i), 5.0, i % 2 == 0)).collect();
        assert_eq!(views(&mixed), None);
    }

    #[test]
    fn one_camera_or_parallel_cameras_determine_no_subject() {
        let one = camera(DVec3::ZERO, 10.0, 20.0, true);
        assert_eq!(views(&[one]), None);
        assert_eq!(views(&[one, one, one]), None);
        let beside = |x: f64| {
            let eye = DVec3::new(x, -3.0, 0.0);
            Camera::look_at(eye, eye + DVec3::Y, DVec3::Z, FOV, (60, 40)).unwrap()
        };
        assert_eq!(views(&[beside(0.0), beside(0.2), beside(0.4)]), None);
        assert!(views(&[one, camera(DVec3::ZERO, 25.0, 20.0, true)]).is_some(), "the control");
        assert_eq!(photographed_views(&[], DVec3::ZERO, 1.0), None);
        let named = [("a", &one), ("b", &one)];
        assert!(photographed_views(&named, DVec3::ZERO, 1.0).is_some(), "the control");
        for radius in [0.0, -1.0, f64::NAN] {
            assert_eq!(photographed_views(&named, DVec3::ZERO, radius), None);
        }
    }

    #[test]
    fn large_captures_keep_directions_that_cover_all_others() {
        // 1,999 photographs of one side, and one of the other.
        let side = (0..1999).map(|i| camera(DVec3::ZERO, 0.05 * f64::from(i), 20.0, true));
        let cameras: Vec<Camera> = side.chain([camera(DVec3::ZERO, 250.0, 20.0, true)]).collect();
        let found = views(&cameras).unwrap();
        assert_eq!(found.photographs.len(), MAX_PHOTOGRAPHS);
        assert_eq!(found.photographs[0].name, "IMG_0000.jpg");
        assert_eq!(found.photographs[MAX_PHOTOGRAPHS - 1].name, "IMG_1999.jpg", "the order is kept");
        for camera in &cameras {
            let nearest = found.nearest(camera.centre() - found.target).unwrap();
            assert!(nearest.angle_deg < 0.5, "{nearest:?}");
        }
        assert_eq!(views(&cameras).unwrap(), found, "deterministic");
    }
}
