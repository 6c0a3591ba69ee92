// What compositing needs. Kept in step with `CompositeUniform` of src/engine/gpu/shading.rs.
struct Composite {
    // Display-referred.
    background: vec4f,
    n_pixels: u32,
    // 1: images are compared through the sRGB curve.
    srgb: u32,
    // Groups of the G-buffer gradient of Gaussians that were shaded before they were blended.
    n_groups: u32,
    pad: u32,
}
