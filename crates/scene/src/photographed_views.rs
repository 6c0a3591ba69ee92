//! The directions from which the subject of a model was photographed, as its model card records them.

use std::fmt;

use glam::DVec3;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::Framing;

/// Angle from the nearest photograph above which a view shows parts that may not have been photographed, degrees.
pub const UNSEEN_DEG: f64 = 20.0;
/// Radius of the ball that the default view frames, relative to that of the subject.
pub const FRAME_MARGIN: f64 = 1.1;
/// Largest distance of the target from the origin, relative to that of the cameras. Farther away, double precision does not
/// resolve the view.
const MAX_OFFSET: f64 = 1e9;
/// Least field of view of the default view, relative to that of the photographs.
const MIN_FOV_SHARE: f64 = 0.1;

/// The cameras of a capture that surround its subject: field `photographed_views` of a model card. Angles are seen from the centre
/// of the subject. Lengths are in capture units; +Z is up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhotographedViews {
    /// Centre of the subject.
    pub target: DVec3,
    /// Radius of the ball around `target` that contains the subject.
    pub radius: f64,
    /// Median distance of the cameras from `target`.
    pub distance: f64,
    /// Azimuth of the first photograph, degrees counter-clockwise seen from above; 0 is the +x side.
    pub azimuth_deg: f64,
    /// Median elevation of the cameras, degrees above the horizon, -90 to 90.
    pub elevation_deg: f64,
    /// Field of view of a square picture with the area of a photograph, median, degrees.
    pub fov_deg: f64,
    /// Directions from `target` to the cameras, in the order of the photographs; a part of them in large captures.
    pub photographs: Vec<PhotographedDirection>,
}

/// The direction of one photograph.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhotographedDirection {
    /// Name of the photograph in the capture.
    pub name: String,
    /// Degrees counter-clockwise seen from above; 0 is the +x side.
    pub azimuth_deg: f64,
    /// Degrees above the horizon, -90 to 90.
    pub elevation_deg: f64,
}

/// The unit vector with this azimuth and elevation, degrees.
pub fn direction_of(azimuth_deg: f64, elevation_deg: f64) -> DVec3 {
    let (sin_a, cos_a) = azimuth_deg.to_radians().sin_cos();
    let (sin_e, cos_e) = elevation_deg.to_radians().sin_cos();
    DVec3::new(cos_a * cos_e, sin_a * cos_e, sin_e)
}

impl PhotographedViews {
    /// The record in a model card. `None` if the card has none, as for captures without a subject in the middle and for models of
    /// older versions, or if its values define no view.
    pub fn of_card(card: &Value) -> Option<Self> {
        Self::deserialize(card.get("photographed_views")?).ok()?.checked()
    }

    /// The record if its values are in their ranges and define a view, else `None`.
    pub fn checked(self) -> Option<Self> {
        let is_positive = |value: f64| value.is_finite() && value > 0.0;
        let is_direction = |azimuth: f64, elevation: f64| azimuth.is_finite() && elevation.abs() <= 90.0;
        let is_valid = self.target.is_finite()
            && is_positive(self.radius)
            && is_positive(self.distance)
            && self.target.length() <= MAX_OFFSET * self.distance
            && is_direction(self.azimuth_deg, self.elevation_deg)
            && self.fov_deg > 0.0
            && self.fov_deg < 180.0
            && !self.photographs.is_empty()
            && self.photographs.iter().all(|p| is_direction(p.azimuth_deg, p.elevation_deg));
        (is_valid && self.framing().checked().is_some()).then_some(self)
    }

    /// The default view: the direction of the first photograph at the median elevation, with the subject in the picture.
    pub fn framing(&self) -> Framing {
        let (distance, fov_deg) = self.distance_and_fov();
        Framing { eye: self.target + distance * self.direction(None, None), target: self.target, fov_deg }
    }

    /// Distance from the target, and field of view in degrees, at which a square picture shows the whole subject. The camera is not
    /// nearer than the photographs were. It is farther only if the subject is larger than their field of view.
    pub fn distance_and_fov(&self) -> (f64, f64) {
        let half = 0.5 * self.fov_deg.to_radians();
        let framed = FRAME_MARGIN * self.radius;
        if framed >= self.distance * half.sin() {
            return (framed / half.sin(), self.fov_deg);
        }
        let needed = (framed / self.distance).asin().max(MIN_FOV_SHARE * half);
        (self.distance, 2.0 * needed.to_degrees())
    }

    /// The direction from the target to a camera. `azimuth_deg` is counted from the first photograph; `None` is 0. `elevation_deg`
    /// is above the horizon; `None` is the median of the photographs.
    pub fn direction(&self, azimuth_deg: Option<f64>, elevation_deg: Option<f64>) -> DVec3 {
        let azimuth = self.azimuth_deg + azimuth_deg.unwrap_or(0.0);
        direction_of(azimuth, elevation_deg.unwrap_or(self.elevation_deg))
    }

    /// The photograph whose direction is nearest to `direction`, which starts at the target and has any length. `None` if
    /// `direction` is zero or not finite.
    pub fn nearest(&self, direction: DVec3) -> Option<NearestPhotograph> {
        let unit = direction.try_normalize()?;
        let angle = |p: &PhotographedDirection| {
            let other = direction_of(p.azimuth_deg, p.elevation_deg);
            // Exact for small angles, unlike the arc cosine.
            other.cross(unit).length().atan2(other.dot(unit)).to_degrees()
        };
        let angles = self.photographs.iter().map(|photograph| (angle(photograph), photograph));
        let (angle_deg, photograph) = angles.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(NearestPhotograph { angle_deg, name: photograph.name.clone() })
    }

