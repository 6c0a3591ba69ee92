//! Quality tiers of rendering.

use serde::{Deserialize, Serialize};

/// Quality tier: named compromise between rendering time and accuracy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Default)]
#[serde(rename_all = "snake_case")]
pub enum Tier {
    /// Shades each Gaussian once and blends three channels. For models that are shaded at the Gaussians, the
    /// image equals that of `standard`.
    Preview,
    /// Shades from precomputed tables of the light, at the place for which the model was trained: at the
    /// Gaussians, with one shadow value per Gaussian for each of up to four strong small lights, or in the
    /// pixel.
    #[default]
    Standard,
    /// As `standard`, with a traced shadow of up to eight strong small lights of the environment in every
    /// pixel.
    High,
    /// Monte-Carlo integration over the environment with one visibility query through the Gaussians per
    /// sample: the reference for the integrals of the other tiers.
    #[serde(alias = "reference")]
    MonteCarlo,
}

impl Tier {
    /// All tiers, cheapest first.
    pub const ALL: [Self; 4] = [Self::Preview, Self::Standard, Self::High, Self::MonteCarlo];

    /// Name in requests.
    pub fn name(self) -> &'static str {
        match self {
            Self::Preview => "preview",
            Self::Standard => "standard",
            Self::High => "high",
            Self::MonteCarlo => "monte_carlo",
        }
    }
}

/// A tier with its sampling settings. Conversion from a [`Tier`] uses the defaults.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quality {
    /// The tier.
    pub tier: Tier,
    /// Sampled directions per pixel in [`Tier::MonteCarlo`], 1 to [`Quality::MAX_SAMPLES`]. Other tiers
    /// ignore it.
    pub samples: u32,
    /// Seed of the sampled directions. Equal seeds give equal bytes for any number of threads.
    pub seed: u64,
}

impl Quality {
    /// Default number of samples per pixel.
    pub const SAMPLES: u32 = 64;
    /// Maximum number of samples per pixel.
    pub const MAX_SAMPLES: u32 = 1 << 16;

    /// The Monte-Carlo tier with `samples` per pixel and seed 0.
    pub fn monte_carlo(samples: u32) -> Self {
        Self { samples, ..Tier::MonteCarlo.into() }
    }

    /// Maximum cost of a band of a frame, in pixels times [`Self::pixel_cost`]. 1920 x 1080 pixels of
    /// [`Tier::Standard`] fit in one band. Each band repeats projection and sorting.
    pub const BAND_COST: u64 = 1 << 22;
    /// Maximum cost of a band of [`Tier::MonteCarlo`] on a GPU, where a frame has many bands.
    pub const SAMPLED_BAND_COST: u64 = 1 << 24;
    /// Maximum cost of a band on the CPU engine. Other frames wait for one band; the CPU takes as long for it
    /// as a GPU for a whole frame. A frame of this cost is one band on every device.
    pub const CPU_BAND_COST: u64 = 1 << 18;

    /// Approximate cost of a pixel relative to [`Tier::Preview`].
    pub fn pixel_cost(self) -> u64 {
        match self.tier {
            Tier::Preview => 1,
            Tier::Standard => 2,
            Tier::High => 3,
            Tier::MonteCarlo => u64::from(self.samples).saturating_mul(2).max(3),
        }
    }

    /// # Errors
    /// The reason if `samples` is out of range.
    pub fn check(self) -> Result<(), String> {
        if (1..=Self::MAX_SAMPLES).contains(&self.samples) {
            return Ok(());
        }
        Err(format!("must be 1 to {}, got {}", Self::MAX_SAMPLES, self.samples))
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
