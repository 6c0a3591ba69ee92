//! The parameters of a Gaussian. The build script of `relume-engine` generates the shaders' parameter layout from them
//! (`build/generated.rs`).

/// One per-Gaussian parameter array. The discriminant indexes every per-field table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(usize)]
pub enum Field {
    /// Centre, capture units (3).
    Mean,
    /// Natural logarithm of the three standard deviations (3).
    LogScale,
    /// Orientation quaternion w x y z, not normalised (4).
    Quaternion,
    /// Opacity before the sigmoid (1).
    OpacityLogit,
    /// Free normal, or the offset added to the shortest axis (3).
    Normal,
    /// Metalness before the sigmoid (1).
    MetalLogit,
    /// Roughness before the sigmoid (1).
    RoughLogit,
    /// Sheen: natural logarithm of the diffuse term's gain at grazing view; 0 is no sheen (1).
    Sheen,
    /// Prototype scores before the softmax (K).
    ProtoLogits,
    /// Albedo residual, linear (3).
    Residual,
    /// Visibility SH coefficients ((L+1)^2).
    Visibility,
    /// Indirect-light SH weights, article Eq. 19 (16).
    Indirect,
    /// Radiance-branch SH coefficients, coefficient-major RGB (3 (d+1)^2).
    Radiance,
    /// Pixels per unit of length in the photograph that shows the Gaussian largest; 0: unknown (1). A negative rate marks a Gaussian that
    /// no photograph shows: frames omit it, but it still blocks and scatters light. A measurement, not a parameter: it has no gradient and
    /// does not train.
    SamplingRate,
}

/// Number of floats of a Gaussian in a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldWidth {
    /// The same for every model.
    Fixed(usize),
    /// One float per prototype.
    Prototypes,
    /// One float per SH coefficient of the visibility.
    Visibility,
    /// Three floats per SH coefficient of the radiance.
    Radiance,
}

impl Field {
    /// Number of floats of a Gaussian in this field.
    pub const fn width(self) -> FieldWidth {
        match self {
            Self::Mean | Self::LogScale | Self::Normal | Self::Residual => FieldWidth::Fixed(3),
            Self::Quaternion => FieldWidth::Fixed(4),
            Self::OpacityLogit | Self::MetalLogit | Self::RoughLogit | Self::Sheen | Self::SamplingRate => {
                FieldWidth::Fixed(1)
            }
            Self::Indirect => FieldWidth::Fixed(16),
            Self::ProtoLogits => FieldWidth::Prototypes,
            Self::Visibility => FieldWidth::Visibility,
            Self::Radiance => FieldWidth::Radiance,
        }
    }

    /// Number of fields.
    pub const COUNT: usize = 14;

    /// Every field, in storage order.
    pub const ALL: [Self; Self::COUNT] = [
        Self::Mean,
        Self::LogScale,
        Self::Quaternion,
        Self::OpacityLogit,
        Self::Normal,
        Self::MetalLogit,
        Self::RoughLogit,
        Self::Sheen,
        Self::ProtoLogits,
        Self::Residual,
        Self::Visibility,
        Self::Indirect,
        Self::Radiance,
        Self::SamplingRate,
    ];

    /// The stable name used in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mean => "means",
            Self::LogScale => "log_scales",
            Self::Quaternion => "quats",
            Self::OpacityLogit => "opacity_logit",
            Self::Normal => "normals_raw",
            Self::MetalLogit => "metal_logit",
            Self::RoughLogit => "rough_logit",
            Self::Sheen => "sheen",
            Self::ProtoLogits => "proto_logits",
            Self::Residual => "residual",
            Self::Visibility => "occ_sh",
            Self::Indirect => "ind_sh",
            Self::Radiance => "radiance_sh",
            Self::SamplingRate => "sampling_rate",
        }
    }
    /// The name of the field in the shaders' parameter layout.
    pub fn kernel_name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::LogScale => "log_scale",
            Self::Quaternion => "quaternion",
            Self::OpacityLogit => "opacity",
            Self::Normal => "normal",
            Self::MetalLogit => "metal",
            Self::RoughLogit => "rough",
            Self::Sheen => "sheen",
            Self::ProtoLogits => "scores",
            Self::Residual => "residual",
            Self::Visibility => "visibility",
            Self::Indirect => "indirect",
            Self::Radiance => "radiance",
            Self::SamplingRate => "sampling_rate",
        }
    }
}
