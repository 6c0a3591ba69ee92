//! The crop after the warm-up.

use crate::TrainError;
use crate::crop::{Region, SubjectCrop};
use crate::trainer::Trainer;

/// Least number of Gaussians of a subject.
const MIN_GAUSSIANS: usize = 16;

impl Trainer {
    /// Reduces the state to the subject: its Gaussians, and photographs with masks.
    ///
    /// # Errors
    /// [`TrainError::Invalid`] if the crop contains no Gaussians.
    pub(super) fn cut_out(&mut self) -> Result<(), TrainError> {
        let state = self.engine.state()?;
        if state.model.check().is_err() {
            // The next step rolls back, and the schedule reaches this point again.
            return Ok(());
        }
        let Some(region) = Region::of(self.config.crop, &state, &self.data) else { return Ok(()) };
        let mut state = state.into_owned();
        let Some(cut) = SubjectCrop::of(&mut state, region, MIN_GAUSSIANS) else {
            return Err(TrainError::Invalid("crop: the region contains nothing from the photographs".into()));
        };
        state.model.shading.occluder_reach = self.config.shading.occluder_reach;
        cut.apply(&mut self.data, state.model.shading);
        self.schedule.cut = Some(cut.into());
        self.engine.reshape(state, &self.operators)?;
        self.snapshot = self.schedule.clone();
        Ok(())
    }

