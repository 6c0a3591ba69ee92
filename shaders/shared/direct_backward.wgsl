// Chain rule through `direct` (crates/engine/src/cpu/direct.rs), a part of `shading_backward`.

// Gradients by the unit normal (xyz) and by n.v (w), given those by irradiance and by specular radiance. Gradients with a
// field in `out` are added there; its `view` excludes the path through n.v.
fn direct_backward(
    s: ptr<function, Surface>,
    normal: vec3f,
    nov: f32,
    by_irradiance: vec3f,
    by_specular: vec3f,
    out: ptr<function, SurfaceGradient>,
) -> vec4f {
    var sum = vec4f(0.0);
    let f0 = DIELECTRIC_F0 * (1.0 - (*s).metal) + (*s).albedo * (*s).metal;
    for (var k = 0u; k < tables.n_lights; k++) {
        let light = tables.lights[k];
        let nol = dot(normal, light.xyz);
        let arriving = (*s).arriving[k];
        if nol > 0.0 && arriving > 0.0 {
            let f = highlight_of(s, normal, nov, nol, light);
            let lobe = f.distribution * f.shadowing;
            let irradiance = arriving * light_irradiance(k);
            let reflectance = f0 + (1.0 - f0) * f.fresnel;
            (*out).lights[k] = arriving * (by_irradiance * nol + by_specular * lobe * reflectance);
            let by_reflectance = by_specular * irradiance * lobe;
            let by_f0 = by_reflectance * (1.0 - f.fresnel);
            (*out).albedo += by_f0 * (*s).metal;
            (*out).metal += dot(by_f0, (*s).albedo - DIELECTRIC_F0);
            let by = vec3f(
                dot(by_irradiance, irradiance),
                dot(by_specular, irradiance * reflectance),
                dot(by_reflectance, 1.0 - f0),
            );
            sum += highlight_backward(f, normal, nov, nol, light.xyz, by, out);
        }
    }
    return sum;
}

// Chain rule from the gradients by n.w, by the lobe and by Fresnel's part.
fn highlight_backward(
    f: Highlight,
    normal: vec3f,
    nov: f32,
    nol: f32,
    towards: vec3f,
    by: vec3f,
    out: ptr<function, SurfaceGradient>,
) -> vec4f {
    let a = f.alpha_squared;
    let sum = nov * f.root_nol + nol * f.root_nov;
    let by_distribution = by.y * f.shadowing * f.distribution;
    let by_shadowing = by.y * f.distribution;
    let by_sum = -by_shadowing * f.shadowing / sum;
    let by_across = -2.0 * by_distribution * (1.0 - a) / f.spread;
    let by_alpha = by_distribution * (1.0 / a - 2.0 * (1.0 - f.across_squared) / f.spread)
        + by_sum * nov * 0.5 * (1.0 - nol * nol) / f.root_nol
        + by_sum * nol * 0.5 * (1.0 - nov * nov) / f.root_nov;
    (*out).rough += by_alpha * f.alpha_squared_by_rough;
    let by_nol = by.x + by_shadowing * 0.5 / sum
        + by_sum * (nov * (1.0 - a) * nol / f.root_nol + f.root_nov);
    let by_nov = by_sum * (f.root_nol + nol * (1.0 - a) * nov / f.root_nov);
    // d |n x h|^2 = 2 dn . (h x (n x h)) + 2 dh . ((n x h) x n).
    let turned = cross(f.half_way, f.across);
    let by_half = 2.0 * by_across * cross(f.across, normal);
    // v . h is half the length of v + w.
    let away = max(1.0 - 0.5 * f.half_length, 0.0);
    let by_length = -2.5 * by.z * away * away * away * away;
    (*out).view += normalised3_backward(f.half_way, f.half_length, by_half) + by_length * f.half_way;
    return vec4f(by_nol * towards + 2.0 * by_across * turned, by_nov);
}
