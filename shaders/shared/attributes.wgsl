// Attributes of a Gaussian from its raw parameters (docs/MODEL.md, sections 1 and 3), for the forward and the backward
// kernel. The including kernel declares the bindings `model: Layout`, `params: array<f32>` and
// `globals: array<f32>` (prototypes first).
#import generated/parameters
#import quaternion

const NO_AXIS = 3u;

struct Normal {
    unit: vec3f,
    // Length before normalisation, at least 1e-12.
    length: f32,
    // Column of the rotation that gave the normal, or NO_AXIS, and its sign.
    axis: u32,
    sign: f32,
}

fn params_vec3(at: u32) -> vec3f {
    return vec3f(params[at], params[at + 1u], params[at + 2u]);
}

fn quaternion_at(gaussian_ix: u32) -> vec4f {
    let at = model.quaternion + 4u * gaussian_ix;
    return vec4f(params[at], params_vec3(at + 1u));
}

fn sigmoid(x: f32) -> f32 {
    return 1.0 / (1.0 + exp(-clamp(x, -80.0, 80.0)));
}

// The normal of a Gaussian seen along `to_mean` (mean minus camera centre).
fn normal_of(gaussian_ix: u32, to_mean: vec3f) -> Normal {
    var sum = params_vec3(model.normal + 3u * gaussian_ix);
    var axis = NO_AXIS;
    var sign = 1.0;
    if model.normal_form == NORMAL_SHORTEST_AXIS {
        let s = params_vec3(model.log_scale + 3u * gaussian_ix);
        axis = select(select(2u, 1u, s.y <= s.z), 0u, s.x <= s.y && s.x <= s.z);
        let rotation = rotation_of(quaternion_at(gaussian_ix));
        let direction = select(select(rotation[2], rotation[1], axis == 1u), rotation[0], axis == 0u);
        sign = select(1.0, -1.0, dot(direction, to_mean) > 0.0);
        sum += sign * direction;
    }
    let length = length3(sum);
    return Normal(sum / length, length, axis, sign);
}

fn prototype(k: u32) -> vec3f {
    return vec3f(globals[3u * k], globals[3u * k + 1u], globals[3u * k + 2u]);
}

// Scale of the softmax over the prototype scores: the largest score and the sum of exp(score - largest).
fn mixture_scale(gaussian_ix: u32) -> vec2f {
    let first = model.scores + model.n_scores * gaussian_ix;
    var top = -3e38;
    for (var k = 0u; k < model.n_scores; k++) {
        top = max(top, params[first + k]);
    }
    var total = 0.0;
    for (var k = 0u; k < model.n_scores; k++) {
        total += exp(params[first + k] - top);
    }
    return vec2f(top, total);
}

// Unclamped albedo (Eq. 23).
fn albedo_of(gaussian_ix: u32) -> vec3f {
    let first = model.scores + model.n_scores * gaussian_ix;
    let scale = mixture_scale(gaussian_ix);
    var mixed = vec3f(0.0);
    for (var k = 0u; k < model.n_scores; k++) {
        mixed += exp(params[first + k] - scale.x) * clamp(prototype(k), vec3f(0.0), vec3f(1.0));
    }
    return params_vec3(model.residual + 3u * gaussian_ix) + select(vec3f(0.0), mixed / scale.y, model.n_scores > 0u);
}
