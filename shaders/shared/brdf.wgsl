// The split-sum table (crates/scene/src/light/brdf.rs) and the position between specular levels
// (crates/scene/src/light/operators/mod.rs). The importer binds the tables of `gpu::light::Constants` as `constants`: 32 x 32
// (scale, bias) by roughness and n.v, then the lobe rows.
#import generated/light

const LUT_FLOATS = 2u * LUT_SIZE * LUT_SIZE;

struct LutSample {
    // Scale and bias.
    value: vec2f,
    by_nov: vec2f,
    by_roughness: vec2f,
}

struct LutCell {
    first: u32,
    fraction: f32,
    derivative: f32,
}

fn lut_cell(v: f32) -> LutCell {
    let x = v * f32(LUT_SIZE) - 0.5;
    if !(x > 0.0) {
        return LutCell(0u, 0.0, 0.0);
    }
    if x >= f32(LUT_SIZE - 1u) {
        return LutCell(LUT_SIZE - 2u, 1.0, 0.0);
    }
    let first = u32(x);
    return LutCell(first, x - f32(first), f32(LUT_SIZE));
}

fn lut_texel(row: u32, column: u32) -> vec2f {
    let at = 2u * (min(row, LUT_SIZE - 1u) * LUT_SIZE + min(column, LUT_SIZE - 1u));
    return vec2f(constants[at], constants[at + 1u]);
}

// Bilinear, clamped at the border, derivatives zero where clamped.
fn lut_sample(nov: f32, roughness: f32) -> LutSample {
    let x = lut_cell(nov);
    let y = lut_cell(roughness);
    let a = lut_texel(y.first, x.first);
    let b = lut_texel(y.first, x.first + 1u);
    let c = lut_texel(y.first + 1u, x.first);
    let d = lut_texel(y.first + 1u, x.first + 1u);
    let top = a * (1.0 - x.fraction) + b * x.fraction;
    let bottom = c * (1.0 - x.fraction) + d * x.fraction;
    return LutSample(
        top * (1.0 - y.fraction) + bottom * y.fraction,
        ((b - a) * (1.0 - y.fraction) + (d - c) * y.fraction) * x.derivative,
        (bottom - top) * y.derivative,
    );
}

// Share of the light that the highlight of a dielectric leaves for the diffuse term, with derivatives.
struct DiffuseShare {
    value: f32,
    by_nov: f32,
    by_roughness: f32,
}

// 1 for a diffuse term that does not conserve energy.
fn diffuse_share(lut: LutSample, conserves_energy: bool) -> DiffuseShare {
    if !conserves_energy {
        return DiffuseShare(1.0, 0.0, 0.0);
    }
    return DiffuseShare(
        1.0 - (DIELECTRIC_F0 * lut.value.x + lut.value.y),
        -(DIELECTRIC_F0 * lut.by_nov.x + lut.by_nov.y),
        -(DIELECTRIC_F0 * lut.by_roughness.x + lut.by_roughness.y),
    );
}

// Level below a roughness, the fraction towards the next, and the fraction's derivative (0 where clamped).
struct LevelPosition {
    level: u32,
    fraction: f32,
    derivative: f32,
}

fn level_position(roughness: f32) -> LevelPosition {
    var levels = SPECULAR_LEVELS;
    if !(roughness > levels[0]) {
        return LevelPosition(0u, 0.0, 0.0);
    }
    if roughness >= levels[N_LEVELS - 1u] {
        return LevelPosition(N_LEVELS - 2u, 1.0, 0.0);
    }
    var k = 0u;
    for (var i = 1u; i < N_LEVELS - 1u; i++) {
        k = select(k, i, roughness >= levels[i]);
    }
    let derivative = 1.0 / (levels[k + 1u] - levels[k]);
    return LevelPosition(k, (roughness - levels[k]) * derivative, derivative);
}
