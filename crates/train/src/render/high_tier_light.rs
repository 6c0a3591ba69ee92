//! The light of the high tier: strong small lights, and tables of the rest of the environment.

use relume_engine::RayLight;
use relume_scene::EnvMap;
use relume_scene::light::{DominantLight, LightTables, SplitEnvironment, rendering_tables};

/// Greatest number of lights with shadows of their own.
const MAX_HIGH_TIER_LIGHTS: usize = 8;

/// An environment split for visibility fields of one degree.
pub(super) struct HighTierLight {
    lights: Vec<DominantLight>,
    /// Tables of the rest; `None` if no light was split off.
    rest: Option<LightTables>,
}

impl HighTierLight {
    /// Splits `environment`.
    pub(super) fn new(environment: &EnvMap, sh_degree: usize) -> Self {
        let split = SplitEnvironment::new(environment, MAX_HIGH_TIER_LIGHTS);
        let rest = (!split.lights.is_empty()).then(|| rendering_tables(&split.rest, sh_degree));
        Self { lights: split.lights, rest }
    }

    /// The lights with the rest; `None` without lights.
    pub(super) fn rays(&self) -> Option<RayLight<'_>> {
        Some(RayLight::Sharp { lights: &self.lights, rest: self.rest.as_ref()? })
    }
}
