//! The tables of the reflectance model in one array, as shaders read them.

use crate::light::{BrdfLut, LobeAttenuation};

/// 32 x 32 pairs `[roughness][n.v][scale, bias]`, then 33 x 9 attenuations `[roughness][degree]`.
pub fn reflectance_tables() -> Vec<f32> {
    let lut = BrdfLut::shared().values().iter().flatten();
    let lobe = LobeAttenuation::shared().rows().iter().flatten();
    lut.chain(lobe).copied().collect()
}
