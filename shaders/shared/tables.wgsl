// Layout of the tables of one light in their buffer (crates/scene/src/light/tables.rs): diffuse transfer
// `[node][rgb][coefficient]`, then prefiltered radiance `[node][rgb]` level by level, then the irradiance rgb of MAX_LIGHTS
// lights. Kept in step with `TablesUniform` of crates/engine/src/gpu/light/tables.rs.
#import generated/light

struct Tables {
    // Nodes along an edge of the grid of normals.
    diffuse_n: u32,
    // Coefficients per colour in the table, padded with zeros to a multiple of 16.
    coefficients: u32,
    // Number of coefficients in use.
    n_coefficients: u32,
    // Number of nodes of all levels.
    n_specular: u32,
    // Nodes along an edge, per level.
    specular_n: array<vec4u, 2>,
    // First float, per level.
    specular_first: array<vec4u, 2>,
    // Number of dominant lights.
    n_lights: u32,
    // First float of the lights' irradiance.
    first_light: u32,
    pad_a: u32,
    pad_b: u32,
    // Unit direction towards each light, and its angular radius.
    lights: array<vec4f, MAX_LIGHTS>,
}
