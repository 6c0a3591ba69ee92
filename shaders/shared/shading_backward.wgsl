// Chain rule through `shade` (crates/engine/src/cpu/surface_shader.rs). With ALL_CHANNELS it also computes the gradient by
// visibility.
#import shading
#import direct_backward

struct SurfaceGradient {
    normal: vec3f,
    albedo: vec3f,
    metal: f32,
    rough: f32,
    sheen: f32,
    // Gradient by the direction to the camera.
    view: vec3f,
    blocked: vec3f,
    gathered: vec3f,
    // Gradient by the irradiance of the dominant lights.
    lights: array<vec3f, MAX_LIGHTS>,
    // Gradient by irradiance before the clamp, for the diffuse table.
    irradiance: vec3f,
    // Gradient by the light of the two specular levels, for the specular tables.
    level: array<vec3f, 2>,
    // Gradients by ambient occlusion and by visibility over the lobe, before the squash.
    ambient_raw: f32,
    visible_raw: f32,
    // Gradient by visibility times visibility, summed.
    along_visibility: f32,
#ifdef ALL_CHANNELS
    visibility: array<vec4f, N_QUADS>,
#endif
}

// Adds the gradient through a sum over the visibility field along `d`, whose degree l counts `factors[l].x` and changes by
// `factors[l].y` with roughness; returns the gradient by `d`.
fn field_backward(
    s: ptr<function, Surface>,
    d: vec3f,
    factors: ptr<function, array<vec2f, 7>>,
    out: ptr<function, SurfaceGradient>,
) -> vec3f {
    var y: array<f32, 49>;
    var dy: array<vec3f, 49>;
    sh_basis_with_gradient(sh_degree(), d, &y, &dy);
    var by_d = vec3f(0.0);
    for (var l = 0u; l <= sh_degree(); l++) {
        let factor = (*factors)[l];
        for (var j = l * l; j < (l + 1u) * (l + 1u); j++) {
            let c = (*s).visibility[j / 4u][j % 4u];
            by_d += (factor.x * c) * dy[j];
            (*out).along_visibility += factor.x * y[j] * c;
            (*out).rough += factor.y * y[j] * c;
#ifdef ALL_CHANNELS
            (*out).visibility[j / 4u][j % 4u] += factor.x * y[j];
#endif
        }
    }
    return by_d;
}

// Gradients by the normal and by the reflection through ambient occlusion and specular visibility, given those by the two
// values before the squash. One loop, so that the large body is compiled once.
fn visibility_backward(
    s: ptr<function, Surface>,
    normal: vec3f,
    reflection: vec3f,
    by_raw: vec2f,
    out: ptr<function, SurfaceGradient>,
) -> array<vec3f, 2> {
    var nrsh = NRSH_FACTORS;
    let cell = lobe_cell((*s).rough);
    var by = array<vec3f, 2>(vec3f(0.0), vec3f(0.0));
    for (var which = 0u; which < 2u; which++) {
        let derivative = by_raw[which];
        if derivative == 0.0 {
            continue;
        }
        var factors: array<vec2f, 7>;
        for (var l = 0u; l <= sh_degree(); l++) {
            factors[l] = derivative * select(attenuation(cell, l), vec2f(nrsh[l], 0.0), which == 0u);
        }
        by[which] = field_backward(s, select(reflection, normal, which == 0u), &factors, out);
    }
    return by;
}

#ifdef ALL_CHANNELS
// Adds the rows of `node`, weighted by colour, to the gradient by visibility.
fn rows_backward(out: ptr<function, SurfaceGradient>, node: u32, weight: vec3f) {
    let quads = tables.coefficients / 4u;
    let first = node * 3u * quads;
    for (var quad = 0u; quad < N_QUADS; quad++) {
        let at = first + quad;
        let row = weight.x * light_quads[at] + weight.y * light_quads[at + quads] + weight.z * light_quads[at + 2u * quads];
        (*out).visibility[quad] += masked_quad(quad, row);
    }
}
#endif

