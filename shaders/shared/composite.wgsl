// Options of compositing. Kept in step with `CompositeUniform` of crates/engine/src/gpu/shading/mod.rs.
struct Composite {
    // Display-referred.
    background: vec4f,
    n_pixels: u32,
    // 1: images are compared through the sRGB curve.
    srgb: u32,
    // Number of groups of the G-buffer gradient of Gaussians that were shaded before blending.
    n_groups: u32,
    // Radiance at which display values end.
    peak: f32,
}
