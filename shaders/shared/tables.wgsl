// Where the tables of one light lie in their buffer (src/light/tables.rs): diffuse transfer `[node][rgb][coefficient]`,
// then prefiltered radiance `[node][rgb]`, level after level, then the irradiance rgb of MAX_LIGHTS lights. Kept in step with `TablesUniform` of src/engine/gpu/light.rs.
#import generated/light

struct Tables {
    // Nodes along an edge of the grid of normals.
    diffuse_n: u32,
    // Coefficients a colour has in the table, padded with zeros to a multiple of 16.
    coefficients: u32,
    // Those that are in use.
    n_coefficients: u32,
    // Nodes of all levels together.
    n_specular: u32,
    // Nodes along an edge, per level.
    specular_n: array<vec4u, 2>,
    // First float, per level.
    specular_first: array<vec4u, 2>,
    // Lights beside the tables.
    n_lights: u32,
    // First float of their irradiance.
    first_light: u32,
    pad_a: u32,
    pad_b: u32,
    // Unit direction towards each, and its angular radius.
    lights: array<vec4f, MAX_LIGHTS>,
}