    /// Centre and radius of a region's ball, in units and axes of the capture.
    pub(super) fn capture_region(&self, region: &Region) -> [f64; 4] {
        let (scale, offset) = (self.data.scale, self.data.offset);
        let centre = glam::DVec3::from(region.centre) / scale - offset;
        [centre.x, centre.y, centre.z, region.radius / scale]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_capture::{Capture, SyntheticOptions, SyntheticScene, synthetic};
    use relume_engine::{Device, PhotoSize};
    use relume_reference::gpu_device;
    use relume_scene::{BitDepth, PackedImage, PhotographedViews};
    use relume_spec::training::{Crop, Preset, TrainConfig, TrainOverrides};

    const STEPS: u32 = 160;

    /// Photographs of a ball on black without masks, and the true masks.
    fn capture() -> (Capture, Vec<Vec<f32>>) {
        let options = SyntheticOptions {
            scene: SyntheticScene::MatteBall,
            train_views: 8,
            test_views: 1,
            size: 32,
            paths: 8,
            relit: Default::default(),
            ..Default::default()
        };
        let mut capture = synthetic(&options).unwrap();
        let mut masks = Vec::new();
        for view in &mut capture.train {
            masks.push(view.image.alpha());
            let mut image = view.image.decoded();
            image.pixels = image.over([0.0; 3]).into_iter().map(|[r, g, b]| [r, g, b, 1.0]).collect();
            view.image = PackedImage::new(&image, BitDepth::Sixteen);
        }
        capture.has_alpha = false;
        (capture, masks)
    }

    fn config(crop: Crop) -> TrainConfig {
        let overrides = TrainOverrides {
            resolution: Some(32),
            iterations: Some(STEPS),
            warm_up: Some(0.75),
            half_resolution: Some(0.0),
            initial_gaussians: Some(600),
            max_gaussians: Some(900),
            probe_directions: Some(8),
            checkpoint_every: Some(1),
            crop: Some(crop),
            ..Default::default()
        };
        TrainConfig::new(Preset::Draft, &overrides).unwrap()
    }

    fn around(capture: &Capture, factor: f64) -> Crop {
        let bounds = capture.bounds;
        Crop::Ball([bounds.centre.x, bounds.centre.y, bounds.centre.z, factor * bounds.radius])
    }

    #[test]
    fn cropped_object_gets_correct_masks_on_the_cpu() {
        assert_cropped_object_gets_correct_masks(&Device::Cpu);
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn cropped_object_gets_correct_masks_on_a_gpu() {
        assert_cropped_object_gets_correct_masks(gpu_device());
    }

    fn assert_cropped_object_gets_correct_masks(device: &Device) {
        let (capture, masks) = capture();
        let mut trainer = Trainer::new(&capture, config(around(&capture, 0.9)), device).unwrap();
        let warm_up = trainer.config().warm_up_steps();
        while trainer.progress().step < warm_up {
            trainer.step().unwrap();
        }
        let masks_of = |trainer: &Trainer| -> Vec<f32> {
            (0..8).flat_map(|i| trainer.data.decode_uncached(i, PhotoSize::Full).alpha.clone()).collect()
        };
        assert!(masks_of(&trainer).is_empty(), "the control: no masks yet");
        assert!(trainer.model().unwrap().framing.is_some(), "the surroundings may occlude it");
        let distance = |trainer: &Trainer| trainer.data.camera(0, PhotoSize::Full).centre().length();
        let (before, seen) = (trainer.engine.gaussians(), distance(&trainer));
        trainer.step().unwrap();
        let found = masks_of(&trainer);
        let mean = |subject: bool| {
            let own = masks.iter().flatten().zip(&found).filter(|(own, _)| (**own > 0.5) == subject);
            let values: Vec<f64> = own.map(|(_, found)| f64::from(*found)).collect();
            values.iter().sum::<f64>() / values.len() as f64
        };
        // After so few steps the subject has holes; the masks contain nothing else.
        assert!(mean(true) > 0.3 && mean(false) < 0.1, "{} {}", mean(true), mean(false));
        assert!(trainer.engine.gaussians() < before, "Gaussians outside are removed");
        let now = distance(&trainer);
        assert!((now * 0.9 - seen).abs() < 1e-6, "the ball is the unit of the world: {now}, before {seen}");
        while !trainer.is_done() {
            assert_eq!(trainer.step().unwrap().warning, None);
        }
        let model = trainer.model().unwrap();
        assert_eq!(model.framing, None, "nothing occludes it");
        let views = PhotographedViews::of_card(&model.card).unwrap();
        let bounds = capture.bounds;
        assert!((views.target - bounds.centre).length() < 0.9 * bounds.radius, "{views:?}");
        assert_eq!(views.photographs.len(), 8);
        let ball = model.card.pointer("/crop/ball").unwrap().as_array().unwrap();
        assert!((ball[3].as_f64().unwrap() - 0.9 * capture.bounds.radius).abs() < 1e-9);
        assert!((model.world_scale * 0.9 * capture.bounds.radius - 1.0).abs() < 1e-9);
    }

    #[test]
    fn training_resumed_after_the_crop_gives_the_same_model() {
        let (capture, _) = capture();
        let config = config(around(&capture, 0.9));
        let mut whole = Trainer::new(&capture, config.clone(), &Device::Cpu).unwrap();
        let (at, mut checkpoint) = (whole.config().warm_up_steps() + 10, Vec::new());
        while !whole.is_done() {
            whole.step().unwrap();
            if whole.progress().step == at {
                checkpoint = whole.checkpoint().unwrap();
            }
        }
        let mut resumed = Trainer::resume(&capture, config, &checkpoint, &Device::Cpu).unwrap();
        assert!(resumed.data.has_alpha && resumed.progress().step == at);
        while !resumed.is_done() {
            resumed.step().unwrap();
        }
        assert_eq!(whole.model().unwrap(), resumed.model().unwrap());
    }

    #[test]
    fn crop_of_photographs_with_masks_is_refused() {
        let (mut capture, _) = capture();
        let refused =
            |capture: &Capture| Trainer::new(capture, config(around(capture, 1.0)), &Device::Cpu).err();
        assert!(refused(&capture).is_none(), "the control");
        capture.has_alpha = true;
        let mut whole = Trainer::new(&capture, config(Crop::NONE), &Device::Cpu).unwrap();
        assert_eq!(whole.model().unwrap().framing, None, "the default view shows the complete object");
        let error = refused(&capture).unwrap();
        assert!(matches!(&error, TrainError::Invalid(m) if m.starts_with("crop")), "{error}");
    }

    #[test]
    fn empty_crop_is_refused() {
        let (capture, _) = capture();
        let mut trainer =
            Trainer::new(&capture, config(Crop::Ball([1e3, 0.0, 0.0, 1.0])), &Device::Cpu).unwrap();
        let error = (0..STEPS).find_map(|_| trainer.step().err()).unwrap();
        assert!(
            matches!(&error, TrainError::Invalid(m) if m.starts_with("crop: the region contains nothing")),
            "{error}"
        );
        assert_eq!(trainer.progress().step, trainer.config().warm_up_steps());
    }
}
