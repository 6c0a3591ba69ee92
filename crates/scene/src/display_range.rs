//! The range of the display values of photographs.

/// The range of the display values of photographs, and of the images that are compared with them. The order is that of the ranges'
/// sizes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum DisplayRange {
    /// Display-referred photographs: values in [0, 1]. Every radiance of 1 or more has the value 1.
    #[default]
    Unit,
    /// Scene-referred photographs: the power of the sRGB curve continues above 1, up to the value of a radiance of
    /// [`SCENE_PEAK`].
    Extended,
}

/// Largest linear radiance of a scene-referred photograph, where 1 is the white of a display: six stops above it. The limit
/// bounds the weight of single very bright pixels.
pub const SCENE_PEAK: f32 = 64.0;

/// `1.055 SCENE_PEAK^(1/2.4) - 0.055`.
const SCENE_WHITE: f32 = 5.912_981;

impl DisplayRange {
    /// Largest linear radiance that has its own display value. Brighter ones have the value [`Self::white`].
    pub const fn peak(self) -> f32 {
        match self {
            Self::Unit => 1.0,
            Self::Extended => SCENE_PEAK,
        }
    }

    /// Largest display value: that of [`Self::peak`].
    pub const fn white(self) -> f32 {
        match self {
            Self::Unit => 1.0,
            Self::Extended => SCENE_WHITE,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::srgb;

    #[test]
    fn white_is_the_display_value_of_the_peak() {
        for range in [DisplayRange::Unit, DisplayRange::Extended] {
            let difference = (srgb::encode_extended(range.peak()) - range.white()).abs();
            assert!(difference < 1e-6, "{range:?}: {difference}");
        }
        assert!(srgb::encode_extended(0.5 * SCENE_PEAK) < SCENE_WHITE - 1.0, "the control");
    }
}
