//! Light: spherical harmonics, the split-sum BRDF table, and the linear operators that turn an environment into look-up
//! tables for shading.

mod brdf;
mod cells;
mod colour;
mod dominant;
mod grid;
mod lobe;
mod lobe_tables;
mod lobes;
pub mod map_rows;
mod matrix_weights;
mod operators;
mod prefilter;
mod reflectance;
mod reflection_lobe;
mod reflector;
mod sampler;
mod sh;
mod sheen;
mod split_tables;
mod tables;

/// Colour of the light under an open sky, linear Rec.709 of mean 1.
pub const DAYLIGHT: [f32; 3] = [0.80, 0.94, 1.26];

pub use brdf::{BrdfLut, DiffuseShare, LutSample, ggx_d, ggx_smith_correlated};
pub use cells::{LightCell, disc_points, light_cells};
pub use colour::{LightColour, luminance};
pub use dominant::{DominantLight, SplitEnvironment};
pub use grid::{CubeGrid, Taps};
pub use lobe::{LobeAttenuation, LobeSample};
pub use lobe_tables::LobeTables;
pub use lobes::{LightLobes, MAX_LOBES, fibonacci_directions};
pub use matrix_weights::{MatrixWeights, SUN_TOLERANCE_DEG};
pub use operators::{CompressedRows, EnvOperators, LevelPosition, TableResolution};
pub use prefilter::rendering_tables;
pub use reflectance::reflectance_tables;
pub use reflector::{Material, Reflected, Reflector};
pub use relume_layout::light::{
    CLAMPED_COSINE, DIELECTRIC_F0, LOBE_DEGREES, LUMINANCE, MAX_SHEEN, SPECULAR_LEVELS, UNOCCLUDED_SH0,
    UPWARD_LUMINANCE, nrsh_factor,
};
pub use sampler::{EnvSampler, SampleCounts, SamplerTables, estimate};
pub use sh::{nrsh, sh_eval, sh_eval_with_gradient};
pub use sheen::Sheen;
pub use split_tables::{dominant_lights, split_tables, tables_of_split};
pub use tables::{LightTables, TABLE_LANES, TableLight, padded};