    /// The photograph nearest to a camera at `eye`, if it is more than [`UNSEEN_DEG`] away.
    pub fn unseen(&self, eye: DVec3) -> Option<NearestPhotograph> {
        self.nearest(eye - self.target).filter(|nearest| nearest.angle_deg > UNSEEN_DEG)
    }
}

/// The photograph whose direction is nearest to that of a view. Its text is the warning for a view that is far from it.
#[derive(Debug, Clone, PartialEq)]
pub struct NearestPhotograph {
    /// Angle between the two directions, degrees, 0 to 180.
    pub angle_deg: f64,
    /// Name of the photograph in the capture.
    pub name: String,
}

impl fmt::Display for NearestPhotograph {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { angle_deg, name } = self;
        write!(
            f,
            "this view is {angle_deg:.0} degrees from the nearest photograph ({name}); what was not photographed there is a guess"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn views() -> PhotographedViews {
        let photograph = |i: u32| PhotographedDirection {
            name: format!("IMG_{i}.jpg"),
            azimuth_deg: 100.0 + 30.0 * f64::from(i),
            elevation_deg: 25.0,
        };
        PhotographedViews {
            target: DVec3::new(1.0, 2.0, 0.5),
            radius: 0.5,
            distance: 4.0,
            azimuth_deg: 100.0,
            elevation_deg: 25.0,
            fov_deg: 40.0,
            photographs: (0..4).map(photograph).collect(),
        }
    }

    #[test]
    fn record_is_read_from_a_card_and_damaged_ones_are_not_used() {
        let card = json!({ "photographed_views": views() });
        assert_eq!(PhotographedViews::of_card(&card), Some(views()));
        for (field, value) in [
            ("radius", json!(0.0)),
            ("distance", json!(-1.0)),
            ("fov_deg", json!(180.0)),
            ("elevation_deg", json!(91.0)),
            ("target", json!([0.0, 1.0])),
            ("photographs", json!([])),
            ("photographs", json!([{ "name": "a", "azimuth_deg": 0.0, "elevation_deg": 100.0 }])),
            ("azimuth_deg", json!(null)),
            ("fov_deg", json!(1e-320)),
            ("radius", json!(1e308)),
            ("target", json!([1e300, 0.0, 0.0])),
        ] {
            let mut damaged = card.clone();
            damaged["photographed_views"][field] = value.clone();
            assert_eq!(PhotographedViews::of_card(&damaged), None, "{field}: {value}");
        }
        for card in [json!(null), json!({}), json!({ "photographed_views": null })] {
            assert_eq!(PhotographedViews::of_card(&card), None);
        }
        assert_eq!(PhotographedViews { radius: f64::NAN, ..views() }.checked(), None);
    }

    #[test]
    fn default_view_frames_the_subject_and_is_never_nearer() {
        let (distance, fov) = views().distance_and_fov();
        assert!((distance - 4.0).abs() < 1e-12, "the distance of the photographs");
        assert!((4.0 * (0.5 * fov.to_radians()).sin() - 0.55).abs() < 1e-12, "{fov}");
        let large = PhotographedViews { radius: 2.0, ..views() };
        let (distance, fov) = large.distance_and_fov();
        assert!((fov - 40.0).abs() < 1e-12 && (distance * 20.0f64.to_radians().sin() - 2.2).abs() < 1e-12);
        let tiny = PhotographedViews { radius: 1e-9, ..views() };
        assert!((tiny.distance_and_fov().1 - 4.0).abs() < 1e-9, "a bounded zoom");
    }

    #[test]
    fn azimuth_is_counted_from_the_first_photograph() {
        let views = views();
        let same = |a: DVec3, b: DVec3| (a - b).length() < 1e-12;
        assert!(same(views.direction(None, None), direction_of(100.0, 25.0)));
        assert!(same(views.direction(Some(30.0), Some(-5.0)), direction_of(130.0, -5.0)));
        assert!(!same(views.direction(Some(30.0), None), direction_of(30.0, 25.0)), "the control");
    }

    #[test]
    fn view_far_from_every_photograph_is_told_with_its_angle() {
        let views = views();
        let eye = |azimuth: f64, elevation: f64| views.target + 7.0 * direction_of(azimuth, elevation);
        assert_eq!(views.unseen(eye(131.0, 30.0)), None, "beside the second photograph");
        let unseen = views.unseen(eye(130.0, 68.0)).unwrap();
        assert!((unseen.angle_deg - 43.0).abs() < 1e-9 && unseen.name == "IMG_1.jpg", "{unseen:?}");
        assert_eq!(
            unseen.to_string(),
            "this view is 43 degrees from the nearest photograph (IMG_1.jpg); what was not photographed there is a guess"
        );
        let nearest = views.nearest(direction_of(190.0, 25.0)).unwrap();
        assert!(nearest.angle_deg.abs() < 1e-6 && nearest.name == "IMG_3.jpg");
        for nowhere in [DVec3::ZERO, DVec3::NAN] {
            assert_eq!(views.nearest(nowhere), None);
        }
    }
}
