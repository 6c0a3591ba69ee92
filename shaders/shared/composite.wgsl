// What compositing needs. Kept in step with `CompositeUniform` of src/engine/gpu/shading.rs.
struct Composite {
    // Display-referred.
    background: vec4f,
    n_pixels: u32,
    pad_a: u32,
    pad_b: u32,
    pad_c: u32,
}
