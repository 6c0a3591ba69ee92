//! The named trades of time against accuracy.

use serde::{Deserialize, Serialize};

use crate::render::error::RenderError;

/// A named trade of time against accuracy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Default)]
#[serde(rename_all = "snake_case")]
pub enum Tier {
    /// Shade each Gaussian once, blend three channels: what `standard` shows of models that are shaded there.
    Preview,
    /// From tables of the light, where the model was trained to be shaded: at its Gaussians, where up to four strong small
    /// lights cast a shadow each, one number a Gaussian, or in the pixel.
    #[default]
    Standard,
    /// As `standard`, with a true shadow for up to eight strong small lights of the environment, asked for in every pixel.
    High,
    /// Monte-Carlo over the environment, with a query through the Gaussians a sample: ground truth of the others' integrals.
    #[serde(alias = "reference")]
    MonteCarlo,
}

impl Tier {
    /// Every tier, cheapest first.
    pub const ALL: [Self; 4] = [Self::Preview, Self::Standard, Self::High, Self::MonteCarlo];

    /// The name it has in requests.
    pub fn name(self) -> &'static str {
        match self {
            Self::Preview => "preview",
            Self::Standard => "standard",
            Self::High => "high",
            Self::MonteCarlo => "monte_carlo",
        }
    }
}

/// A tier, and what it needs to know beside its name. A [`Tier`] alone becomes one with the defaults.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quality {
    /// The tier.
    pub tier: Tier,
    /// Directions a pixel that [`Tier::MonteCarlo`] draws, 1 to [`Quality::MOST_SAMPLES`]; the others draw none.
    pub samples: u32,
    /// Seed of those directions: equal seeds, equal bytes, whatever the number of threads.
    pub seed: u64,
}

impl Quality {
    /// Samples a pixel when nobody says.
    pub const SAMPLES: u32 = 64;
    /// Most samples a pixel.
    pub const MOST_SAMPLES: u32 = 1 << 16;

    /// The Monte-Carlo tier with so many samples a pixel and seed 0.
    pub fn monte_carlo(samples: u32) -> Self {
        Self { samples, ..Tier::MonteCarlo.into() }
    }

    /// Most that a band of a frame costs, in pixels times [`Self::pixel_cost`]: 1920 x 1080 pixels of [`Tier::Standard`] are one. Each
    /// band is projected and sorted anew.
    pub const BAND_COST: u64 = 1 << 22;
    /// The same of [`Tier::MonteCarlo`] on a device, whose bands are many.
    pub const SAMPLED_BAND_COST: u64 = 1 << 24;
    /// The same of a frame that the CPU engine renders: other frames wait for one band, which takes it as long as a GPU's whole frame.
    /// A frame of this cost is one band everywhere.
    pub const CPU_BAND_COST: u64 = 1 << 18;

    /// What a pixel costs beside one of [`Tier::Preview`], roughly.
    pub fn pixel_cost(self) -> u64 {
        match self.tier {
            Tier::Preview => 1,
            Tier::Standard => 2,
            Tier::High => 3,
            Tier::MonteCarlo => u64::from(self.samples).saturating_mul(2).max(3),
        }
    }

    /// # Errors
    /// Names `samples` when there are none or too many.
    pub(super) fn check(self) -> Result<(), RenderError> {
        if (1..=Self::MOST_SAMPLES).contains(&self.samples) {
            return Ok(());
        }
        let reason = format!("must be 1 to {}, got {}", Self::MOST_SAMPLES, self.samples);
        Err(RenderError::Refused { field: "samples", reason })
    }
}

impl From<Tier> for Quality {
    fn from(tier: Tier) -> Self {
        Self { tier, samples: Self::SAMPLES, seed: 0 }
    }
}

impl Default for Quality {
    fn default() -> Self {
        Tier::default().into()
    }
}
