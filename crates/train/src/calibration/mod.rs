//! Scales the albedo of a model to the known reflectance of one surface.
//!
//! Photographs determine the product of albedo and light, not the level of either. One surface of known reflectance determines both:
//! albedo is multiplied by a number per channel, and the light divided by it.

mod chart;
mod history;

use std::sync::Arc;

use serde::Serialize;
use serde_json::json;

use crate::render::{Frame, PreparedLight, RenderError, Renderer};
use relume_engine::{Device, DeviceError};
use relume_scene::{Camera, Field, Model, softplus, softplus_inverse};
use relume_spec::rendering::{Output, Tier};
use relume_spec::training::GreyCard;

/// Least mean coverage of the patch: below it the model has no surface there.
const MIN_COVERAGE: f32 = 0.5;
/// Least albedo of a channel that is scaled; a darker one gives no reliable ratio.
const MIN_ALBEDO: f32 = 0.005;

pub use chart::{ChartCalibration, calibrate_by_chart};
pub use history::{CalibrationTime, total_scale, undo_calibration};

/// A calibration by one patch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Calibration {
    /// Known reflectance of the patch, linear Rec.709.
    pub reflectance: [f32; 3],
    /// Mean albedo of the model in the patch before the calibration.
    pub albedo_before: [f32; 3],
    /// Factor on the albedo of the model, by channel. The light is divided by it.
    pub scale: [f32; 3],
}

/// Errors of a calibration.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// The model has no albedo.
    #[error("the model has colours only, no albedo to calibrate")]
    NoMaterials,
    /// A reflectance outside of the accepted range.
    #[error("reflectance: {0} must be between 0.01 and 1")]
    Reflectance(f32),
    /// The patch shows too little of the model.
    #[error("patch: the model covers {:.0} % of it; choose a patch on the subject", 100.0 * .0)]
    NotCovered(f32),
    /// The model is too dark in the patch.
    #[error(
        "patch: the albedo of the model there is {0:.4} in a channel, too dark to be scaled; choose a brighter patch"
    )]
    TooDark(f32),
    /// The model covers no neutral patch of the colour chart.
    #[error(
        "colour chart: the model covers none of its neutral patches; the chart must be part of the model"
    )]
    NoNeutralPatch,
    /// The patch could not be rendered.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// The device failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

/// Calibrates `model` by the surface that `patch` sees, whose `reflectance` is known. This is a part of a training, so
/// [`undo_calibration`] does not undo it.
///
/// # Errors
/// [`CalibrationError`] names the patch or the reflectance. The model is then unchanged.
pub fn calibrate(
    model: &mut Model,
    patch: &Camera,
    reflectance: [f32; 3],
    device: &Device,
) -> Result<Calibration, CalibrationError> {
    check(model, reflectance)?;
    let albedo_before = measure_albedo(model, patch, device)?;
    let calibration = Calibration::of(reflectance, albedo_before);
    scale_model(model, calibration.scale);
    history::record(model, json!(calibration), calibration.scale, CalibrationTime::InTraining);
    Ok(calibration)
}

/// Calibrates a finished model by a surface of known `reflectance`. `albedo` is the mean albedo of the model there, or why there is
/// none ([`measure_albedo`], [`patch_albedo`]).
///
/// The model card gets the [`Calibration`] with what [`CalibrationTime::Finished`] adds.
///
/// # Errors
/// The error of `albedo`, or [`CalibrationError`] that names the reflectance or the lack of materials. The model is then unchanged.
pub fn calibrate_finished(
    model: &mut Model,
    albedo: Result<[f32; 3], CalibrationError>,
    reflectance: [f32; 3],
) -> Result<Calibration, CalibrationError> {
    check(model, reflectance)?;
    let calibration = Calibration::of(reflectance, albedo?);
    scale_model(model, calibration.scale);
    history::record(model, json!(calibration), calibration.scale, CalibrationTime::Finished);
    Ok(calibration)
}

impl Calibration {
    fn of(reflectance: [f32; 3], albedo_before: [f32; 3]) -> Self {
        let scale = std::array::from_fn(|c| reflectance[c] / albedo_before[c]);
        Self { reflectance, albedo_before, scale }
    }
}

fn check(model: &Model, reflectance: [f32; 3]) -> Result<(), CalibrationError> {
    if let Some(bad) = reflectance.iter().find(|r| !GreyCard::REFLECTANCE.contains(*r)) {
        return Err(CalibrationError::Reflectance(*bad));
    }
    if model.has_materials() { Ok(()) } else { Err(CalibrationError::NoMaterials) }
}

/// Multiplies the albedo by `scale` and divides the light by it.
fn scale_model(model: &mut Model, scale: [f32; 3]) {
    scale_albedo(model, scale);
    for raw in &mut model.env_raw {
        *raw = std::array::from_fn(|c| softplus_inverse(softplus(raw[c]) / scale[c]));
    }
}

