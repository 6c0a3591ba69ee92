// Chain rule of the projection: the part of update.wgsl that goes from a splat's gradient to the Gaussian's geometry. The
// including kernel declares its bindings.
#import attributes
#import splat
#import view

// Gradients of what several chain rules share.
struct Geometry {
    mean: vec3f,
    log_scale: vec3f,
    // Column c is the gradient of axis c.
    rotation: mat3x3f,
    opacity: f32,
}

// The gradient of `sqrt(det raw / det covariance)`, raw being the covariance without the low-pass.
fn compensation_backward(s: Splat, raw: vec3f, by_compensation: f32) -> vec3f {
    let determinant = s.raw_determinant;
    if !(determinant > 1e-12) {
        return vec3f(0.0);
    }
    let inverse = vec3f(raw.z, -raw.y, raw.x) / determinant;
    return 0.5 * s.compensation * by_compensation * (inverse - s.conic);
}

// Chain rule of the projection (docs/MODEL.md section 2).
fn project_backward(gaussian_ix: u32, up: Upstream, axes: mat3x3f, log_scale: vec3f, mean: vec3f) -> Geometry {
    let s = splats[gaussian_ix];
    let by_head = splat_gradients[up.row];
    let by_tail = splat_gradients[up.row + 1u];
    let logit = params[model.opacity + gaussian_ix];
    let camera = to_camera(view, mean);
    let inverse = 1.0 / camera.z;
    let ratio = camera.xy * inverse;
    let clamped = clamp(ratio, view.ratio_limits.xz, view.ratio_limits.yw);
    let is_inside = (ratio > view.ratio_limits.xz) & (ratio < view.ratio_limits.yw);
    // T = J R, its two rows.
    let scaled = view.focal * inverse;
    let t0 = scaled.x * (view.rotation[0].xyz - clamped.x * view.rotation[2].xyz);
    let t1 = scaled.y * (view.rotation[1].xyz - clamped.y * view.rotation[2].xyz);
    let scale = exp(clamp(log_scale, vec3f(-60.0), vec3f(60.0)));
    let m = mat3x3f(axes[0] * scale.x, axes[1] * scale.y, axes[2] * scale.z);
    let screen0 = t0 * m;
    let screen1 = t1 * m;
    // By covariance: -C dC C with C the conic.
    let c = s.conic;
    let d = vec3f(by_head.z, 0.5 * by_head.w, by_tail.x);
    let left0 = vec2f(c.x * d.x + c.y * d.y, c.x * d.y + c.y * d.z);
    let left1 = vec2f(c.y * d.x + c.z * d.y, c.y * d.y + c.z * d.z);
    var cov = -vec3f(dot(left0, c.xy), dot(left0, c.yz), dot(left1, c.yz));
    if view.low_pass_compensation != 0u {
        let raw = vec3f(dot(screen0, screen0), dot(screen0, screen1), dot(screen1, screen1));
        cov += compensation_backward(s, raw, by_tail.y * sigmoid(logit));
    }
    let by_screen0 = 2.0 * (cov.x * screen0 + cov.y * screen1);
    let by_screen1 = 2.0 * (cov.y * screen0 + cov.z * screen1);
    var out: Geometry;
    out.opacity = by_tail.y * s.compensation * sigmoid_slope(logit);
    let by_m0 = t0 * by_screen0.x + t1 * by_screen1.x;
    let by_m1 = t0 * by_screen0.y + t1 * by_screen1.y;
    let by_m2 = t0 * by_screen0.z + t1 * by_screen1.z;
    out.rotation = mat3x3f(by_m0 * scale.x, by_m1 * scale.y, by_m2 * scale.z);
    out.log_scale = vec3f(dot(by_m0, m[0]), dot(by_m1, m[1]), dot(by_m2, m[2]));
    let by_t0 = m * by_screen0;
    let by_t1 = m * by_screen1;
    let diagonal = vec2f(dot(by_t0, view.rotation[0].xyz), dot(by_t1, view.rotation[1].xyz));
    let slanted = vec2f(dot(by_t0, view.rotation[2].xyz), dot(by_t1, view.rotation[2].xyz));
    // Inside, the clamped ratio is the true one; outside only the mean's own ratio moves.
    let by_ratio = view.focal * by_head.xy + select(vec2f(0.0), -view.focal * inverse * slanted, is_inside);
    let by_depth = inverse * inverse * view.focal * (slanted * clamped - diagonal) - by_ratio * ratio * inverse;
    out.mean = to_world(view, vec3f(by_ratio * inverse, by_depth.x + by_depth.y));
    return out;
}
