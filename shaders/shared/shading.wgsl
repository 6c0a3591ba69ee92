// Shading of a surface (docs/MODEL.md, section 4): the port of crates/engine/src/cpu/surface_shader.rs. Uses bindings 0 to 5;
// permutations define S and ORDER.
#import surface
#import camera
#import generated/parameters
#import quaternion
#import sh
#import cube_grid
#import tables
#import brdf
#import lobe
#import lambert
#import direct
#import sheen
#import display

// Options of the forward model. Kept in step with `ShadingUniform` of crates/engine/src/gpu/shading/mod.rs.
struct Shading {
    // Display-referred.
    background: vec4f,
    visibility_form: u32,
    diffuse_form: u32,
    shade_at: u32,
    // 1: images are compared through the sRGB curve.
    srgb: u32,
    // 1: the diffuse term has the share of the light that the highlight leaves.
    conserves_energy: u32,
    // Radiance at which display values end.
    peak: f32,
    pad_b: u32,
    pad_c: u32,
}

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> shading: Shading;
@group(0) @binding(2) var<uniform> tables: Tables;
@group(0) @binding(3) var<storage, read> constants: array<f32>;
// The light tables, bound twice: as floats, and as quads for the rows of coefficients, which are multiples of 16 floats.
@group(0) @binding(4) var<storage, read> light_tables: array<f32>;
@group(0) @binding(5) var<storage, read> light_quads: array<vec4f>;

const INV_PI = 0.318309886;

// A shaded surface with the values that its backward pass needs.
struct Shaded {
    diffuse: vec3f,
    specular: vec3f,
    normal: vec3f,
    normal_length: f32,
    flipped: bool,
    nov: f32,
    nov_inside: bool,
    reflection: vec3f,
    reflection_length: f32,
    // Light of the dominant lights.
    direct: Direct,
    lambert: Lambert,
    sheen: Sheen,
    share: DiffuseShare,
    position: LevelPosition,
    level_taps: array<Taps, 2>,
    level_value: array<vec3f, 2>,
    prefiltered: vec3f,
    visible: f32,
    visible_raw: f32,
    lut: LutSample,
}

// Degree of the visibility field: a constant where unrolled loops over it stay small.
fn sh_degree() -> u32 {
#ifdef ORDER
    return ORDER;
#else
    return sh_degree_of(tables.n_coefficients);
#endif
}

fn is_open() -> bool {
    return shading.visibility_form == VISIBILITY_OFF;
}

// True where the diffuse term uses one number as visibility.
fn is_scalar() -> bool {
    return is_open() || shading.diffuse_form == DIFFUSE_AMBIENT_OCCLUSION;
}

fn squash(x: f32) -> f32 {
    if shading.visibility_form == VISIBILITY_SIGMOID {
        return 1.0 / (1.0 + exp(min(-x, 80.0)));
    }
    return select(clamp(x, 0.0, 1.0), 1.0, is_open());
}

// Derivative of `squash` at `x`, where it returned `y`.
fn squash_derivative(x: f32, y: f32) -> f32 {
    if shading.visibility_form == VISIBILITY_SIGMOID {
        return y * (1.0 - y);
    }
    return select(0.0, 1.0, !is_open() && x > 0.0 && x < 1.0);
}

// Irradiance rgb of one node: dot products of three rows of coefficients with the visibility.
fn node_irradiance(s: ptr<function, Surface>, node: u32) -> vec3f {
    let quads = tables.coefficients / 4u;
    let first = node * 3u * quads;
    if is_scalar() {
        return UNOCCLUDED_SH0 * vec3f(light_quads[first].x, light_quads[first + quads].x, light_quads[first + 2u * quads].x);
    }
    var sum = vec3f(0.0);
    for (var quad = 0u; quad < N_QUADS; quad++) {
        let v = (*s).visibility[quad];
        let at = first + quad;
        sum += vec3f(dot(light_quads[at], v), dot(light_quads[at + quads], v), dot(light_quads[at + 2u * quads], v));
    }
    return sum;
}

fn specular_nodes(level: u32) -> u32 {
    return tables.specular_n[level / 4u][level % 4u];
}

fn specular_start(level: u32) -> u32 {
    return tables.specular_first[level / 4u][level % 4u];
}

