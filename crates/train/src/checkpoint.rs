//! Checkpoints: the complete state of a training as one safetensors file with a versioned header.

use std::collections::HashMap;
use std::sync::Arc;

use rand_chacha::ChaCha8Rng;
use safetensors::SafeTensors;
use serde::{Deserialize, Serialize};

use crate::complexity::state::ComplexityState;
use crate::crop::{Region, SILHOUETTE, SubjectCrop};
use crate::dataset::Gain;
use crate::error::TrainError;
use crate::state::ScheduleState;
use crate::surroundings::SurroundingLight;
use crate::time_budget::{BudgetState, PlanChange, Timeline};
use relume_capture::WorldUp;
use relume_capture::formats::model_file::{self, Tensor, floats};
use relume_engine::{DensityStats, Moments, TrainState};
use relume_scene::light::LightColour;
use relume_scene::{Field, Gaussians, MAX_LIGHTS};
use relume_spec::training::{TrainConfig, UpAxis};

const VERSION: u32 = 1;
const HEADER_KEY: &str = "relume_checkpoint";
/// Tensor of the summed absgrad; all files of this version use this name.
const ABSGRAD_KEY: &str = "density.pull";

#[derive(Serialize, Deserialize)]
struct Header {
    version: u32,
    config: TrainConfig,
    step: u32,
    order: Vec<u32>,
    cursor: u32,
    rng: ChaCha8Rng,
    rate_factor: f32,
    seconds: f64,
    #[serde(default)]
    complexity: ComplexityState,
    #[serde(default)]
    light_colour: Option<LightColour>,
    #[serde(default)]
    gains: Vec<Vec<Gain>>,
    #[serde(default)]
    lights: Vec<f32>,
    /// Absent where the surroundings do not determine the light.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    surroundings: Option<SurroundingLight>,
    /// Absent in checkpoints of versions that did not record it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    up: Option<WorldUp>,
    /// Region of the crop, and number of Gaussians before it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cut: Option<(Region, usize)>,
    /// Changes of the number of steps; absent without changes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    plan: Vec<PlanChange>,
    /// Absent without a time budget.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    budget: Option<BudgetState>,
    labels: usize,
    gathered: usize,
    /// Absent in checkpoints of older versions, which have no lights.
    #[serde(default)]
    arriving: usize,
}

/// Name of the tensor of a field of the Gaussians before the crop.
fn cut_key(field: Field) -> String {
    format!("cut.{}", field.name())
}

fn bad(field: &str, reason: impl std::fmt::Display) -> TrainError {
    TrainError::Checkpoint(format!("{field}: {reason}"))
}

/// The bytes of a checkpoint.
///
/// # Errors
/// [`TrainError::Checkpoint`] if a parameter is not finite.
pub fn encode(
    schedule: &ScheduleState,
    state: &TrainState,
    config: &TrainConfig,
) -> Result<Vec<u8>, TrainError> {
    if let Err(e) = state.model.check() {
        return Err(bad(e.field, e.reason));
    }
    let header = Header {
        version: VERSION,
        config: config.clone(),
        step: schedule.step,
        order: schedule.order.clone(),
        cursor: schedule.cursor,
        rng: schedule.rng.clone(),
        rate_factor: schedule.rate_factor,
        seconds: schedule.seconds,
        complexity: schedule.complexity.clone(),
        light_colour: schedule.light_colour,
        gains: schedule.gains.clone(),
        lights: schedule.lights.clone(),
        surroundings: schedule.surroundings.as_deref().cloned(),
        up: schedule.up.clone(),
        cut: schedule.cut.as_ref().map(|cut| (cut.region, cut.gaussians.len())),
        plan: schedule.timeline.changes().to_vec(),
        budget: schedule.budget,
        labels: state.labels.len(),
        gathered: state.gathered.len(),
        arriving: state.arriving.len(),
    };
    let text = serde_json::to_string(&header).map_err(|e| bad("header", e))?;
    let metadata = HashMap::from([
        (HEADER_KEY.to_owned(), text),
        ("relume".to_owned(), model_file::header(&state.model)),
    ]);
    let mut tensors = model_file::tensors(&state.model);
    for (prefix, g) in [("first", &state.moments.first), ("second", &state.moments.second)] {
        for field in Field::ALL {
            let name = format!("{prefix}.{}", field.name());
            tensors.push((name, Tensor::new([g.len(), g.width(field)], g.field(field))));
        }
    }
    if let Some(cut) = &schedule.cut {
        let g = &cut.gaussians;
        let tensor = |f: Field| (cut_key(f), Tensor::new([g.len(), g.width(f)], g.field(f)));
        tensors.extend(SILHOUETTE.map(tensor));
    }
    let mut flat =
        |name: &str, data| tensors.push((name.to_owned(), Tensor::new([<[f32]>::len(data)], data)));
    flat("first.globals", bytemuck::cast_slice(&state.moments.globals[0]));
    flat("second.globals", bytemuck::cast_slice(&state.moments.globals[1]));
    flat(ABSGRAD_KEY, &state.density.absgrad);
    flat("density.seen", &state.density.seen);
    flat("labels", &state.labels);
    flat("gathered", bytemuck::cast_slice(&state.gathered));
    if !state.arriving.is_empty() {
        flat("arriving", state.arriving.as_flattened());
    }
    safetensors::serialize(tensors, Some(metadata)).map_err(|e| bad("container", e))
}

