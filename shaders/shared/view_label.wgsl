// A Gaussian's loss against the backward transmittance of this view (article Eq. 15), for update.wgsl, which declares the
// bindings.
#import attributes
#import labels
#import sh_walk

// Visibility is kept this far from 0 and 1 inside the logarithms; the sigmoid's, this far.
const LABEL_MARGIN = 1e-3;
const SIGMOID_MARGIN = 1e-6;

// Loss of the view's label and its slope by the visibility towards the continuing ray; zero without a label.
fn view_label(gaussian_ix: u32, up: Upstream, order: u32, direction: vec3f) -> vec2f {
    let base = model.visibility + gaussian_ix * model.n_visibility;
    let label = view_labels[gaussian_ix];
    if !(up.visible && label.y > LEAST_LABEL_WEIGHT) {
        return vec2f(0.0);
    }
    let p = label.x / label.y;
    var raw = 0.0;
    for (var walk = sh_walk(order, direction); sh_walking(walk); sh_walk_on(&walk)) {
        let ix = sh_indices(walk);
        let y = sh_values(walk);
        raw += y.x * params[base + ix.x];
        if walk.m > 0u {
            raw += y.y * params[base + ix.y];
        }
    }
    var v: f32;
    var slope: f32;
    if model.visibility_form == VISIBILITY_SIGMOID {
        // With logits: the slope by the logit is V - p.
        v = clamp(sigmoid(raw), SIGMOID_MARGIN, 1.0 - SIGMOID_MARGIN);
        slope = v - p;
    } else {
        v = clamp(raw, LABEL_MARGIN, 1.0 - LABEL_MARGIN);
        slope = (1.0 - p) / (1.0 - v) - p / v;
        // Outside the margin only a slope that leads back in passes: saturated, but neither stuck nor running away.
        let runs_away = (raw < v && slope > 0.0) || (raw > v && slope < 0.0);
        slope = select(slope, 0.0, runs_away);
    }
    let scale = update.view_labels / f32(max(label_count[0], 1u));
    return scale * vec2f(-(p * log(v) + (1.0 - p) * log(1.0 - v)), slope);
}
