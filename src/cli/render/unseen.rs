//! The warning for views from directions without photographs.

use serde_json::Value;

use relume_scene::{NearestPhotograph, PhotographedViews, UNSEEN_DEG};
use relume_train::render::FrameView;

/// The warning for `views` that are far from every photograph that the model card records. `None` if there are none, or if the card
/// has no record.
pub(super) fn warning(views: &[FrameView], card: &Value) -> Option<String> {
    let photographed = PhotographedViews::of_card(card)?;
    let unseen: Vec<(usize, NearestPhotograph)> = (1..)
        .zip(views)
        .filter_map(|(number, view)| Some((number, photographed.unseen(view.camera.centre())?)))
        .collect();
    let (number, farthest) = unseen.iter().max_by(|a, b| a.1.angle_deg.total_cmp(&b.1.angle_deg))?;
    if views.len() == 1 {
        return Some(farthest.to_string());
    }
    let NearestPhotograph { angle_deg, name } = farthest;
    Some(format!(
        "{} of {} views are more than {UNSEEN_DEG} degrees from the nearest photograph; the farthest, view {number}, is \
         {angle_deg:.0} degrees from it ({name}); what was not photographed there is a guess",
        unseen.len(),
        views.len()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use relume_scene::{Camera, PhotographedDirection, direction_of};
    use serde_json::json;

    /// A card with photographs at azimuths of 0, 30 and 60 degrees, on the horizon.
    fn card() -> Value {
        let photograph = |i: u32| PhotographedDirection {
            name: format!("IMG_{i}.jpg"),
            azimuth_deg: 30.0 * f64::from(i),
            elevation_deg: 0.0,
        };
        let views = PhotographedViews {
            target: DVec3::ONE,
            radius: 0.5,
            distance: 3.0,
            azimuth_deg: 0.0,
            elevation_deg: 0.0,
            fov_deg: 40.0,
            photographs: (0..3).map(photograph).collect(),
        };
        json!({ "photographed_views": views })
    }

    fn view(azimuth_deg: f64) -> FrameView {
        let eye = DVec3::ONE + 5.0 * direction_of(azimuth_deg, 0.0);
        let camera = Camera::look_at(eye, DVec3::ONE, DVec3::Z, 0.7, (8, 8)).unwrap();
        FrameView::new(camera, 0.0)
    }

    #[test]
    fn view_far_from_all_photographs_gets_a_warning() {
        let of = |azimuth: f64| warning(&[view(azimuth)], &card());
        assert_eq!(of(45.0), None, "the control: between photographs");
        let text = of(103.0).unwrap();
        assert!(
            text.starts_with("this view is 43 degrees from the nearest photograph (IMG_2.jpg)"),
            "{text}"
        );
        assert_eq!(warning(&[view(103.0)], &json!({})), None, "a model of an older version");
    }

    #[test]
    fn sequence_gets_one_warning_about_its_farthest_view() {
        let turntable: Vec<FrameView> = (0..12).map(|i| view(30.0 * f64::from(i))).collect();
        let text = warning(&turntable, &card()).unwrap();
        assert!(text.starts_with("9 of 12 views are more than 20 degrees"), "{text}");
        assert!(text.contains("view 8, is 150 degrees from it"), "{text}");
        assert_eq!(warning(&turntable[..3], &card()), None, "the control");
    }
}
