//! Reads a capture at the size that a time budget allows.

use std::path::Path;

use crate::memory::{self, MemoryBudget, PhotographSizes};
use crate::time_budget::cost::StepCost;
use crate::time_budget::plan::{reduced, settings_for, with_steps_for};
use crate::{TrainError, import_in_world};
use relume_capture::{Capture, ImportLimits, ImportOptions, UndecodedCapture, Up};
use relume_spec::training::{ConfigError, TrainConfig, TrainOverrides};

/// Time to decode a pixel of a photograph on one core, seconds.
const DECODE_PIXEL: f64 = 4e-8;
/// Bytes of memory per pixel that is assumed before photographs are decoded.
const BYTES_A_PIXEL: f64 = 4.0;

/// Inputs of the plan that a training makes before it reads the capture.
#[derive(Clone, Copy)]
pub struct Planning<'a> {
    /// Settings of the caller, with a time budget.
    pub overrides: &'a TrainOverrides,
    /// Measured cost of a step, seconds.
    pub cost: StepCost,
    /// Time after the last step, as a number of last steps.
    pub finish_steps: f64,
    /// Seconds of the budget that have passed.
    pub now: &'a (dyn Fn() -> f64 + Sync),
}

/// Chooses settings for the budget and reads the capture with them, in the world in which `up` is up. The number of
/// steps is chosen after the photographs are decoded, for the time that is left.
///
/// # Errors
/// As [`crate::import_for_training`]; [`TrainError::Invalid`] also names a setting that is not valid.
pub fn import_planned(
    path: &Path,
    up: Up,
    limits: &ImportLimits,
    memory: MemoryBudget,
    planning: &Planning<'_>,
) -> Result<(Capture, TrainConfig), TrainError> {
    let Planning { overrides, cost, finish_steps, now } = *planning;
    let budget = overrides.time_budget_s.map_or(f64::INFINITY, f64::from);
    let options = ImportOptions { limits: *limits, load_truth: false, up, ..ImportOptions::default() };
    let undecoded = UndecodedCapture::open(path, &options)?;
    let (sizes, held_out) = (undecoded.sizes().to_vec(), undecoded.held_out());
    drop(undecoded);
    let stored = PhotographSizes { sizes: sizes.clone(), bytes_a_pixel: BYTES_A_PIXEL, held_out };
    let fits =
        |config: &TrainConfig| memory::check(&stored.reduced(config.resolution), config, memory).is_ok();
    let left = budget - now() - decode_seconds(&sizes);
    let chosen = settings_for(overrides, &sizes, cost, left, finish_steps, fits).map_err(invalid)?;
    let capture = import_in_world(path, &chosen, up, limits, memory)?;
    let trained: Vec<(u32, u32)> =
        capture.train.iter().map(|view| (view.image.width, view.image.height)).collect();
    let photographs = reduced(&trained, chosen.resolution);
    Ok((capture, with_steps_for(&chosen, photographs, cost, budget - now(), finish_steps)))
}

fn invalid(error: ConfigError) -> TrainError {
    TrainError::Invalid(error.to_string())
}

/// Expected time to decode photographs of these sizes, seconds.
fn decode_seconds(sizes: &[(u32, u32)]) -> f64 {
    let pixels: f64 = sizes.iter().map(|(width, height)| f64::from(*width) * f64::from(*height)).sum();
    DECODE_PIXEL * pixels / rayon::current_num_threads().clamp(1, sizes.len().max(1)) as f64
}
