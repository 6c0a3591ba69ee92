//! The model card: the inputs and findings of a training.

use std::collections::BTreeMap;

use crate::calibration::{CalibrationTime, calibrate, calibrate_by_chart};
use crate::dataset::Gain;
use crate::time_budget::plan_card;
use crate::trainer::Trainer;
use crate::{TrainError, exposure, light_groups, sampling_rate, trust};
use relume_engine::{Device, PhotoSize};
use relume_scene::light::LightColour;
use relume_scene::{Model, SplitLight};

impl Trainer {
    /// The current model with its card.
    ///
    /// # Errors
    /// [`TrainError::Device`] when the device failed.
    pub fn model(&mut self) -> Result<Model, TrainError> {
        self.wait_for_finite_state()?;
        let mut model = self.engine.state()?.model.clone();
        light_groups::restore_levels(&mut model, &self.data.relative_lights);
        sampling_rate::measure(&mut model.gaussians, &self.data.cameras(PhotoSize::Full));
        model.card = serde_json::json!({
            "relume_version": env!("CARGO_PKG_VERSION"),
            "engine": self.engine.engine(),
            "steps": self.schedule.step,
            "gaussians": model.gaussians.len(),
            "photographs": self.data.len(),
            "has_alpha": self.data.has_alpha,
            "complexity": self.schedule.complexity.card(&self.config, &model.gaussians),
            "light": self.light_card(&model),
            "exposures": self.exposures_card(),
            "colour_chart": self.chart_card(),
            "up": self.schedule.up,
            "photographed_views": self.photographed_views(&model),
            "crop": self.crop_card(),
            "config": self.config,
        });
        if let Some((field, plan)) = plan_card(&self.config, &self.schedule.timeline) {
            model.card[field] = plan;
        }
        if self.is_done() && self.is_relightable() {
            let state = self.engine.state()?.into_owned();
            model.gaussians.set_confidence(trust::confidence(&state, &self.context(), &self.data));
        }
        self.calibrate(&mut model);
        Ok(model)
    }

    /// Scales albedo and light to the reflectance of the grey card or of the colour chart, if it is known. The model card has the reason if
    /// that is impossible.
    fn calibrate(&self, model: &mut Model) {
        let has_level = self.config.colour_chart.as_ref().is_some_and(|chart| chart.level);
        if let Some(chart) = self.data.chart.as_ref().filter(|_| has_level)
            && let Err(error) =
                calibrate_by_chart(model, &chart.patches, &Device::Cpu, CalibrationTime::InTraining)
        {
            model.card["calibration"] = serde_json::json!({ "error": error.to_string() });
        }
        let reflectance = self.config.grey_card.as_ref().and_then(|card| card.reflectance);
        let camera = self.data.card.and_then(|card| card.camera);
        if let Some((camera, reflectance)) = camera.zip(reflectance)
            && let Err(error) = calibrate(model, &camera, [reflectance; 3], &Device::Cpu)
        {
            model.card["calibration"] = serde_json::json!({ "error": error.to_string() });
        }
    }

    /// The colour chart and the matrix that the photographs have; null without a chart.
    fn chart_card(&self) -> serde_json::Value {
        let (Some(chart), Some(setting)) = (&self.data.chart, &self.config.colour_chart) else {
            return serde_json::Value::Null;
        };
        serde_json::json!({
            "photo": setting.photo,
            "matrix": chart.matrix,
            "delta_e_2000": { "before": chart.before, "after": chart.after },
            "patches": chart.patches.len() - chart.left_out.len(),
            "left_out": chart.left_out,
            "order": chart.order,
        })
    }

    /// Findings about the light.
    fn light_card(&self, model: &Model) -> serde_json::Value {
        let of = |(k, light): (usize, &SplitLight)| {
            serde_json::json!({
                "direction": light.direction,
                "radius_deg": light.radius.to_degrees(),
                "sharp_over_soft_shadows": self.schedule.lights.get(k),
            })
        };
        let lights: Vec<_> = model.lights.lights.iter().enumerate().map(of).collect();
        let mut card = serde_json::json!({
            "colour": self.schedule.light_colour.map(LightColour::rgb),
            "colour_from": self.config.colour_source(),
            "lights": lights,
            "surroundings": self.schedule.surroundings.as_ref().map(|surroundings| surroundings.card()),
        });
        if self.data.light_groups.len() > 1 {
            card["groups"] = serde_json::json!(self.data.light_groups);
        }
        card
    }

    /// The region of the crop, in units and axes of the capture; null without a crop.
    fn crop_card(&self) -> serde_json::Value {
        let Some(cut) = &self.schedule.cut else { return serde_json::Value::Null };
        let capture = self.capture_region(&cut.region);
        serde_json::json!({ "ball": capture, "is_on_ground": cut.region.ground.is_some() })
    }

    /// Total gains by which photographs were divided, by name, and their spread; null without corrections.
    fn exposures_card(&self) -> serde_json::Value {
        let mut rounds = self.schedule.gains.iter();
        let Some(mut all) = rounds.next().cloned() else { return serde_json::Value::Null };
        for round in rounds {
            all.iter_mut().zip(round).for_each(|(all, gain)| (0..3).for_each(|c| all[c] *= gain[c]));
        }
        let gains: BTreeMap<&str, Gain> =
            self.data.names.iter().map(String::as_str).zip(all.iter().copied()).collect();
        let [green, red, blue] = exposure::spread(&all);
        serde_json::json!({ "spread": { "green": green, "red_over_green": red, "blue_over_green": blue }, "gains": gains })
    }
}
