// Chain rule of the projection: the part of update.wgsl from a splat's gradient to the Gaussian's geometry. The importing
// kernel declares its bindings.
#import attributes
#import splat
#import camera

// Gradients that several chain rules share.
struct Geometry {
    mean: vec3f,
    log_scale: vec3f,
    // Column c is the gradient of axis c.
    rotation: mat3x3f,
    opacity: f32,
}

// Chain rule of the projection (docs/MODEL.md, section 2).
fn project_backward(gaussian_ix: u32, up: Upstream, axes: mat3x3f, log_scale: vec3f, mean: vec3f) -> Geometry {
    let s = splats[gaussian_ix];
    let by_head = splat_gradients[up.row];
    let by_tail = splat_gradients[up.row + 1u];
    let logit = params[model.opacity + gaussian_ix];
    let at_camera = to_camera(camera, mean);
    let inverse = 1.0 / at_camera.z;
    let ratio = at_camera.xy * inverse;
    let clamped = clamp(ratio, camera.ratio_limits.xz, camera.ratio_limits.yw);
    let is_inside = (ratio > camera.ratio_limits.xz) & (ratio < camera.ratio_limits.yw);
    // T = J R, its two rows.
    let scaled = camera.focal * inverse;
    let t0 = scaled.x * (camera.rotation[0].xyz - clamped.x * camera.rotation[2].xyz);
    let t1 = scaled.y * (camera.rotation[1].xyz - clamped.y * camera.rotation[2].xyz);
    let scale = exp(clamp(log_scale, vec3f(-LOG_SCALE_LIMIT), vec3f(LOG_SCALE_LIMIT)));
    let m = mat3x3f(axes[0] * scale.x, axes[1] * scale.y, axes[2] * scale.z);
    let screen0 = t0 * m;
    let screen1 = t1 * m;
    // With x_k an axis on screen and y_k = C x_k, the gradient of the conic C is -2 C dC y_k by x_k and -2 y_k . dC y_k by
    // its ln length. For a needle, y is the inverse of its length and would cancel out as a difference of C's entries times
    // x. adj(raw) x_k = sum over the other axes j of (x_k x x_j) perp x_j has no such difference.
    let lp = low_pass_of(camera, at_camera.z, params[model.sampling_rate + gaussian_ix]);
    let area = cross(screen0, screen1);
    let raw_determinant = dot(area, area);
    let determinant = raw_determinant + lp * (dot(screen0, screen0) + dot(screen1, screen1)) + lp * lp;
    let adjugate0 = cross(screen1, area);
    let adjugate1 = cross(area, screen0);
    let y0 = (adjugate0 + lp * screen0) / determinant;
    let y1 = (adjugate1 + lp * screen1) / determinant;
    let c = s.conic;
    let d = vec3f(by_head.z, 0.5 * by_head.w, by_tail.x);
    let v0 = d.x * y0 + d.y * y1;
    let v1 = d.y * y0 + d.z * y1;
    var by_screen0 = -2.0 * (c.x * v0 + c.y * v1);
    var by_screen1 = -2.0 * (c.y * v0 + c.z * v1);
    var by_length = -2.0 * (y0 * v0 + y1 * v1);
    // The gradient of sqrt(det raw / det covariance). Below this determinant the derivative of its root overflows f32.
    if camera.low_pass_compensation != 0u && raw_determinant > MIN_DETERMINANT {
        let factor = s.compensation * by_tail.y * sigmoid(logit);
        let sharper0 = factor * (adjugate0 / raw_determinant - y0);
        let sharper1 = factor * (adjugate1 / raw_determinant - y1);
        by_screen0 += sharper0;
        by_screen1 += sharper1;
        by_length += sharper0 * screen0 + sharper1 * screen1;
    }
    var out: Geometry;
    out.opacity = by_tail.y * s.compensation * sigmoid_derivative(logit);
    let by_m0 = t0 * by_screen0.x + t1 * by_screen1.x;
    let by_m1 = t0 * by_screen0.y + t1 * by_screen1.y;
    let by_m2 = t0 * by_screen0.z + t1 * by_screen1.z;
    out.rotation = mat3x3f(by_m0 * scale.x, by_m1 * scale.y, by_m2 * scale.z);
    out.log_scale = by_length;
    let by_t0 = m * by_screen0;
    let by_t1 = m * by_screen1;
    let diagonal = vec2f(dot(by_t0, camera.rotation[0].xyz), dot(by_t1, camera.rotation[1].xyz));
    let slanted = vec2f(dot(by_t0, camera.rotation[2].xyz), dot(by_t1, camera.rotation[2].xyz));
    // Inside the limits the clamped ratio is the true one; outside only the mean's own ratio has a derivative.
    let by_ratio = camera.focal * by_head.xy + select(vec2f(0.0), -camera.focal * inverse * slanted, is_inside);
    let by_depth = inverse * inverse * camera.focal * (slanted * clamped - diagonal) - by_ratio * ratio * inverse;
    out.mean = to_world(camera, vec3f(by_ratio * inverse, by_depth.x + by_depth.y));
    return out;
}
