//! A training on the CPU engine.

use std::borrow::Cow;

use crate::light::EnvOperators;
use crate::train::backend::{Backend, StepTask, StepValue};
use crate::train::state::Learned;
use crate::train::step::{self, StepContext};
use crate::train::{TrainError, density};

/// The state, and the one to return to.
pub(super) struct OnCpu {
    learned: Learned,
    kept: Learned,
}

impl OnCpu {
    pub(super) fn new(learned: Learned) -> Self {
        Self { kept: learned.clone(), learned }
    }
}

impl Backend for OnCpu {
    fn step(&mut self, task: &StepTask<'_>) -> Result<StepValue, TrainError> {
        let step = if task.material { step::material } else { step::radiance };
        let outcome = step(&task.context, &self.learned, task.photo);
        let finite = outcome.loss.is_finite() && outcome.gradients.is_finite();
        if finite {
            let Learned { model, moments, density, .. } = &mut self.learned;
            density.record(&outcome.gradients);
            moments.step(model, &outcome.gradients, &task.sizes, task.ages);
        }
        Ok(StepValue { loss: outcome.loss, mse: outcome.mse, finite })
    }

    fn refresh_probes(&mut self, context: &StepContext<'_>, twice: bool) -> Result<(), TrainError> {
        step::refresh_probes(context.config, context.operators, &mut self.learned, twice);
        Ok(())
    }

    fn refine(&mut self, budget: usize, eyes: Option<&[[f32; 3]]>) -> Result<(), TrainError> {
        let Learned { model, moments, density, .. } = &mut self.learned;
        density::refine(model, moments, density, budget, eyes);
        Ok(())
    }

    fn load(&mut self, learned: Learned) -> Result<(), TrainError> {
        self.learned = learned;
        Ok(())
    }

    fn reshape(&mut self, learned: Learned, _operators: &EnvOperators) -> Result<(), TrainError> {
        self.kept = learned.clone();
        self.learned = learned;
        Ok(())
    }

    fn keep(&mut self) -> Result<bool, TrainError> {
        let finite = self.learned.model.gaussians.is_finite();
        if finite {
            self.kept = self.learned.clone();
        }
        Ok(finite)
    }

    fn restore(&mut self) -> Result<(), TrainError> {
        self.learned = self.kept.clone();
        Ok(())
    }

    fn gaussians(&self) -> usize {
        self.learned.model.gaussians.len()
    }

    fn learned(&self) -> Result<Cow<'_, Learned>, TrainError> {
        Ok(Cow::Borrowed(&self.learned))
    }

    fn engine(&self) -> &'static str {
        "cpu"
    }
}