/// Mean albedo of `model` in the picture of `patch`, linear Rec.709.
///
/// # Errors
/// [`CalibrationError`] names the patch or the lack of materials, or is that of the renderer.
pub fn measure_albedo(model: &Model, patch: &Camera, device: &Device) -> Result<[f32; 3], CalibrationError> {
    patch_albedo(&AlbedoViewer::new(model, device)?.frame(patch)?)
}

/// Mean albedo in a frame with [`Output::Albedo`], linear Rec.709, weighted with the coverage.
///
/// # Errors
/// [`CalibrationError`] names the patch if the frame shows too little of the model, or if it is too dark there.
pub fn patch_albedo(frame: &Frame) -> Result<[f32; 3], CalibrationError> {
    let mean = covered_albedo(frame)?;
    match mean.iter().find(|v| !(**v >= MIN_ALBEDO)) {
        Some(dark) => Err(CalibrationError::TooDark(*dark)),
        None => Ok(mean),
    }
}

/// Mean albedo in a frame, however dark, weighted with the coverage.
///
/// # Errors
/// [`CalibrationError::NotCovered`] without a surface there.
fn covered_albedo(frame: &Frame) -> Result<[f32; 3], CalibrationError> {
    let plane = |output| frame.planes.get(&output).map_or(&[][..], Vec::as_slice);
    let (albedo, alpha) = (plane(Output::Albedo).as_chunks::<3>().0, plane(Output::Alpha));
    let covered: f32 = alpha.iter().sum();
    let coverage = covered / alpha.len().max(1) as f32;
    if !(coverage >= MIN_COVERAGE) {
        return Err(CalibrationError::NotCovered(coverage));
    }
    Ok(std::array::from_fn(|c| albedo.iter().zip(alpha).map(|(v, a)| v[c] * a).sum::<f32>() / covered))
}

/// Renders the albedo of a model.
struct AlbedoViewer {
    renderer: Renderer,
    light: PreparedLight,
}

impl AlbedoViewer {
    fn new(model: &Model, device: &Device) -> Result<Self, CalibrationError> {
        if !model.has_materials() {
            return Err(CalibrationError::NoMaterials);
        }
        let renderer = Renderer::on(Arc::new(model.clone()), device)?;
        let light = renderer.prepare_light(model.recovered_light())?;
        Ok(Self { renderer, light })
    }

    /// The albedo in the picture of `patch`.
    fn frame(&self, patch: &Camera) -> Result<Frame, CalibrationError> {
        Ok(self.renderer.render(patch, &self.light, Tier::Standard, &[Output::Albedo])?)
    }
}

/// The model with its albedo multiplied per channel. Albedo is linear in prototypes and residuals (article Eq. 23),
/// so both are multiplied and nothing else changes.
pub(crate) fn with_scaled_albedo(model: &Model, scale: [f32; 3]) -> Model {
    let mut scaled = model.clone();
    scale_albedo(&mut scaled, scale);
    scaled
}

