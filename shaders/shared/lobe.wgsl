// Attenuation of each SH degree by the reflection lobe: the port of crates/scene/src/light/lobe.rs. Reads `constants` after the
// split-sum table.
#import generated/light

struct LobeCell {
    row: u32,
    fraction: f32,
    derivative: f32,
}

fn lobe_cell(roughness: f32) -> LobeCell {
    let cells = f32(LOBE_ROUGHNESSES - 1u);
    let x = select(0.0, min(roughness * cells, cells), roughness > 0.0);
    let row = min(u32(x), LOBE_ROUGHNESSES - 2u);
    return LobeCell(row, x - f32(row), select(0.0, cells, roughness > 0.0 && roughness < 1.0));
}

// `h_l` and its derivative by roughness.
fn lobe_value(cell: LobeCell, l: u32) -> vec2f {
    let at = LUT_FLOATS + cell.row * LOBE_DEGREES + l;
    let low = constants[at];
    let high = constants[at + LOBE_DEGREES];
    return vec2f(low * (1.0 - cell.fraction) + high * cell.fraction, (high - low) * cell.derivative);
}
