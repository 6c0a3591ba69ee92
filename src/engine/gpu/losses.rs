//! Terms of the objective on images and buffers (docs/MODEL.md section 5): structural similarity, absolute error,
//! coverage, depth-normal consistency and smoothness.

/// Slots of a losses buffer; kept in step with `shaders/shared/losses.wgsl`.
pub const LOSS_SLOTS: usize = 16;

/// A slot of the losses buffer. Image slots hold means without weight; the others carry their weight already and are
/// their share of the objective.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(usize)]
pub enum LossSlot {
    /// Mean absolute error of the physically based branch.
    PhysicalL1 = 0,
    /// Its mean squared error.
    PhysicalSquared = 1,
    /// Its mean SSIM.
    PhysicalSsim = 2,
    /// Mean absolute error of the radiance branch.
    RadianceL1 = 3,
    /// Its mean squared error.
    RadianceSquared = 4,
    /// Its mean SSIM.
    RadianceSsim = 5,
    /// Coverage against the mask.
    Coverage = 6,
    /// Depth-normal consistency.
    DepthNormal = 7,
    /// Smoothness of metalness, roughness and normal (Eq. 32).
    Smoothness = 8,
    /// Neutrality of the light (Eq. 31).
    Neutrality = 9,
    /// Exposure.
    Exposure = 10,
    /// Aggregation of prototypes (Eq. 24).
    Aggregation = 11,
    /// Albedo residual (Eq. 25).
    Residual = 12,
    /// Flatness.
    Flatness = 13,
    /// Visibility labels (Eq. 15).
    Visibility = 14,
}
