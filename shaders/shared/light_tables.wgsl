// Where the parts of the light tables lie in one array of floats: diffuse transfer `[node][rgb][coefficient]`, then six
// specular levels `[node][rgb]`. Kept in step with `TablesUniform` of src/engine/gpu/light.rs.
struct Tables {
    // Nodes along a cube edge of the grid of normals.
    diffuse_n: u32,
    // Coefficients a row has, padding included.
    coefficients: u32,
    // Coefficients that can differ from zero.
    n_coefficients: u32,
    pad: u32,
    // Per level: nodes along a cube edge, and the first float.
    specular_n: array<vec4u, 2>,
    specular_first: array<vec4u, 2>,
}

const N_LEVELS = 6u;

fn specular_nodes(tables: Tables, level: u32) -> u32 {
    return select(tables.specular_n[0][level & 3u], tables.specular_n[1][level & 3u], level > 3u);
}

fn specular_start(tables: Tables, level: u32) -> u32 {
    return select(tables.specular_first[0][level & 3u], tables.specular_first[1][level & 3u], level > 3u);
}
