//! Work between steps: measurements of visibility, exposures, lights, restarts of the materials, and decisions about the model.

use std::sync::Arc;

use crate::error::TrainError;
use crate::surroundings::SurroundingLight;
use crate::trainer::Trainer;
use crate::trainer::preparation::operators_of;
use crate::{complexity, exposure, initial, light_colour, light_groups, lights, materials, schedule};
use relume_engine::{PhotoSize, TrainState, evaluation};
use relume_scene::{MAX_LIGHTS, SplitLight};

/// The work that is due before a step.
#[derive(Debug, Clone, Copy, Default)]
struct DueEvents {
    /// Materials and light start.
    starts_materials: bool,
    /// Visibility is measured.
    measures: bool,
    /// Exposures are compared.
    matches_exposures: bool,
    /// Albedo restarts.
    restarts_albedo: bool,
    /// Gaussians that no photograph shows are hidden.
    hides_unseen: bool,
}

impl DueEvents {
    fn has_any(self) -> bool {
        let Self { starts_materials, measures, matches_exposures, restarts_albedo, hides_unseen } = self;
        starts_materials || measures || matches_exposures || restarts_albedo || hides_unseen
    }
}

impl Trainer {
    pub(super) fn measures(&self) -> bool {
        schedule::measures(&self.config)
    }

    /// Performs the work that is due before certain steps, e.g. starts materials or refreshes probes.
    pub(super) fn prepare_step(&mut self) -> Result<(), TrainError> {
        let due = self.due_events();
        if !(due.has_any() || self.is_decision_due()) {
            return Ok(());
        }
        self.wait_for_steps()?;
        if self.tracker.non_finite_step.is_some() {
            return Ok(());
        }
        if due.starts_materials {
            let _span = tracing::info_span!("start_materials").entered();
            self.schedule.surroundings = self.surroundings()?.map(Arc::new);
            self.cut_out()?;
            let mut state = self.engine.state()?.into_owned();
            self.start_light(&mut state);
            if self.is_dielectric() {
                complexity::hold_dielectric(&mut state);
            }
            self.engine.load(state)?;
        }
        if due.measures {
            // The first measurement also determines each Gaussian's open side, which the second one uses.
            self.measure(if due.starts_materials { 2 } else { 1 })?;
        }
        if due.matches_exposures {
            self.match_exposures()?;
        }
        if due.restarts_albedo {
            self.restart_albedo()?;
        }
        if due.hides_unseen {
            self.hide_unseen()?;
        }
        self.decide()
    }

    /// The events at the positions of the current step.
    fn due_events(&self) -> DueEvents {
        let (config, warm_up) = (&self.config, self.config.warm_up_steps());
        let is_measured = |p: u32| p >= warm_up && (p - warm_up).is_multiple_of(config.probe_every);
        let mut due = DueEvents::default();
        for position in self.schedule.timeline.covered(self.schedule.step) {
            due.starts_materials |= position == warm_up;
            due.measures |= self.measures() && is_measured(position);
            due.matches_exposures |= config.is_exposure_round(position);
            due.restarts_albedo |= config.is_albedo_round(position);
            due.hides_unseen |= position == schedule::hiding(config);
        }
        due
    }

    /// Initialises the light and the materials, with the known or estimated colour of the light.
    fn start_light(&mut self, state: &mut TrainState) {
        let known = self.config.white_balance.known();
        let known = known.map(|colour| match self.data.reference_group {
            Some(group) => self.data.relative_lights[group].mean_colour(colour),
            None => colour,
        });
        let colour = if self.config.light.is_some() {
            initial::colour_from_above(&state.model)
        } else {
            let colour =
                known.unwrap_or_else(|| light_colour::estimate(&state.model.gaussians, self.data.range));
            initial::light_of_colour(&mut state.model, colour, &self.data.relative_lights);
            colour
        };
        self.schedule.light_colour = Some(colour);
        if let Some(surroundings) = &self.schedule.surroundings {
            surroundings.hold(state);
        }
        materials::initialise(state, colour, self.data.range);
    }

    /// The light of the surroundings by the present state, which is finite.
    fn surroundings(&self) -> Result<Option<SurroundingLight>, TrainError> {
        let state = self.engine.state()?;
        let is_finite = state.model.check().is_ok();
        Ok(is_finite.then(|| SurroundingLight::of(&self.config, &state, &self.data)).flatten())
    }

    /// Measures the light of the surroundings again. A crop has removed them: then their light stays as it was.
    fn refresh_surroundings(&mut self) -> Result<(), TrainError> {
        if self.schedule.surroundings.is_some()
            && self.schedule.cut.is_none()
            && let Some(now) = self.surroundings()?
        {
            self.schedule.surroundings = Some(now.into());
        }
        Ok(())
    }

    /// Divides photographs by their gains if these differ.
    fn match_exposures(&mut self) -> Result<(), TrainError> {
        let _span = tracing::info_span!("match_exposures").entered();
        let state = self.engine.state()?;
        if !self.data.lights.is_static() || state.model.check().is_err() {
            return Ok(());
        }
        let gains = exposure::gains(&state, &self.context(), &self.data);
        if !self.schedule.gains.is_empty() || exposure::differ(&gains) {
            self.data.divide(&gains);
            self.schedule.gains.push(gains);
            // Older snapshots come from photographs with other exposures.
            if self.engine.snapshot()? {
                self.snapshot = self.schedule.clone();
            }
        }
        Ok(())
    }

