//! The record of the directions from which the subject was photographed. It is computed from the training photographs, so that
//! checkpoints do not need it.

use glam::DVec3;

use crate::trainer::Trainer;
use relume_capture::shown_ball;
use relume_engine::PhotoSize;
use relume_scene::{Camera, Model, PhotographedViews, opaque_centre, opaque_radius};

/// Radius of the ball that contains a subject with masks, in the normalised world; the unit ball may not contain all of it.
const MASKED_REACH: f64 = 1.5;

impl Trainer {
    /// The directions of the training photographs around the subject, in capture units: [`relume_capture::photographed_views`].
    /// `None` if the cameras do not surround a subject.
    pub(super) fn photographed_views(&self, model: &Model) -> Option<PhotographedViews> {
        let cameras = self.data.cameras(PhotoSize::Full);
        let shown = shown_ball(&cameras)?;
        let (target, radius) = if self.data.has_alpha { masked(model) } else { unmasked(model, shown) };
        let names = self.data.names.iter().map(String::as_str);
        let named: Vec<(&str, Camera)> = names.zip(cameras.iter().map(|c| in_capture(c, model))).collect();
        let named: Vec<(&str, &Camera)> = named.iter().map(|(name, camera)| (*name, camera)).collect();
        let target = target / model.world_scale - model.world_offset;
        relume_capture::photographed_views(&named, target, radius / model.world_scale)
    }
}

/// Centre and radius of a subject with masks: its opaque Gaussians, or the unit ball without such.
fn masked(model: &Model) -> (DVec3, f64) {
    let (g, everything) = (&model.gaussians, DVec3::ZERO);
    let found = opaque_centre(g, everything, MASKED_REACH)
        .and_then(|centre| opaque_radius(g, centre, MASKED_REACH).map(|radius| (centre, radius)));
    found.unwrap_or((everything, 1.0))
}

/// Centre and radius of a subject without masks: what the cameras look at, and the opaque Gaussians around it that they show
/// completely.
fn unmasked(model: &Model, (centre, radius): (DVec3, f64)) -> (DVec3, f64) {
    (centre, opaque_radius(&model.gaussians, centre, radius).unwrap_or(radius))
}

/// A camera of the normalised world of `model`, in capture units.
fn in_capture(camera: &Camera, model: &Model) -> Camera {
    camera.in_normalised_world(1.0 / model.world_scale, -model.world_scale * model.world_offset)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use relume_capture::{Capture, SyntheticOptions, synthetic};
    use relume_engine::Device;
    use relume_spec::training::{Preset, TrainConfig, TrainOverrides};

    fn capture() -> Capture {
        let options = SyntheticOptions {
            train_views: 8,
            test_views: 1,
            size: 24,
            paths: 4,
            relit: Default::default(),
            ..Default::default()
        };
        synthetic(&options).unwrap()
    }

    /// The record of an untrained model.
    fn record(capture: &Capture) -> Option<PhotographedViews> {
        let overrides = TrainOverrides {
            resolution: Some(24),
            initial_gaussians: Some(64),
            max_gaussians: Some(64),
            probe_directions: Some(8),
            ..Default::default()
        };
        let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
        let model = Trainer::new(capture, config, &Device::Cpu).unwrap().model().unwrap();
        assert!(model.card.get("photographed_views").is_some(), "null if there is none");
        PhotographedViews::of_card(&model.card)
    }

    #[test]
    fn model_card_records_photographs_in_capture_units() {
        let capture = capture();
        let views = record(&capture).unwrap();
        let names = |names: Vec<&str>| names.join(" ");
        let recorded = names(views.photographs.iter().map(|p| p.name.as_str()).collect());
        assert_eq!(recorded, names(capture.train.iter().map(|view| view.name.as_str()).collect()));
        for view in &capture.train {
            let nearest = views.nearest(view.camera.centre() - views.target).unwrap();
            assert!(nearest.angle_deg < 0.01 && nearest.name == view.name, "{}: {nearest:?}", view.name);
        }
        assert!((views.target - capture.bounds.centre).length() < capture.bounds.radius, "{views:?}");
        let first = capture.train[0].camera.centre() - views.target;
        assert!((first.y.atan2(first.x).to_degrees() - views.azimuth_deg).abs() < 0.01);
    }

    #[test]
    fn model_card_of_a_room_has_no_photographed_views() {
        let mut room = capture();
        room.has_alpha = false;
        assert!(record(&room).is_some(), "the control: a subject without masks");
        for camera in room.train.iter_mut().map(|view| &mut view.camera) {
            // Half a turn about the camera's own vertical axis.
            let eye = camera.centre();
            camera.rotation = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, -1.0)) * camera.rotation;
            camera.translation = -(camera.rotation * eye);
        }
        assert_eq!(record(&room), None);
    }
}
