// Sums over a Gaussian's prototype scores for update.wgsl: the mixture of its albedo, and the aggregation term. The importing
// kernel declares its bindings.
#import attributes
#import generated/objective

// Values from the softmax of a Gaussian's scores.
struct Mixture {
    // Largest score and the sum of e^(score - top).
    top: f32,
    total: f32,
    // Gradient by albedo where its clamp passes it; the next member is its product with the mixture.
    by_albedo: vec3f,
    by_mixture: f32,
    // Aggregation (Eq. 24): prod (1 - p), Q, sum of p times the gradient by p.
    all: f32,
    q: f32,
    by_aggregation: f32,
}

fn score_ix(gaussian_ix: u32, k: u32) -> u32 {
    return model.scores + gaussian_ix * model.n_scores + k;
}

fn share(m: Mixture, gaussian_ix: u32, k: u32) -> f32 {
    return exp(params[score_ix(gaussian_ix, k)] - m.top) / m.total;
}

fn albedo_of_prototype(k: u32) -> vec3f {
    return clamp(prototype(k), vec3f(0.0), vec3f(1.0));
}

fn rest(p: f32) -> f32 {
    return max(1.0 - p, AGGREGATION_EPSILON);
}

// Derivative of `-scale ln Q` by p.
fn aggregation_derivative(m: Mixture, p: f32) -> f32 {
    if m.q <= AGGREGATION_EPSILON {
        return 0.0;
    }
    let own = m.all / rest(p);
    let others = m.q - p * own;
    let through = select(0.0, others / rest(p), 1.0 - p > AGGREGATION_EPSILON);
    return -update.aggregation / m.q * (own - through);
}

// Sums over the scores; each share is recomputed on use, because K values do not fit in registers.
fn mixture_of(gaussian_ix: u32, up: Upstream) -> Mixture {
    var m: Mixture;
    let scale = mixture_scale(gaussian_ix);
    m.top = scale.x;
    m.total = scale.y;
    var mixed = vec3f(0.0);
    m.all = 1.0;
    for (var k = 0u; k < model.n_scores; k++) {
        let p = share(m, gaussian_ix, k);
        mixed += p * albedo_of_prototype(k);
        m.all *= rest(p);
    }
    let albedo = mixed + params_vec3(model.residual + 3u * gaussian_ix);
    let is_inside = (albedo > vec3f(0.0)) & (albedo < vec3f(1.0));
    m.by_albedo = select(vec3f(0.0), channel_albedo(channels(up, ALBEDO_GROUP)), is_inside);
    m.by_mixture = select(0.0, dot(m.by_albedo, mixed), up.visible && update.groups >= GROUPS_MATERIAL);
    m.q = 0.0;
    m.by_aggregation = 0.0;
    if update.aggregation != 0.0 {
        for (var k = 0u; k < model.n_scores; k++) {
            let p = share(m, gaussian_ix, k);
            m.q += p * m.all / rest(p);
        }
        for (var k = 0u; k < model.n_scores; k++) {
            let p = share(m, gaussian_ix, k);
            m.by_aggregation += p * aggregation_derivative(m, p);
        }
    }
    return m;
}
