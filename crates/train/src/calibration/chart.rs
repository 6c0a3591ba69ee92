//! Scales the albedo of a model to the neutral patches of a colour chart.

use glam::{DVec3, Vec3};
use serde::Serialize;

use crate::calibration::{
    AlbedoViewer, CalibrationError, CalibrationTime, MIN_ALBEDO, covered_albedo, history, scale_model,
};
use relume_capture::{ChartPatch, DeltaE};
use relume_engine::Device;
use relume_scene::Model;

/// A calibration by a colour chart.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ChartCalibration {
    /// Factor on the albedo of the model, by channel. The light is divided by it.
    pub scale: [f32; 3],
    /// Number of neutral patches that the model covers.
    pub neutral_patches: usize,
    /// Number of all patches that the model covers.
    pub patches: usize,
    /// CIEDE2000 between the albedo of the model in these patches and their reflectance, before the calibration.
    pub before: DeltaE,
    /// The same after the calibration.
    pub after: DeltaE,
}

/// Calibrates `model` by the chart whose patches these are. The factor of a channel is `sum(r a) / sum(a^2)` over the neutral patches that
/// the model covers, with the albedo `a` of the model and the reflectance `r`: the least squares of `s a - r`.
///
/// # Errors
/// [`CalibrationError::NoNeutralPatch`] if the model covers none of them. The model is then unchanged.
pub fn calibrate_by_chart(
    model: &mut Model,
    patches: &[ChartPatch],
    device: &Device,
    time: CalibrationTime,
) -> Result<ChartCalibration, CalibrationError> {
    let viewer = AlbedoViewer::new(model, device)?;
    let mut covered = Vec::new();
    for patch in patches {
        let Some(camera) = &patch.camera else { continue };
        match covered_albedo(&viewer.frame(camera)?) {
            Ok(albedo) => covered.push((patch, Vec3::from(albedo))),
            Err(CalibrationError::NotCovered(_)) => {}
            Err(error) => return Err(error),
        }
    }
    drop(viewer);
    let (mut cross, mut square, mut neutral_patches) = (Vec3::ZERO, Vec3::ZERO, 0);
    for (patch, albedo) in covered.iter().filter(|(patch, _)| patch.is_neutral) {
        cross += *albedo * Vec3::from(patch.reflectance);
        square += *albedo * *albedo;
        neutral_patches += 1;
    }
    if neutral_patches == 0 {
        return Err(CalibrationError::NoNeutralPatch);
    }
    if !(square.min_element() >= MIN_ALBEDO * MIN_ALBEDO) {
        return Err(CalibrationError::TooDark(square.min_element().sqrt()));
    }
    let scale = cross / square;
    let difference = |scale: Vec3| {
        let pair = |(patch, albedo): &(&ChartPatch, Vec3)| -> (DVec3, DVec3) {
            ((*albedo * scale).as_dvec3(), Vec3::from(patch.reflectance).as_dvec3())
        };
        DeltaE::of(covered.iter().map(pair)).ok_or(CalibrationError::NoNeutralPatch)
    };
    let (before, after) = (difference(Vec3::ONE)?, difference(scale)?);
    let calibration =
        ChartCalibration { scale: scale.to_array(), neutral_patches, patches: covered.len(), before, after };
    scale_model(model, calibration.scale);
    let entry = serde_json::json!({ "chart": calibration, "scale": calibration.scale });
    history::record(model, entry, calibration.scale, time);
    Ok(calibration)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::tests::{ALBEDO, above, disc};
    use relume_compare::largest_difference;

    fn patch(x: f64, reflectance: [f32; 3], is_neutral: bool) -> ChartPatch {
        ChartPatch { name: "neutral 5", reflectance, is_neutral, camera: Some(above(x)) }
    }

    #[test]
    fn neutral_patches_determine_the_scale_of_each_channel() {
        let mut model = disc();
        model.card = serde_json::json!({});
        let patches = [
            patch(0.0, [0.2, 0.19, 0.21], true),
            patch(0.02, [0.2, 0.19, 0.21], true),
            patch(0.0, [0.9, 0.1, 0.1], false),
            patch(9.0, [0.9, 0.9, 0.9], true),
            ChartPatch { camera: None, ..patch(0.0, [0.9, 0.9, 0.9], true) },
        ];
        let done =
            calibrate_by_chart(&mut model, &patches, &Device::Cpu, CalibrationTime::InTraining).unwrap();
        assert_eq!((done.neutral_patches, done.patches), (2, 3));
        let wanted = [0.2 / ALBEDO[0], 0.19 / ALBEDO[1], 0.21 / ALBEDO[2]];
        assert!(largest_difference(&done.scale, &wanted) < 5e-3, "{done:?}");
        assert!(largest_difference(&done.scale, &[1.0; 3]) > 0.2, "the control");
        assert!(
            largest_difference(&model.prototypes[0], &[0.2, 0.19, 0.21]) < 2e-3,
            "{:?}",
            model.prototypes
        );
        assert_eq!(model.card["calibration"]["chart"]["neutral_patches"], 2);
        let neutral =
            calibrate_by_chart(&mut model, &patches[..2], &Device::Cpu, CalibrationTime::InTraining).unwrap();
        assert!(
            neutral.before.max < 0.5 && largest_difference(&neutral.scale, &[1.0; 3]) < 1e-3,
            "{neutral:?}"
        );
        assert!(done.before.mean > done.after.mean && done.after.mean > neutral.after.mean, "{done:?}");
    }

    #[test]
    fn charts_that_the_model_does_not_cover_are_refused() {
        let mut model = disc();
        let patches = [patch(9.0, [0.2; 3], true), patch(0.0, [0.9, 0.1, 0.1], false)];
        let error =
            calibrate_by_chart(&mut model, &patches, &Device::Cpu, CalibrationTime::InTraining).unwrap_err();
        assert!(matches!(error, CalibrationError::NoNeutralPatch), "{error}");
        assert_eq!(model, disc(), "unchanged");
        model.prototypes = vec![[0.4, 0.001, 0.4]];
        let dark = calibrate_by_chart(
            &mut model,
            &[patch(0.0, [0.2; 3], true)],
            &Device::Cpu,
            CalibrationTime::InTraining,
        )
        .unwrap_err();
        assert!(matches!(dark, CalibrationError::TooDark(_)), "{dark}");
    }
}
