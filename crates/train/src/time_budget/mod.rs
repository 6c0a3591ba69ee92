//! Trainings with a time budget or a stop condition: the machine is measured, pixels, Gaussians and steps are planned
//! for the time, and the steps are planned again on the way.
//!
//! Nothing here reads a clock: a caller passes the time. Every change of a plan is recorded, so that a training can be
//! repeated without a clock.

mod cost;
mod eta;
mod import;
mod measure;
mod pacer;
mod pacing;
mod plan;
mod rates;
mod record;
mod timeline;
mod watch;

pub use cost::{PhotographCost, ProbeCost, ScheduleCost, StepCost};
pub use eta::Eta;
pub use import::{Planning, import_planned};
pub use measure::{measurement_limit, scaled_cost, step_cost};
pub use pacing::{BudgetState, Pacing, PacingStart};
pub use plan::{announcement, reduced, seconds};
pub use record::RecordedPlan;
pub(crate) use record::card as plan_card;
pub use timeline::{PlanChange, Timeline};

#[cfg(test)]
mod simulated;
