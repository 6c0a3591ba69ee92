// A Gaussian's loss against the backward transmittance of this view (article Eq. 15), for update.wgsl, which declares the
// bindings.
#import attributes
#import generated/objective
#import sh_walk

// Loss of the view's label and its derivative by the visibility towards the continuing ray; zero without a label.
fn view_label(gaussian_ix: u32, up: Upstream, sh_degree: u32, direction: vec3f) -> vec2f {
    let base = model.visibility + gaussian_ix * model.n_visibility;
    let label = view_labels[gaussian_ix];
    if !(up.visible && label.y > MIN_LABEL_WEIGHT) {
        return vec2f(0.0);
    }
    let p = label.x / label.y;
    var raw = 0.0;
    for (var term = sh_first(sh_degree, direction); sh_is_term(term); sh_next(&term)) {
        let ix = sh_indices(term);
        let y = sh_values(term);
        raw += y.x * params[base + ix.x];
        if term.m > 0u {
            raw += y.y * params[base + ix.y];
        }
    }
    var v: f32;
    var derivative: f32;
    if model.visibility_form == VISIBILITY_SIGMOID {
        // With logits: the derivative by the logit is V - p.
        v = clamp(sigmoid(raw), SIGMOID_MARGIN, 1.0 - SIGMOID_MARGIN);
        derivative = v - p;
    } else {
        v = clamp(raw, LABEL_MARGIN, 1.0 - LABEL_MARGIN);
        derivative = (1.0 - p) / (1.0 - v) - p / v;
        // Outside the margin a gradient passes only where a step against it leads back inside.
        let runs_away = (raw < v && derivative > 0.0) || (raw > v && derivative < 0.0);
        derivative = select(derivative, 0.0, runs_away);
    }
    let scale = update.view_labels / f32(max(label_count[0], 1u));
    return scale * vec2f(-(p * log(v) + (1.0 - p) * log(1.0 - v)), derivative);
}
