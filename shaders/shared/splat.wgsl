// A projected Gaussian, 64 bytes, indexed by gaussian_ix. Kept in step with `SplatRecord` of
// crates/engine/src/gpu/raster/records.rs.
#import generated/projection

struct Splat {
    // Projected mean, pixels.
    mean: vec2f,
    // Opacity, compensation included.
    opacity: f32,
    // ln(255 opacity): at a larger exponent alpha is below 1/255.
    reach: f32,
    // Inverse of the screen covariance: xx, xy, yy.
    conic: vec3f,
    // Camera depth.
    depth: f32,
    // Screen covariance, low-pass included: xx, xy, yy.
    covariance: vec3f,
    // Factor of the compensation on the opacity.
    compensation: f32,
    // Number of tiles in which it reaches a pixel.
    n_tiles: u32,
    // SPLAT_VISIBLE or 0; if 0, no other member may be read.
    flags: u32,
    pad_a: u32,
    pad_b: u32,
}

const SPLAT_VISIBLE = 1u;