    /// Splits strong small lights off the environment: sources of the surroundings, or lights that cast sharp shadows.
    fn find_lights(&mut self) -> Result<(), TrainError> {
        let _span = tracing::info_span!("find_lights").entered();
        let most = self.config.lights as usize;
        if most == 0 || self.config.light.is_some() || !self.data.lights.is_static() {
            return Ok(());
        }
        self.refresh_surroundings()?;
        let mut state = self.engine.state()?.into_owned();
        if state.model.check().is_err() || !state.model.shading.shades_lights() {
            // The state is not finite or lights are not shaded. After a non-finite state the next step rolls back and
            // the schedule reaches this point again.
            return Ok(());
        }
        let surroundings = self.schedule.surroundings.clone();
        if let Some(surroundings) = &surroundings {
            let sources = surroundings.lights(&state, MAX_LIGHTS);
            surroundings.hold(&mut state);
            if !sources.is_empty() {
                self.schedule.lights = Vec::new();
                self.engine.load(state)?;
                return self.split_off(&sources);
            }
        }
        let before = state.model.lights.lights.clone();
        let seen = lights::seen(&state, &self.data.cameras(PhotoSize::Half));
        let found = lights::search(&state, &seen, self.data.range, most, &before);
        self.schedule.lights = found.iter().map(|f| f.gain).collect();
        let now: Vec<SplitLight> = found.iter().map(|f| f.light).collect();
        // The texels of a light that is dropped stay unchanged.
        if now.len() > before.len() {
            let split = lights::split(&now, state.model.env_width, state.model.env_height);
            let shares = self.data.lights.group_shares();
            light_groups::change_mean_light(&mut state, &shares, |state| {
                lights::start(&mut state.model, &split, &found);
            });
            surroundings.iter().for_each(|surroundings| surroundings.hold(&mut state));
        }
        if now.len() > before.len() || surroundings.is_some() {
            self.engine.load(state)?;
        }
        if now == before { Ok(()) } else { self.split_off(&now) }
    }

    /// Restarts an unknown light by the shading and shadows of neighbouring surfaces. The light of surroundings that the photographs show is
    /// known better.
    fn restart_environment(&mut self) -> Result<(), TrainError> {
        let is_unknown = self.config.light.is_none() && self.schedule.surroundings.is_none();
        if !(self.config.environment_restarts && is_unknown && self.data.lights.is_static()) {
            return Ok(());
        }
        let _span = tracing::info_span!("restart_environment").entered();
        let mut state = self.engine.state()?.into_owned();
        if state.model.check().is_err() {
            // The next step rolls back, and the schedule reaches this point again.
            return Ok(());
        }
        let seen = lights::seen(&state, &self.data.cameras(PhotoSize::Half));
        let split = state.model.lights.clone();
        let how = schedule::measurement(&self.config, &self.data.lights, 1);
        let gathered = match state.model.shading.has_sky_shadows() {
            true => {
                let lights = &self.data.lights;
                evaluation::gathered_from_surfaces(
                    &state,
                    &self.operators,
                    lights,
                    how.directions,
                    how.bounces,
                )
            }
            false => evaluation::mean_gathered(&state, &self.data.lights),
        };
        let range = self.data.range;
        light_groups::change_mean_light(&mut state, &self.data.lights.group_shares(), |state| {
            lights::solve_environment(state, &gathered, &seen, range, &split);
        });
        Ok(self.engine.load(state)?)
    }

    /// Continues with `lights` split off the environment.
    fn split_off(&mut self, lights: &[SplitLight]) -> Result<(), TrainError> {
        let (width, height) = self.operators.size();
        self.operators = Arc::new(self.operators.with_lights(&lights::split(lights, width, height)));
        Ok(self.engine.light(&self.operators)?)
    }

    /// Restarts the materials from colours with the light divided out.
    fn restart_albedo(&mut self) -> Result<(), TrainError> {
        let _span = tracing::info_span!("restart_albedo").entered();
        if self.measures() {
            self.find_lights()?;
            self.restart_environment()?;
            self.measure(1)?;
        }
        let state = self.engine.state()?;
        if state.model.check().is_err() {
            // The next step rolls back, and the schedule reaches this point again.
            return Ok(());
        }
        let mut state = state.into_owned();
        let normals = evaluation::normals(&state);
        let (lights, range) = (&self.data.lights, self.data.range);
        materials::restart_albedo(&mut state, &self.operators, lights, &normals, range);
        if self.is_dielectric() {
            complexity::hold_dielectric(&mut state);
        }
        Ok(self.engine.load(state)?)
    }

    /// Measures visibility and gathered light, `repeats` times in succession.
    pub(super) fn measure(&mut self, repeats: usize) -> Result<(), TrainError> {
        let _span = tracing::info_span!("measure", repeats).entered();
        Ok(self.engine.measure(&schedule::measurement(&self.config, &self.data.lights, repeats))?)
    }

    fn is_decision_due(&self) -> bool {
        self.schedule.complexity.due(&self.config, self.schedule.position()).is_some()
    }

    /// Removes the parts of the model that the scene does not need, if a decision is due.
    pub(super) fn decide(&mut self) -> Result<(), TrainError> {
        let steps = self.schedule.step;
        let position = self.schedule.position();
        let Some(point) = self.schedule.complexity.due(&self.config, position) else { return Ok(()) };
        let state = self.engine.state()?;
        if state.model.check().is_err() {
            // The next step rolls back, and the schedule reaches this point again.
            return Ok(());
        }
        let _span = tracing::info_span!("decide").entered();
        let mut state = state.into_owned();
        let mut decisions = self.schedule.complexity.clone();
        decisions.decide(point, &self.context(), steps, &self.data, &mut state);
        self.schedule.complexity = decisions;
        if state.model.gaussians.visibility_degree() != self.operators.sh_degree() {
            self.operators = operators_of(&state.model);
        }
        self.engine.reshape(state, &self.operators)?;
        self.snapshot = self.schedule.clone();
        Ok(())
    }
}
