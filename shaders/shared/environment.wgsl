// The environment that trains. Kept in step with `EnvironmentUniform` of src/engine/gpu/light.rs.
struct Environment {
    n_texels: u32,
    // First float of the texels among the globals.
    first_texel: u32,
    // Weight of the light neutrality term, divided by three times the texels; weight of the exposure term.
    neutrality: f32,
    exposure: f32,
}
