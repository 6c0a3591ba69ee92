// The environment that trains. Kept in step with `EnvironmentUniform` of src/engine/gpu/light.rs.
struct Environment {
    n_texels: u32,
    // First float of the texels among the globals.
    first_texel: u32,
    // Weight of the light neutrality term, divided by three times the texels; weights of exposure and daylight.
    neutrality: f32,
    exposure: f32,
    daylight: f32,
    // Logarithm of blue over red in daylight.
    blue_over_red: f32,
}
