//! Import of captures for training.

use std::collections::BTreeMap;
use std::path::Path;

use crate::TrainError;
use crate::memory::{self, MemoryBudget, PhotographSizes};
use crate::world_up::up_of_card;
use relume_capture::{
    Capture, CaptureError, ColourMatrix, ImportLimits, ImportOptions, UndecodedCapture, Up,
    measure_colour_chart,
};
use relume_spec::training::{TrainConfig, TurntableCapture};
use serde::Deserialize;
use serde_json::Value;

/// A capture at the resolution of the training, without ground truth, so that no memory holds unused pixels. It has
/// the light rotations, the light groups, the grey card's colour and the colours of the chart that `config` states.
///
/// # Errors
/// [`TrainError::Capture`] for everything that the importer refuses, with file and field, for a light rotation of an
/// unknown photograph, and for a grey card or a colour chart that cannot be measured. [`TrainError::Memory`] if `budget` is too small.
/// This is checked before decoding, from the sizes in the headers and a few decoded photographs, and again after the
/// import, from all photographs.
pub fn import_for_training(
    path: &Path,
    config: &TrainConfig,
    limits: &ImportLimits,
    budget: MemoryBudget,
) -> Result<Capture, TrainError> {
    import_in_world(path, config, config.up.into(), limits, budget)
}

/// [`import_for_training`] with another up direction than that of `config`: the recorded one of a checkpoint
/// ([`crate::up_of_checkpoint`]), so that the resumed training has its world.
///
/// # Errors
/// As [`import_for_training`].
pub fn import_in_world(
    path: &Path,
    config: &TrainConfig,
    up: Up,
    limits: &ImportLimits,
    budget: MemoryBudget,
) -> Result<Capture, TrainError> {
    let chart = config.colour_chart.as_ref();
    let chart = chart.map(|chart| measure_colour_chart(path, limits, up, chart)).transpose()?;
    let options = ImportOptions {
        max_side: Some(config.resolution),
        limits: *limits,
        load_truth: false,
        up,
        turntable: config.turntable_capture,
        colour_matrix: chart.as_ref().map(|chart| chart.matrix),
    };
    let mut undecoded = UndecodedCapture::open(path, &options)?;
    memory::check(&PhotographSizes::undecoded(&mut undecoded)?, config, budget)?;
    let mut capture = undecoded.decode()?;
    memory::check(&PhotographSizes::of(&capture), config, budget)?;
    capture.set_light_rotations(&config.light_rotation_per_photo)?;
    capture.set_light_groups(&config.light_groups)?;
    if let Some(card) = &config.grey_card {
        capture.measure_grey_card(path, card, up, limits)?;
    }
    capture.warnings.extend(chart.iter().filter_map(|chart| chart.warning.clone()));
    capture.colour_chart = chart;
    Ok(capture)
}

/// With which choice a capture is imported for a comparison with a model of this card, so that its light rotates as in the training.
///
/// # Errors
/// [`TrainError::Invalid`] if the card has another value.
pub fn turntable_of_card(card: &Value) -> Result<TurntableCapture, TrainError> {
    let setting = card.pointer("/config/turntable_capture").map(TurntableCapture::deserialize).transpose();
    let setting = setting.map_err(|error| {
        TrainError::Invalid(format!(
            "the model card: config.turntable_capture: {error}; train the model again"
        ))
    })?;
    Ok(setting.unwrap_or(TurntableCapture::No))
}

/// Options that import the capture of the model of this card as its training did: in its world and with its colours. `max_side` limits the
/// longest side of the photographs, pixels; `None` keeps their size.
///
/// # Errors
/// [`TrainError::Invalid`] if the card has invalid settings.
pub fn import_options_of_card(
    card: &Value,
    max_side: Option<u32>,
    limits: ImportLimits,
) -> Result<ImportOptions, TrainError> {
    Ok(ImportOptions {
        max_side,
        limits,
        up: up_of_card(card)?,
        turntable: turntable_of_card(card)?,
        colour_matrix: colour_matrix_of_card(card)?,
        ..ImportOptions::default()
    })
}

/// Patterns of the light groups with which the model of this card was trained, by name.
pub fn light_groups_of_card(card: &Value) -> BTreeMap<String, String> {
    let groups = card.pointer("/config/light_groups").map(BTreeMap::deserialize);
    groups.and_then(Result::ok).unwrap_or_default()
}

/// Gives the photographs of a model's own capture the light rotations and light groups with which it was trained.
///
/// # Errors
/// [`CaptureError`] if the capture has other photographs.
pub fn light_like_card(capture: &mut Capture, card: &Value) -> Result<(), CaptureError> {
    let rotations = card.pointer("/config/light_rotation_per_photo").map(BTreeMap::deserialize);
    capture.set_light_rotations(&rotations.and_then(Result::ok).unwrap_or_default())?;
    capture.set_light_groups(&light_groups_of_card(card))
}

