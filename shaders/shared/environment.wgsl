// The environment in training. Kept in step with `EnvironmentUniform` of crates/engine/src/gpu/light/training.rs.
struct Environment {
    n_texels: u32,
    // First float of the texels among the globals.
    first_texel: u32,
    // Weight of the light neutrality term, divided by three times the texels; weights of exposure and colour.
    neutrality: f32,
    exposure: f32,
    colour: f32,
    // Target colour: logarithms of blue over red, and of green squared over red times blue.
    blue_over_red: f32,
    green: f32,
    // Distance from it below which the colour term is 0.
    tolerance: f32,
    // Columns of the map, and their shift in the photograph: whole columns and the fraction of one.
    width: u32,
    whole: u32,
    fraction: f32,
}

// The texel `columns` further in the row of `texel_ix`, modulo the width.
fn texel_beside(texel_ix: u32, columns: u32, width: u32) -> u32 {
    let x = texel_ix % width;
    return texel_ix - x + (x + columns) % width;
}
