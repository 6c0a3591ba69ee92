//! Constants that the host side of the GPU engine shares with its kernels. The build script of `relume-engine` generates the
//! shaders' constants from them (`build/generated.rs`).

/// Floats of a splat gradient row before the channels: mean x, y, conic xx, xy, yy, opacity, absgrad, unused.
pub const GRADIENT_HEADER: usize = 8;
/// Elements per workgroup of the prefix sum.
pub const SCAN_BLOCK: usize = 1024;
/// Elements per workgroup of the radix sort.
pub const SORT_BLOCK: usize = 2048;

/// `relume_scene::NormalForm::Free`.
pub const NORMAL_FREE: u32 = 0;
/// `relume_scene::NormalForm::ShortestAxis`.
pub const NORMAL_SHORTEST_AXIS: u32 = 1;
/// `relume_scene::IndirectForm::Off`.
pub const INDIRECT_OFF: u32 = 0;
/// `relume_scene::IndirectForm::Learned`.
pub const INDIRECT_LEARNED: u32 = 1;
/// `relume_scene::IndirectForm::Gathered`.
pub const INDIRECT_GATHERED: u32 = 2;
/// `relume_scene::VisibilityForm::Off`.
pub const VISIBILITY_OFF: u32 = 0;
/// `relume_scene::VisibilityForm::Linear`.
pub const VISIBILITY_LINEAR: u32 = 1;
/// `relume_scene::VisibilityForm::Sigmoid`.
pub const VISIBILITY_SIGMOID: u32 = 2;
/// `relume_scene::DiffuseForm::AmbientOcclusion`.
pub const DIFFUSE_AMBIENT_OCCLUSION: u32 = 0;
/// `relume_scene::DiffuseForm::Directional`.
pub const DIFFUSE_DIRECTIONAL: u32 = 1;
/// `relume_scene::ShadeAt::Pixel`.
pub const SHADE_AT_PIXEL: u32 = 0;
/// `relume_scene::ShadeAt::Gaussian`.
pub const SHADE_AT_GAUSSIAN: u32 = 1;

/// Elements of the status buffer.
pub const STATUS_WORDS: usize = 4;
/// Floats of a losses buffer; the caller clears it before the first term of a step.
pub const LOSS_SLOTS: usize = 16;

/// A slot of the losses buffer. Image slots hold unweighted means. The other slots hold weighted terms of the objective.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(usize)]
pub enum LossSlot {
    /// Mean absolute error of the physically based branch.
    PhysicalL1,
    /// Its mean squared error.
    PhysicalSquared,
    /// Its mean SSIM.
    PhysicalSsim,
    /// Mean absolute error of the radiance branch.
    RadianceL1,
    /// Its mean squared error.
    RadianceSquared,
    /// Its mean SSIM.
    RadianceSsim,
    /// Coverage against the mask.
    Coverage,
    /// Depth-normal consistency.
    DepthNormal,
    /// Smoothness of metalness, roughness and normal (Eq. 32).
    Smoothness,
    /// Neutrality of the light (Eq. 31).
    Neutrality,
    /// Exposure and colour of the light.
    Exposure,
    /// Aggregation of prototypes (Eq. 24).
    Aggregation,
    /// Albedo residual (Eq. 25).
    Residual,
    /// Flatness.
    Flatness,
    /// Visibility labels (Eq. 15).
    Visibility,
}

impl LossSlot {
    /// Every slot, in order.
    pub const ALL: [Self; 15] = [
        Self::PhysicalL1,
        Self::PhysicalSquared,
        Self::PhysicalSsim,
        Self::RadianceL1,
        Self::RadianceSquared,
        Self::RadianceSsim,
        Self::Coverage,
        Self::DepthNormal,
        Self::Smoothness,
        Self::Neutrality,
        Self::Exposure,
        Self::Aggregation,
        Self::Residual,
        Self::Flatness,
        Self::Visibility,
    ];
}