fn header(bytes: &[u8]) -> Result<Header, TrainError> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(|e| bad("container", e))?;
    let text = metadata.metadata().as_ref().and_then(|m| m.get(HEADER_KEY));
    let text = text.ok_or_else(|| bad("header", "is missing: this is not a checkpoint"))?;
    let header: Header = serde_json::from_str(text).map_err(|e| bad("header", e))?;
    if header.version != VERSION {
        return Err(bad("version", format!("is {}; this build reads {VERSION}", header.version)));
    }
    Ok(header)
}

/// The setting `up` of a checkpoint, and the direction that it recorded.
///
/// # Errors
/// [`TrainError::Checkpoint`] if the header is damaged or of another version.
pub fn up(bytes: &[u8]) -> Result<(UpAxis, Option<WorldUp>), TrainError> {
    let header = header(bytes)?;
    Ok((header.config.up, header.up))
}

/// The configuration of a training that resumes from a checkpoint: `config` as its caller states it, with the settings
/// that the checkpoint's training had planned for the same time budget. Without a time budget it is `config`.
///
/// # Errors
/// [`TrainError::Checkpoint`] if the header is damaged, of another version, or of another time budget.
pub fn planned_config(bytes: &[u8], config: &TrainConfig) -> Result<TrainConfig, TrainError> {
    let header = header(bytes)?;
    if header.config.time_budget_s != config.time_budget_s {
        let reason =
            "differs from the time budget of this training: give the same one, or another checkpoint file";
        return Err(bad("config.time_budget_s", reason));
    }
    let mut planned = config.clone();
    if config.time_budget_s.is_some() {
        planned.adopt_plan(&header.config);
    }
    Ok(planned)
}