fn scale_albedo(model: &mut Model, scale: [f32; 3]) {
    for prototype in &mut model.prototypes {
        (0..3).for_each(|k| prototype[k] *= scale[k]);
    }
    let residuals = model.gaussians.field_mut(Field::Residual);
    residuals.iter_mut().enumerate().for_each(|(i, v)| *v *= scale[i % 3]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use relume_compare::largest_difference;
    use relume_scene::Gaussians;

    pub(super) const ALBEDO: [f32; 3] = [0.4, 0.3, 0.2];

    /// An opaque disc of one albedo at the origin, under a uniform light of radiance 1.
    pub(super) fn disc() -> Model {
        let mut g = Gaussians::zeroed(1, 1, 0, 0);
        g.row_mut(Field::LogScale, 0).copy_from_slice(&[-1.0, -1.0, -4.0]);
        g.row_mut(Field::Quaternion, 0)[0] = 1.0;
        g.row_mut(Field::OpacityLogit, 0)[0] = 8.0;
        g.row_mut(Field::Normal, 0)[2] = 1.0;
        Model::new(g, vec![ALBEDO], vec![[softplus_inverse(1.0); 3]; 8], (4, 2))
    }

    /// The view of a small part of the disc, or of nothing.
    pub(super) fn above(x: f64) -> Camera {
        let eye = DVec3::new(x, 0.0, 2.0);
        Camera::look_at(eye, DVec3::new(x, 0.0, 0.0), DVec3::Y, 0.02, (4, 4)).unwrap()
    }

    #[test]
    fn calibration_scales_albedo_and_keeps_the_diffuse_light() {
        let (before, wanted) = (disc(), [0.2, 0.3, 0.4]);
        let mut model = before.clone();
        model.card = serde_json::json!({});
        let done = calibrate(&mut model, &above(0.0), wanted, &Device::Cpu).unwrap();
        assert!(largest_difference(&done.albedo_before, &ALBEDO) < 1e-3, "{done:?}");
        let after = measure_albedo(&model, &above(0.0), &Device::Cpu).unwrap();
        assert!(largest_difference(&after, &wanted) < 1e-3, "{after:?}");
        assert!(largest_difference(&ALBEDO, &wanted) > 0.1, "the control: the albedo before");
        for c in 0..3 {
            let reflected = |m: &Model| m.prototypes[0][c] * softplus(m.env_raw[0][c]);
            assert!((reflected(&model) / reflected(&before) - 1.0).abs() < 1e-3);
        }
        assert_eq!(model.card["calibration"]["reflectance"], serde_json::json!(wanted));
    }

    /// The largest relative difference of albedo and light between two discs.
    fn largest_change(a: &Model, b: &Model) -> f64 {
        let values = |m: &Model| [m.prototypes[0], m.env_raw[0].map(softplus), m.env_raw[7].map(softplus)];
        let ratios: Vec<f32> =
            values(a).iter().flatten().zip(values(b).iter().flatten()).map(|(a, b)| a / b).collect();
        largest_difference(&ratios, &[1.0; 9])
    }

    #[test]
    fn calibrations_since_the_training_are_undone_together() {
        let mut model = disc();
        model.card = json!({ "steps": 7 });
        calibrate(&mut model, &above(0.0), [0.5; 3], &Device::Cpu).unwrap();
        let trained = model.clone();
        assert!(!undo_calibration(&mut model), "the calibration of a training stays");
        assert_eq!(model, trained);
        for wanted in [[0.9, 0.1, 0.2], [0.3, 0.8, 0.05], [0.18; 3]] {
            let albedo = measure_albedo(&model, &above(0.0), &Device::Cpu);
            calibrate_finished(&mut model, albedo, wanted).unwrap();
            let after = measure_albedo(&model, &above(0.0), &Device::Cpu).unwrap();
            assert!(largest_difference(&after, &wanted) < 1e-3, "{after:?}");
        }
        assert_eq!(model.card["calibration"]["in_training"], trained.card["calibration"]);
        assert!(largest_change(&model, &trained) > 0.5, "the control");
        assert!(undo_calibration(&mut model));
        assert_eq!(model.card, trained.card);
        assert!(largest_change(&model, &trained) < 1e-5);

        model.card = json!({ "steps": 7 });
        let albedo = measure_albedo(&model, &above(0.0), &Device::Cpu);
        calibrate_finished(&mut model, albedo, [0.3; 3]).unwrap();
        assert!(undo_calibration(&mut model) && !undo_calibration(&mut model));
        assert_eq!(model.card, json!({ "steps": 7 }));
    }

    #[test]
    fn finished_model_is_unchanged_by_a_refused_calibration() {
        let mut model = disc();
        model.card = json!({ "calibration": { "total_scale": [1.0, 0.0, 1.0] } });
        let before = model.clone();
        assert!(!undo_calibration(&mut model), "a factor of 0 cannot be undone");
        let dark = calibrate_finished(&mut model, Err(CalibrationError::TooDark(0.0)), [0.2; 3]);
        assert!(matches!(dark, Err(CalibrationError::TooDark(_))));
        let range = calibrate_finished(&mut model, Ok([0.2; 3]), [0.2, 0.2, 1.5]);
        assert!(matches!(range, Err(CalibrationError::Reflectance(_))));
        assert_eq!(model, before);
    }

    #[test]
    fn calibration_refuses_patches_that_determine_nothing() {
        let mut model = disc();
        let empty = calibrate(&mut model, &above(9.0), [0.2; 3], &Device::Cpu).unwrap_err();
        assert!(matches!(empty, CalibrationError::NotCovered(_)), "{empty}");
        let error = calibrate(&mut model, &above(0.0), [0.2, f32::NAN, 0.2], &Device::Cpu).unwrap_err();
        assert!(matches!(error, CalibrationError::Reflectance(_)), "{error}");
        assert_eq!(model, disc(), "unchanged");
        model.prototypes = vec![[0.4, 0.001, 0.4]];
        let dark = calibrate(&mut model, &above(0.0), [0.2; 3], &Device::Cpu).unwrap_err();
        assert!(matches!(dark, CalibrationError::TooDark(_)), "{dark}");
    }

    #[test]
    fn albedo_scaling_changes_only_prototypes_and_residuals() {
        let mut gaussians = Gaussians::zeroed(2, 1, 0, 0);
        gaussians.fields_mut().for_each(|(_, _, d)| d.fill(1.0));
        let model = Model::new(gaussians, vec![[0.5; 3]], vec![[0.0; 3]; 2], (2, 1));
        let mut scaled = with_scaled_albedo(&model, [2.0, 3.0, 4.0]);
        assert_eq!(scaled.prototypes, vec![[1.0, 1.5, 2.0]]);
        assert_eq!(scaled.gaussians.field(Field::Residual), &[2.0, 3.0, 4.0, 2.0, 3.0, 4.0]);
        scaled.prototypes.clone_from(&model.prototypes);
        scaled.gaussians.field_mut(Field::Residual).fill(1.0);
        assert_eq!(scaled, model);
    }
}
