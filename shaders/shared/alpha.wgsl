// Alpha of a splat at a pixel, the same in every kernel that blends (docs/MODEL.md Eq. 4).
//
// The exponent 0.5 d^T C d is computed as a sum of two squares (the Cholesky factor of C): for needles the terms of the
// quadratic form cancel; the sum of squares keeps its digits and cannot become negative. With C = [a b; b c] it is
// 0.5 ((sqrt(a) dx + b / sqrt(a) dy)^2 + dy^2 / yy), since c - b^2 / a = 1 / yy.
#import splat

// sqrt(0.5 log2(e)), so that the squares are exponents of two.
const TO_LOG2 = 0.849321800288019;

// The values of a splat that a pixel needs, as two aligned vectors.
struct Footprint {
    // Mean x, y; opacity; unused.
    place: vec4f,
    // sqrt(a), b / sqrt(a), 1 / sqrt(yy), all times TO_LOG2; unused.
    axes: vec4f,
}

fn footprint_of(s: Splat) -> Footprint {
    let root = sqrt(s.conic.x);
    let axes = TO_LOG2 * vec3f(root, s.conic.y / root, inverseSqrt(s.covariance.z));
    return Footprint(vec4f(s.mean, s.opacity, 0.0), vec4f(axes, 0.0));
}

// Alpha before the cap, 0 where below ALPHA_MIN; `centre` is the pixel's centre.
fn alpha_at(f: Footprint, centre: vec2f) -> f32 {
    let d = centre - f.place.xy;
    let u = f.axes.x * d.x + f.axes.y * d.y;
    let v = f.axes.z * d.y;
    let alpha = f.place.z * exp2(-(u * u + v * v));
    return select(0.0, alpha, alpha >= ALPHA_MIN);
}

// Alpha after the cap.
fn capped(alpha: f32) -> f32 {
    return min(alpha, ALPHA_MAX);
}

// The end of a pixel's blending.
struct BlendEnd {
    // Transmittance behind the last splat that counted.
    transmittance: f32,
    // The slot after that splat's.
    slot: u32,
}
