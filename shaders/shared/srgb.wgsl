// The sRGB curve, whose power continues above 1, its derivative and its inverse: the port of crates/engine/src/cpu/display.rs.

fn srgb(x: f32) -> f32 {
    return select(1.055 * pow(max(x, 0.0031308), 1.0 / 2.4) - 0.055, 12.92 * x, x <= 0.0031308);
}

fn srgb_derivative(x: f32) -> f32 {
    return select(1.055 / 2.4 * pow(max(x, 0.0031308), 1.0 / 2.4 - 1.0), 12.92, x <= 0.0031308);
}

fn linear_from_srgb(x: f32) -> f32 {
    return select(pow((max(x, 0.04045) + 0.055) / 1.055, 2.4), x / 12.92, x <= 0.04045);
}
