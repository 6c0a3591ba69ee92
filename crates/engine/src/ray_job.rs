//! What a renderer asks of a device along rays: a tree of what hides what, and the light that is looked for.

use crate::ProbeSettings;
use relume_scene::light::{DominantLight, EnvSampler, LightTables};

/// A bounding volume hierarchy over the Gaussians of a model as the shaders read it (`shaders/shared/ray_tree.wgsl`).
#[derive(Debug, Clone)]
pub struct RayTree {
    /// Low corner, first member or right child, high corner, number of members or 0; corners are the bits of floats.
    pub nodes: Vec<[u32; 8]>,
    /// Mean, opacity, and three axes times standard deviations with one more number each: `ln(255 opacity)`, 0, 0.
    pub members: Vec<[f32; 16]>,
    /// Which members count for a ray.
    pub settings: ProbeSettings,
}

/// The light of a frame that is looked for along rays.
#[derive(Debug, Clone, Copy)]
pub enum RayLight<'a> {
    /// A few small lights with a shadow each, asked for in every pixel, beside the rest of their environment.
    Sharp {
        /// The lights.
        lights: &'a [DominantLight],
        /// Tables of the rest.
        rest: &'a LightTables,
    },
    /// All of an environment, by Monte-Carlo.
    Sampled {
        /// What draws directions.
        environment: &'a EnvSampler,
        /// Directions a pixel.
        samples: u32,
        /// Their seed.
        seed: u64,
        /// Pixels of the frame before the first one of the job: no two pixels have the same samples.
        pixels_before: u64,
    },
}
