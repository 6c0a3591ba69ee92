//! The header `relume-photograph-angle`: the angle between a picture's camera and the nearest photograph.

use axum::http::{HeaderMap, HeaderName, HeaderValue};
use glam::DVec3;

use relume_scene::PhotographedViews;

/// Degrees with one decimal, seen from the centre of the subject. Absent for models that do not record their photographs.
pub(super) const PHOTOGRAPH_ANGLE: HeaderName = HeaderName::from_static("relume-photograph-angle");

/// Adds the header for a camera in a direction from the centre of the subject.
pub(super) fn insert(headers: &mut HeaderMap, views: &PhotographedViews, direction: DVec3) {
    let Some(nearest) = views.nearest(direction) else { return };
    if let Ok(value) = HeaderValue::from_str(&format!("{:.1}", nearest.angle_deg)) {
        headers.insert(PHOTOGRAPH_ANGLE, value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::{PhotographedDirection, direction_of};

    #[test]
    fn header_has_the_angle_to_the_nearest_photograph() {
        let photograph =
            PhotographedDirection { name: "a.jpg".to_owned(), azimuth_deg: 10.0, elevation_deg: 20.0 };
        let views = PhotographedViews {
            target: DVec3::ZERO,
            radius: 1.0,
            distance: 3.0,
            azimuth_deg: 10.0,
            elevation_deg: 20.0,
            fov_deg: 40.0,
            photographs: vec![photograph],
        };
        let header = |direction: DVec3| {
            let mut headers = HeaderMap::new();
            insert(&mut headers, &views, direction);
            headers.get(PHOTOGRAPH_ANGLE).map(|value| value.to_str().unwrap().to_owned())
        };
        assert_eq!(header(direction_of(10.0, 63.0)).as_deref(), Some("43.0"));
        assert_eq!(header(views.direction(None, None)).as_deref(), Some("0.0"));
        assert_eq!(header(DVec3::ZERO), None, "a camera at the centre has no direction");
    }
}
