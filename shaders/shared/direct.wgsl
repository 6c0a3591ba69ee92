// Shading by the dominant lights: the port of crates/engine/src/cpu/direct.rs, a part of `shading`.

// Smallest alpha = roughness^2 of a highlight.
const MIN_GGX_ALPHA = 1e-4;

struct Direct {
    irradiance: vec3f,
    specular: vec3f,
}

// Reflection of one light by the facets of a surface.
struct Highlight {
    half_way: vec3f,
    half_length: f32,
    // n x h: its square is 1 - (n . h)^2 without cancellation.
    across: vec3f,
    across_squared: f32,
    // Square of the widened lobe's alpha, and its derivative by roughness.
    alpha_squared: f32,
    alpha_squared_by_rough: f32,
    spread: f32,
    distribution: f32,
    // sqrt(alpha^2 + (1 - alpha^2) c^2) of the cosines to the light and to the camera.
    root_nol: f32,
    root_nov: f32,
    // n.w G / (4 n.v n.w).
    shadowing: f32,
    // (1 - v . h)^5.
    fresnel: f32,
}

fn light_irradiance(light_ix: u32) -> vec3f {
    let at = tables.first_light + 3u * light_ix;
    return vec3f(light_tables[at], light_tables[at + 1u], light_tables[at + 2u]);
}

fn highlight_of(s: ptr<function, Surface>, normal: vec3f, nov: f32, nol: f32, light: vec4f) -> Highlight {
    var f: Highlight;
    let both = (*s).view + light.xyz;
    f.half_length = length3(both);
    f.half_way = both / f.half_length;
    f.across = cross(normal, f.half_way);
    f.across_squared = dot(f.across, f.across);
    let squared = (*s).rough * (*s).rough;
    let alpha = max(squared, MIN_GGX_ALPHA);
    let widened = alpha * alpha + 0.25 * light.w * light.w;
    let a = min(widened, 1.0);
    f.alpha_squared = a;
    f.alpha_squared_by_rough = select(0.0, 4.0 * alpha * (*s).rough, squared > MIN_GGX_ALPHA && widened < 1.0);
    f.spread = a + (1.0 - a) * f.across_squared;
    f.distribution = a * INV_PI / (f.spread * f.spread);
    f.root_nol = sqrt(a + (1.0 - a) * nol * nol);
    f.root_nov = sqrt(a + (1.0 - a) * nov * nov);
    f.shadowing = 0.5 * nol / (nov * f.root_nol + nol * f.root_nov);
    let away = max(1.0 - 0.5 * f.half_length, 0.0);
    f.fresnel = away * away * away * away * away;
    return f;
}

// Light of the dominant lights at a surface with unit `normal`, turned to the camera.
fn direct(s: ptr<function, Surface>, normal: vec3f, nov: f32) -> Direct {
    var out = Direct(vec3f(0.0), vec3f(0.0));
    let f0 = DIELECTRIC_F0 * (1.0 - (*s).metal) + (*s).albedo * (*s).metal;
    for (var k = 0u; k < tables.n_lights; k++) {
        let light = tables.lights[k];
        let nol = dot(normal, light.xyz);
        let arriving = (*s).arriving[k];
        if nol > 0.0 && arriving > 0.0 {
            let f = highlight_of(s, normal, nov, nol, light);
            let irradiance = arriving * light_irradiance(k);
            out.irradiance += irradiance * nol;
            out.specular += irradiance * (f.distribution * f.shadowing) * (f0 + (1.0 - f0) * f.fresnel);
        }
    }
    return out;
}
