// Linear radiance to display values, forward and backward: the port of `SurfaceShader::display` of
// crates/engine/src/cpu/display.rs.
#import generated/light
#import srgb

// Linear radiance up to `peak` to display values; `is_srgb`: through the sRGB curve.
fn display(linear: vec3f, is_srgb: bool, peak: f32) -> vec3f {
    let x = clamp(linear, vec3f(0.0), vec3f(peak));
    return select(x, vec3f(srgb(x.x), srgb(x.y), srgb(x.z)), is_srgb);
}

fn channel_backward(linear: f32, g: f32, is_srgb: bool, peak: f32) -> f32 {
    if linear < 0.0 || (linear > peak && g <= 0.0) {
        return 0.0;
    }
    return g * select(1.0, srgb_derivative(min(linear, peak)), is_srgb);
}

// Chain rule through `display`; above `peak` only gradients that lower the value pass.
fn display_backward(linear: vec3f, g: vec3f, is_srgb: bool, peak: f32) -> vec3f {
    return vec3f(
        channel_backward(linear.x, g.x, is_srgb, peak),
        channel_backward(linear.y, g.y, is_srgb, peak),
        channel_backward(linear.z, g.z, is_srgb, peak),
    );
}
