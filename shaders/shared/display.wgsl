// Linear radiance to display values, forward and backward: the port of `SurfaceShader::display` of
// crates/engine/src/cpu/display.rs.
#import generated/light
#import srgb

// Linear radiance to display values; `is_srgb`: through the sRGB curve.
fn display(linear: vec3f, is_srgb: bool) -> vec3f {
    let x = clamp(linear, vec3f(0.0), vec3f(1.0));
    return select(x, vec3f(srgb(x.x), srgb(x.y), srgb(x.z)), is_srgb);
}

fn channel_backward(linear: f32, g: f32, is_srgb: bool) -> f32 {
    if linear < 0.0 || (linear > 1.0 && g <= 0.0) {
        return 0.0;
    }
    return g * select(1.0, srgb_derivative(min(linear, 1.0)), is_srgb);
}

// Chain rule through `display`; above 1 only gradients that lower the value pass.
fn display_backward(linear: vec3f, g: vec3f, is_srgb: bool) -> vec3f {
    return vec3f(
        channel_backward(linear.x, g.x, is_srgb),
        channel_backward(linear.y, g.y, is_srgb),
        channel_backward(linear.z, g.z, is_srgb),
    );
}
