//! Training, rendering and evaluation through the public interface, on the CPU and on the GPU.

// Test helpers may panic: the panic names the place.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod exposures;
mod gpu;
mod gpu_rays;
mod ground;
mod lamps;
mod light_groups;
mod light_matrix;
mod lights;
mod scene_referred;
mod support;
mod tiers;
mod time_budget;
mod training;
mod turntable;
