//! Data of frames with light along rays: the tree of occluders and the light.

use crate::ProbeSettings;
use relume_scene::light::{DominantLight, EnvSampler, LightTables};

/// A bounding volume hierarchy over the Gaussians of a model, in the layout of `shaders/shared/ray_tree.wgsl`.
#[derive(Debug, Clone)]
pub struct RayTree {
    /// Low corner, first member or right child, high corner, number of members or 0; corners are the bits of floats.
    pub nodes: Vec<[u32; 8]>,
    /// Mean, opacity, and three axes times standard deviations, each followed by one number: `ln(255 opacity)`, 0, 0.
    pub members: Vec<[f32; 16]>,
    /// Rule for the members that count for a ray.
    pub settings: ProbeSettings,
}

/// Light of a frame that is traced along rays.
#[derive(Debug, Clone, Copy)]
pub enum RayLight<'a> {
    /// A few small lights, each with a shadow that is traced in every pixel, and the rest of their environment.
    Sharp {
        /// The lights.
        lights: &'a [DominantLight],
        /// Tables of the rest.
        rest: &'a LightTables,
    },
    /// A whole environment, by Monte-Carlo.
    Sampled {
        /// Sampler of directions.
        environment: &'a EnvSampler,
        /// Directions per pixel.
        samples: u32,
        /// Seed of the samples.
        seed: u64,
        /// Number of pixels of the frame before the job's first pixel, so that all pixels have different samples.
        pixels_before: u64,
    },
}