fn specular_node(level: u32, node: u32) -> vec3f {
    let at = specular_start(level) + 3u * node;
    return vec3f(light_tables[at], light_tables[at + 1u], light_tables[at + 2u]);
}

fn level_light(level: u32, taps: Taps) -> vec3f {
    var sum = vec3f(0.0);
#repeat k 4
    sum += taps.weight[$k] * specular_node(level, taps.node[$k]);
#end
    return sum;
}

// `sum_l factors[l] <c, Y>_l` along `d`.
fn field_along(s: ptr<function, Surface>, d: vec3f, factors: ptr<function, array<f32, 7>>) -> f32 {
    var y: array<f32, 49>;
    sh_basis(sh_degree(), d, &y);
    var sum = 0.0;
    for (var l = 0u; l <= sh_degree(); l++) {
        var band = 0.0;
        for (var j = l * l; j < (l + 1u) * (l + 1u); j++) {
            band += y[j] * (*s).visibility[j / 4u][j % 4u];
        }
        sum += (*factors)[l] * band;
    }
    return sum;
}

// `<c, NRSH(n)>`, before the squash.
fn ambient_raw(s: ptr<function, Surface>, normal: vec3f) -> f32 {
    var factors = NRSH_FACTORS;
    return field_along(s, normal, &factors);
}

// `AO = squash(<c, NRSH(n)>)` (Eq. 16-18) for a unit normal.
fn ambient_occlusion(s: ptr<function, Surface>, normal: vec3f) -> f32 {
    if is_open() {
        return 1.0;
    }
    return squash(ambient_raw(s, normal));
}

// `h_l` and its derivative, or (1, 0) for the article's V(R).
fn attenuation(cell: LobeCell, l: u32) -> vec2f {
    if shading.visibility_form == VISIBILITY_SIGMOID {
        return vec2f(1.0, 0.0);
    }
    return lobe_value(cell, l);
}

// Visibility over the specular lobe, before the squash.
fn visible_raw(s: ptr<function, Surface>, reflection: vec3f) -> f32 {
    let cell = lobe_cell((*s).rough);
    var factors: array<f32, 7>;
    for (var l = 0u; l <= sh_degree(); l++) {
        factors[l] = attenuation(cell, l).x;
    }
    return field_along(s, reflection, &factors);
}

// Radiance of the surface towards the camera.
fn shade(s: ptr<function, Surface>) -> Shaded {
    var f: Shaded;
    f.normal_length = length3((*s).normal);
    f.normal = (*s).normal / f.normal_length;
    let facing = dot(f.normal, (*s).view);
    f.flipped = facing < 0.0;
    f.normal = select(f.normal, -f.normal, f.flipped);
    let nov_raw = abs(facing);
    f.nov = clamp(nov_raw, MIN_NOV, 1.0);
    f.nov_inside = nov_raw > MIN_NOV && nov_raw < 1.0;
    let bent = 2.0 * f.nov * f.normal - (*s).view;
    f.reflection_length = length3(bent);
    f.reflection = bent / f.reflection_length;
    f.direct = direct(s, f.normal, f.nov);
    f.lambert = lambert(s, f.normal, f.direct.irradiance);
    f.sheen = sheen_of((*s).sheen, f.nov);
    // Specular: split sum, visibility over the lobe.
    f.position = level_position((*s).rough);
#repeat k 2
    f.level_taps[$k] = cube_taps(specular_nodes(f.position.level + $ku), f.reflection);
    f.level_value[$k] = level_light(f.position.level + $ku, f.level_taps[$k]);
#end
    f.prefiltered = f.level_value[0] * (1.0 - f.position.fraction) + f.level_value[1] * f.position.fraction;
    f.visible_raw = 1.0;
    f.visible = 1.0;
    if !is_open() {
        f.visible_raw = visible_raw(s, f.reflection);
        f.visible = squash(f.visible_raw);
    }
    f.lut = lut_sample(f.nov, (*s).rough);
    f.share = diffuse_share(f.lut, shading.conserves_energy == 1u);
    f.diffuse = f.lambert.radiance * (f.sheen.gain * f.share.value);
    let f0 = DIELECTRIC_F0 * (1.0 - (*s).metal) + (*s).albedo * (*s).metal;
    let light = f.visible * f.prefiltered + (1.0 - f.visible) * (*s).blocked;
    f.specular = light * (f0 * f.lut.value.x + f.lut.value.y) + f.direct.specular;
    return f;
}
