// Adam (Kingma and Ba 2015).
#import generated/objective

struct Adam {
    // Value to subtract from the parameter.
    step: f32,
    first: f32,
    second: f32,
}

// `rate`: over the correction of the first moment; `correction`: root of that of the second.
fn adam(first: f32, second: f32, gradient: f32, rate: f32, correction: f32) -> Adam {
    let m = ADAM_BETA1 * first + (1.0 - ADAM_BETA1) * gradient;
    let v = ADAM_BETA2 * second + (1.0 - ADAM_BETA2) * gradient * gradient;
    return Adam(rate * m / (sqrt(v) / correction + ADAM_EPSILON), m, v);
}
