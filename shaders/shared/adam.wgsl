// Adam (Kingma and Ba 2015), as src/train/optimiser.rs.
// Typed, so that 1 - beta rounds as it does on the host.
const BETA1: f32 = 0.9;
const BETA2: f32 = 0.999;
const ADAM_EPSILON = 1e-15;

struct Adam {
    // What to take off the parameter.
    step: f32,
    first: f32,
    second: f32,
}

// `rate`: over the correction of the first moment; `correction`: root of that of the second.
fn adam(first: f32, second: f32, gradient: f32, rate: f32, correction: f32) -> Adam {
    let m = BETA1 * first + (1.0 - BETA1) * gradient;
    let v = BETA2 * second + (1.0 - BETA2) * gradient * gradient;
    return Adam(rate * m / (sqrt(v) / correction + ADAM_EPSILON), m, v);
}
