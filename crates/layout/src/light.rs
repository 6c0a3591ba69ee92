//! Constants and small tables of light and reflectance. The build script of `relume-engine` generates the shaders' constants
//! from them (`build/generated.rs`).

use std::f64::consts::PI;

/// Coefficient `c_00` of a visibility field that is 1 everywhere: `2 sqrt(pi)`.
pub const UNOCCLUDED_SH0: f32 = 3.544_907_7;
/// Share of each linear channel in luminance (ITU-R BT.709).
pub const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];
/// Luminance that training assumes for a white surface facing up where the light is not known: `exp(-0.1)` of white
/// (docs/decisions/0031).
pub const UPWARD_LUMINANCE: f32 = 0.904_837_4;
/// Reflectance of a dielectric at normal incidence.
pub const DIELECTRIC_F0: f32 = 0.04;
/// Largest effective absolute value of sheen: a gain of 20 or of 1/20. Values beyond it are clamped and have no gradient.
pub const MAX_SHEEN: f32 = 3.0;
/// Roughness of each prefiltered level; radiance between two levels is interpolated linearly.
pub const SPECULAR_LEVELS: [f32; 6] = [0.1, 0.25, 0.4, 0.6, 0.8, 1.0];
/// Texels along a side of the split-sum table.
pub const LUT_SIZE: usize = 32;
/// SH degrees of the table of lobe attenuation: 0..=8.
pub const LOBE_DEGREES: usize = 9;
/// Roughnesses of the table of lobe attenuation, equally spaced from 0 to 1.
pub const LOBE_ROUGHNESSES: usize = 33;
/// Highest SH degree of a visibility or radiance field.
pub const MAX_FIELD_SH_DEGREE: usize = 6;

/// Funk-Hecke eigenvalues of the clamped cosine for l = 0..=6: pi, 2pi/3, pi/4, 0, -pi/24, 0, pi/64.
pub const CLAMPED_COSINE: [f64; MAX_FIELD_SH_DEGREE + 1] =
    [PI, 2.0 * PI / 3.0, PI / 4.0, 0.0, -PI / 24.0, 0.0, PI / 64.0];

/// `lambda_l / pi`, the factor of normal-related SH (article Eq. 17 with the 1/pi of Eq. 16).
/// Zero beyond l = 6, where the clamped cosine has almost no energy.
pub fn nrsh_factor(l: usize) -> f64 {
    CLAMPED_COSINE.get(l).map_or(0.0, |lambda| lambda / PI)
}

/// `K_lm` of the orthonormal real SH basis, with the sqrt(2) of m > 0, for m >= 0.
pub fn sh_normalisation(l: usize, m: usize) -> f64 {
    let ratio: f64 = ((l - m + 1)..=(l + m)).map(|k| k as f64).product();
    let k = ((2 * l + 1) as f64 / (4.0 * PI) / ratio).sqrt();
    if m == 0 { k } else { k * std::f64::consts::SQRT_2 }
}