/// The matrix with which a capture is imported for a comparison with a model of this card, so that its photographs have the colours of the
/// training. `None` without a colour chart.
///
/// # Errors
/// [`TrainError::Invalid`] if the card has another value.
pub fn colour_matrix_of_card(card: &Value) -> Result<Option<ColourMatrix>, TrainError> {
    let matrix = card.pointer("/colour_chart/matrix").map(ColourMatrix::deserialize).transpose();
    matrix.map_err(|error| {
        TrainError::Invalid(format!("the model card: colour_chart.matrix: {error}; train the model again"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Trainer;
    use crate::calibration::calibrate;
    use relume_capture::{SyntheticOptions, synthetic, write_archive};
    use relume_engine::Device;
    use relume_scene::{BitDepth, PackedImage, srgb};
    use relume_spec::training::{GreyCard, Preset, TrainOverrides, WhiteBalance};
    use serde_json::json;

    const CARD: [f32; 3] = [0.5, 0.4, 0.2];

    /// A capture of 32 x 32 pixels whose second photograph shows a card at (20, 4), 8 x 6 pixels.
    fn capture_with_a_card() -> tempfile::NamedTempFile {
        let options =
            SyntheticOptions { size: 32, train_views: 3, test_views: 1, paths: 4, ..Default::default() };
        let mut capture = synthetic(&options).unwrap();
        let [r, g, b] = CARD.map(srgb::encode);
        let mut image = capture.train[1].image.decoded();
        for (x, y) in (4..10).flat_map(|y| (20..28).map(move |x| (x, y))) {
            image.pixels[y * 32 + x] = [r, g, b, 1.0];
        }
        capture.train[1].image = PackedImage::new(&image, BitDepth::Sixteen);
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), write_archive(&capture).unwrap()).unwrap();
        file
    }

    fn config(photo: &str, x: u32) -> TrainConfig {
        let card = GreyCard { photo: photo.into(), x, y: 4, width: 8, height: 6, reflectance: None };
        let overrides = TrainOverrides {
            // Half the stored size; the card is measured in the photograph at its stored size.
            resolution: Some(16),
            iterations: Some(4),
            warm_up: Some(0.0),
            initial_gaussians: Some(64),
            max_gaussians: Some(64),
            grey_card: Some(card),
            ..Default::default()
        };
        TrainConfig::new(Preset::Draft, &overrides).unwrap()
    }

    #[test]
    fn grey_card_measured_at_import_sets_the_white_balance() {
        let (file, config) = (capture_with_a_card(), config("train_001/rgba.png", 20));
        let mut capture =
            import_for_training(file.path(), &config, &ImportLimits::default(), MemoryBudget::unbounded())
                .unwrap();
        let colour = capture.grey_card.unwrap().colour;
        assert!((0..3).all(|c| (colour[c] - CARD[c]).abs() < 5e-3), "{colour:?}");
        let trained = |config: &TrainConfig, capture: &Capture| {
            let mut trainer = Trainer::new(capture, config.clone(), &Device::Cpu).unwrap();
            trainer.step().unwrap();
            let checkpoint = trainer.checkpoint().unwrap();
            // Resumed with the settings as the caller wrote them.
            let mut trainer = Trainer::resume(capture, config.clone(), &checkpoint, &Device::Cpu).unwrap();
            trainer.step().unwrap();
            assert_eq!(trainer.config().colour_source() == "white_balance", capture.grey_card.is_some());
            let mut model = trainer.model().unwrap();
            model.card = serde_json::Value::Null;
            model
        };
        let by_card = trained(&config, &capture);
        let told =
            TrainConfig { grey_card: None, white_balance: WhiteBalance::Colour(colour), ..config.clone() };
        assert_eq!(by_card, trained(&told, &capture), "same result as with a given colour");
        capture.grey_card = None;
        let estimated = TrainConfig { grey_card: None, ..config.clone() };
        assert_ne!(by_card, trained(&estimated, &capture), "the control");
        let refused = Trainer::new(&capture, config, &Device::Cpu).err().unwrap();
        assert!(matches!(refused, TrainError::Invalid(m) if m.starts_with("grey_card")));
    }

    #[test]
    fn grey_card_of_known_reflectance_determines_the_albedo() {
        let (file, mut config) = (capture_with_a_card(), config("train_001/rgba.png", 14));
        let limits = ImportLimits::default();
        let mut camera = None;
        let mut trained = |reflectance: Option<f32>| {
            let card = config.grey_card.as_mut().unwrap();
            (card.y, card.width, card.height, card.reflectance) = (18, 4, 3, reflectance);
            let capture =
                import_for_training(file.path(), &config, &limits, MemoryBudget::unbounded()).unwrap();
            let mut trainer = Trainer::new(&capture, config.clone(), &Device::Cpu).unwrap();
            while !trainer.is_done() {
                trainer.step().unwrap();
            }
            camera = camera.or(capture.grey_card.unwrap().camera);
            (trainer.model().unwrap(), camera.unwrap())
        };
        let scale = |(mut model, camera): (relume_scene::Model, _)| {
            calibrate(&mut model, &camera, [0.3; 3], &Device::Cpu).unwrap().scale
        };
        let calibrated = trained(Some(0.3));
        assert_eq!(calibrated.0.card["calibration"]["reflectance"], json!([0.3f32, 0.3f32, 0.3f32]));
        assert!(scale(calibrated).iter().all(|s| (s - 1.0).abs() < 0.01));
        let control = trained(None);
        assert!(control.0.card.get("calibration").is_none());
        assert!(scale(control).iter().any(|s| (s - 1.0).abs() > 0.1), "the control");
    }

    #[test]
    fn grey_card_that_cannot_be_measured_is_refused_by_field() {
        let file = capture_with_a_card();
        for (photo, x, field) in [
            ("train_009/rgba.png", 20, "grey_card.photo"),
            ("rgba.png", 20, "grey_card.photo"),
            ("train_001/rgba.png", 25, "grey_card.width"),
        ] {
            let imported = import_for_training(
                file.path(),
                &config(photo, x),
                &ImportLimits::default(),
                MemoryBudget::unbounded(),
            );
            let Err(TrainError::Capture(error)) = imported else { panic!("must be refused: {imported:?}") };
            assert_eq!((error.file(), error.field()), (Some(photo), Some(field)), "{error}");
        }
    }

    #[test]
    fn rotations_of_the_light_are_derived_for_a_stated_turntable() {
        let (file, config) = (capture_with_a_card(), config("train_001/rgba.png", 20));
        let rotations = |choice: TurntableCapture| {
            let config = TrainConfig { turntable_capture: choice, ..config.clone() };
            let limits = ImportLimits::default();
            let capture =
                import_for_training(file.path(), &config, &limits, MemoryBudget::unbounded()).unwrap();
            let views = capture.train.iter().chain(&capture.test);
            (views.filter(|view| view.light_rotation_deg != 0.0).count(), capture.facts().count())
        };
        assert_eq!(rotations(TurntableCapture::Yes), (3, 1), "the first photograph defines the zero");
        assert_eq!(rotations(TurntableCapture::Auto), (0, 0), "a plain background is no evidence");
    }

    #[test]
    fn comparison_uses_the_choice_of_the_training() {
        let of = |card: Value| turntable_of_card(&card);
        let card = json!({ "config": config("a", 0) });
        assert_eq!(of(card).unwrap(), TurntableCapture::Auto);
        assert_eq!(of(json!({ "config": {} })).unwrap(), TurntableCapture::No, "a model of an older version");
        let error = of(json!({ "config": { "turntable_capture": 3 } })).unwrap_err().to_string();
        assert!(error.contains("config.turntable_capture"), "{error}");
    }

    #[test]
    fn colour_matrix_of_a_model_is_that_of_its_card() {
        let rows = [[1.0, 0.1, 0.0], [0.0, 1.5, 0.0], [0.0, 0.0, 2.0]];
        let card = json!({ "colour_chart": { "matrix": rows } });
        assert_eq!(colour_matrix_of_card(&card).unwrap(), Some(ColourMatrix(rows)));
        assert_eq!(colour_matrix_of_card(&json!({ "colour_chart": null })).unwrap(), None);
        let error = colour_matrix_of_card(&json!({ "colour_chart": { "matrix": [1, 2] } })).unwrap_err();
        assert!(error.to_string().contains("colour_chart.matrix"), "{error}");
    }

    #[test]
    fn capture_exceeding_memory_is_refused_before_decoding() {
        let (file, config) = (capture_with_a_card(), config("train_001/rgba.png", 20));
        let import = |available| {
            let budget = MemoryBudget { on_device: false, available: Some(available) };
            import_for_training(file.path(), &config, &ImportLimits::default(), budget)
        };
        let refused = import(1000);
        let Err(TrainError::Memory(why)) = &refused else { panic!("must be refused: {refused:?}") };
        assert!(why.contains("4 photographs of up to 16x16"), "{why}");
        assert!(import(1 << 30).is_ok(), "the control");
    }

    #[test]
    fn grey_card_with_white_balance_or_without_pixels_is_refused() {
        let refused = |overrides: &str| {
            let overrides: TrainOverrides = serde_json::from_str(overrides).unwrap();
            TrainConfig::new(Preset::Draft, &overrides).map_err(|error| error.field)
        };
        let card = |width: u32| {
            format!(r#""grey_card": {{"photo": "a", "x": 0, "y": 0, "width": {width}, "height": 1}}"#)
        };
        assert_eq!(refused(&format!("{{{}}}", card(0))).unwrap_err(), "grey_card.width");
        let both = format!(r#"{{"white_balance": "neutral", {}}}"#, card(1));
        assert_eq!(refused(&both).unwrap_err(), "grey_card");
        assert!(refused(&format!("{{{}}}", card(1))).is_ok(), "the control");
    }
}