// Gradient by the normal through the tables of the diffuse term; `g` is the gradient by its radiance. The caller handles
// `ambient_raw`.
fn lambert_backward(
    s: ptr<function, Surface>,
    f: ptr<function, Lambert>,
    g: vec3f,
    out: ptr<function, SurfaceGradient>,
) -> vec3f {
    let kd = (1.0 - (*s).metal) * INV_PI;
    let light = (*f).incoming;
    (*out).albedo += g * kd * light;
    (*out).metal -= dot(g, (*s).albedo * light) * INV_PI;
    let by_light = g * (*s).albedo * kd;
    (*out).gathered = by_light;
    let is_positive = (*f).irradiance_raw > vec3f(0.0);
    let by_irradiance = select(vec3f(0.0), by_light * (*f).ambient, is_positive);
    let by_ambient = dot(select(vec3f(0.0), by_light, is_positive), (*f).irradiance_raw);
    (*out).irradiance = by_irradiance;
    var by_normal = vec3f(0.0);
    let scalar = is_scalar();
#repeat k 4
    {
        let along = dot(by_irradiance, (*f).tap_irradiance[$k]);
        by_normal += along * (*f).taps.gradient[$k];
        if !scalar {
            (*out).along_visibility += (*f).taps.weight[$k] * along;
#ifdef ALL_CHANNELS
            rows_backward(out, (*f).taps.node[$k], (*f).taps.weight[$k] * by_irradiance);
#endif
        }
    }
#end
    (*out).ambient_raw = select(0.0, by_ambient * squash_derivative((*f).ambient_raw, (*f).ambient), scalar && !is_open());
    return by_normal;
}

// Gradient by n.v (x) and by the reflection (yzw) of the specular part.
fn specular_backward(
    s: ptr<function, Surface>,
    f: ptr<function, Shaded>,
    g: vec3f,
    out: ptr<function, SurfaceGradient>,
) -> vec4f {
    let f0 = DIELECTRIC_F0 * (1.0 - (*s).metal) + (*s).albedo * (*s).metal;
    let lut = (*f).lut;
    let visible = (*f).visible;
    let light = visible * (*f).prefiltered + (1.0 - visible) * (*s).blocked;
    let by_light = g * (f0 * lut.value.x + lut.value.y);
    let by_reflectance = g * light;
    let by_f0 = by_reflectance * lut.value.x;
    (*out).albedo += by_f0 * (*s).metal;
    (*out).metal += dot(by_f0, (*s).albedo - DIELECTRIC_F0);
    let by_nov = dot(by_reflectance, f0 * lut.by_nov.x + lut.by_nov.y);
    (*out).rough += dot(by_reflectance, f0 * lut.by_roughness.x + lut.by_roughness.y);
    let by_visible = dot(by_light, (*f).prefiltered - (*s).blocked);
    (*out).blocked = by_light * (1.0 - visible);
    let by_prefiltered = by_light * visible;
    let position = (*f).position;
    (*out).level[0] = by_prefiltered * (1.0 - position.fraction);
    (*out).level[1] = by_prefiltered * position.fraction;
    (*out).rough += position.derivative * dot(by_prefiltered, (*f).level_value[1] - (*f).level_value[0]);
    var by_reflection = vec3f(0.0);
#repeat k 2
#repeat j 4
    {
        let value = specular_node(position.level + $ku, (*f).level_taps[$k].node[$j]);
        by_reflection += dot((*out).level[$k], value) * (*f).level_taps[$k].gradient[$j];
    }
#end
#end
    (*out).visible_raw = by_visible * squash_derivative((*f).visible_raw, visible);
    return vec4f(by_nov, by_reflection);
}

fn shade_backward(s: ptr<function, Surface>, f: ptr<function, Shaded>, g: vec3f) -> SurfaceGradient {
    var out: SurfaceGradient;
    // A copy: naga 30 cannot form a pointer to a member through a pointer.
    var diffuse = (*f).lambert;
    var by_normal = lambert_backward(s, &diffuse, g * ((*f).sheen.gain * (*f).share.value), &out);
    let by_gain = dot(g, (*f).lambert.radiance);
    out.sheen = by_gain * (*f).share.value * (*f).sheen.by_sheen;
    out.rough += by_gain * (*f).sheen.gain * (*f).share.by_roughness;
    let by = specular_backward(s, f, g, &out);
    let by_field = visibility_backward(s, (*f).normal, (*f).reflection, vec2f(out.ambient_raw, out.visible_raw), &out);
    by_normal += by_field[0];
    // R = normalize(2 nov n - v), nov = n . v.
    let by_bent = normalised3_backward((*f).reflection, (*f).reflection_length, by.yzw + by_field[1]);
    let by_direct = direct_backward(s, (*f).normal, (*f).nov, out.gathered, g, &out);
    by_normal += by_direct.xyz;
    let by_nov = by.x + 2.0 * dot(by_bent, (*f).normal) + by_gain * ((*f).sheen.by_nov * (*f).share.value + (*f).sheen.gain * (*f).share.by_nov) + by_direct.w;
    by_normal += 2.0 * (*f).nov * by_bent + select(0.0, by_nov, (*f).nov_inside) * (*s).view;
    out.view += select(0.0, by_nov, (*f).nov_inside) * (*f).normal - by_bent;
    let sign = select(1.0, -1.0, (*f).flipped);
    out.normal = normalised3_backward(sign * (*f).normal, (*f).normal_length, sign * by_normal);
    return out;
}