/// Reads a checkpoint of the same configuration.
///
/// # Errors
/// Names the part that is missing, damaged, or from another configuration.
pub fn decode(bytes: &[u8], config: &TrainConfig) -> Result<(ScheduleState, TrainState), TrainError> {
    let header = header(bytes)?;
    if header.config != *config {
        return Err(bad("config", "differs from the configuration of this training"));
    }
    let model = model_file::decode(bytes).map_err(|e| bad("model", e))?;
    let file = SafeTensors::deserialize(bytes).map_err(|e| bad("container", e))?;
    let read = |name: &str, count: usize| floats(&file, name, count).map_err(|e| bad(name, e));
    let n = model.gaussians.len();
    let moments = |prefix: &str| -> Result<Gaussians, TrainError> {
        let g = &model.gaussians;
        let name = |field: Field| format!("{prefix}.{}", field.name());
        let mut out = Gaussians::zeroed(n, g.prototypes(), g.visibility_degree(), g.radiance_degree());
        // Older checkpoints do not have every field.
        let is_there = |field: Field| {
            !matches!(field, Field::Sheen | Field::SamplingRate) || file.tensor(&name(field)).is_ok()
        };
        for (field, _, data) in out.fields_mut().filter(|(field, ..)| is_there(*field)) {
            *data = read(&name(field), data.len())?;
        }
        Ok(out)
    };
    let globals = 3 * (model.prototypes.len() + model.env_raw.len());
    let triples = |name: &str| read(name, globals).map(|values| values.as_chunks::<3>().0.to_vec());
    let gathered = read("gathered", header.gathered.saturating_mul(6))?;
    // Checkpoints without lights have no shares of them.
    let arriving = match header.arriving {
        0 => Vec::new(),
        rows => read("arriving", rows.saturating_mul(MAX_LIGHTS))?,
    };
    let state = TrainState {
        moments: Moments {
            first: moments("first")?,
            second: moments("second")?,
            globals: [triples("first.globals")?, triples("second.globals")?],
        },
        density: DensityStats { absgrad: read(ABSGRAD_KEY, n)?, seen: read("density.seen", n)? },
        labels: read("labels", header.labels)?,
        gathered: gathered.as_chunks::<6>().0.to_vec(),
        arriving: arriving.as_chunks::<MAX_LIGHTS>().0.to_vec(),
        model,
    };
    let cut = |(region, gaussians): (Region, usize)| -> Result<Arc<SubjectCrop>, TrainError> {
        // Sizes are checked against the file's length before memory is allocated for them.
        if gaussians.saturating_mul(3 * 4) > bytes.len() {
            return Err(bad("cut", "states more Gaussians than the file contains"));
        }
        let mut silhouette = Gaussians::zeroed(gaussians, 1, 0, 0);
        for field in SILHOUETTE {
            let data = silhouette.field_mut(field);
            data.copy_from_slice(&read(&cut_key(field), data.len())?);
        }
        Ok(Arc::new(SubjectCrop { region, gaussians: silhouette }))
    };
    let schedule = ScheduleState {
        step: header.step,
        order: header.order,
        cursor: header.cursor,
        rng: header.rng,
        rate_factor: header.rate_factor,
        seconds: header.seconds,
        complexity: header.complexity,
        light_colour: header.light_colour,
        gains: header.gains,
        lights: header.lights,
        surroundings: header.surroundings.map(Arc::new),
        up: header.up,
        cut: header.cut.map(cut).transpose()?,
        timeline: Timeline::with_changes(config.iterations, header.plan)
            .map_err(|error| bad("plan", error))?,
        budget: header.budget,
    };
    Ok((schedule, state))
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use crate::time_budget::StepCost;
    use relume_scene::{LightSplit, Model, SplitLight};
    use relume_spec::training::{Preset, TrainOverrides};

    fn state() -> TrainState {
        TrainState::new(Model::new(
            Gaussians::zeroed(3, 2, 1, 0),
            vec![[0.5; 3]; 2],
            vec![[0.5; 3]; 8],
            (4, 2),
        ))
    }

    #[test]
    fn checkpoints_round_trip_with_and_without_lights() {
        let config = TrainConfig::new(Preset::Draft, &Default::default()).unwrap();
        let schedule = ScheduleState {
            step: 7,
            order: vec![1, 0],
            cursor: 1,
            rng: ChaCha8Rng::seed_from_u64(3),
            rate_factor: 1.0,
            seconds: 0.0,
            complexity: ComplexityState::default(),
            light_colour: Some(LightColour { blue_over_red: 0.25, green: -0.5 }),
            gains: vec![vec![[1.1, 1.0, 0.9]; 2]],
            lights: vec![0.25],
            surroundings: None,
            up: Some(WorldUp::default()),
            cut: None,
            timeline: Timeline::new(config.iterations),
            budget: None,
        };
        let plain = state();
        let bytes = encode(&schedule, &plain, &config).unwrap();
        assert!(!String::from_utf8_lossy(&bytes).contains("light_shares"));
        assert_eq!(decode(&bytes, &config).unwrap(), (schedule.clone(), plain));
        assert_eq!(up(&bytes).unwrap(), (UpAxis::Auto, schedule.up.clone()));
        let mut lit = state();
        let light = SplitLight { direction: [0.0, 0.0, 1.0], radius: 0.02 };
        lit.model.lights = LightSplit { lights: vec![light], shares: vec![[0.5, 0.0, 0.0, 0.0]; 8] };
        lit.arriving = (0..3).map(|i| [0.25 * i as f32, 1.0, 1.0, 1.0]).collect();
        let bytes = encode(&schedule, &lit, &config).unwrap();
        assert_eq!(decode(&bytes, &config).unwrap(), (schedule, lit));
    }

    #[test]
    fn a_plan_and_its_budget_round_trip_in_a_checkpoint() {
        let budgeted = |seconds| {
            let overrides = TrainOverrides { time_budget_s: Some(seconds), ..Default::default() };
            TrainConfig::new(Preset::Draft, &overrides).unwrap()
        };
        let planned = TrainConfig { iterations: 900, resolution: 200, ..budgeted(60) };
        let mut schedule = ScheduleState::new(3, 900, ChaCha8Rng::seed_from_u64(3));
        let plain = encode(&schedule, &state(), &planned).unwrap();
        assert!(!String::from_utf8_lossy(&plain).contains("\"plan\""), "the control: no change");
        schedule.step = 30;
        let change = PlanChange { step: 20, position: 20, total: 500, why: "time".to_owned() };
        schedule.timeline.change(change).unwrap();
        schedule.budget = Some(BudgetState { used: 7.5, cost: StepCost::RELATIVE });
        let bytes = encode(&schedule, &state(), &planned).unwrap();
        assert_eq!(decode(&bytes, &planned).unwrap().0, schedule);
        assert_eq!(planned_config(&bytes, &budgeted(60)).unwrap(), planned);
        assert!(decode(&bytes, &budgeted(60)).is_err(), "the control: the draft has other settings");
        let other = planned_config(&bytes, &budgeted(61)).unwrap_err().to_string();
        assert!(other.contains("config.time_budget_s"), "{other}");
    }
}
