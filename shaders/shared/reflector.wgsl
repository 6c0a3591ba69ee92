// Reflection of light from one direction towards the camera: the port of crates/scene/src/light/reflector.rs.
#import generated/light
#import brdf
#import orthonormal
#import quaternion

const PI = 3.14159265;
const MIN_GGX_ALPHA = 1e-4;

struct Reflector {
    // Unit normal on the side of the camera.
    normal: vec3f,
    tangent: vec3f,
    bitangent: vec3f,
    // Unit direction to the camera.
    view: vec3f,
    nov: f32,
    alpha: f32,
    // The diffuse reflectance per steradian; the next member is the reflectance at normal incidence.
    diffuse: vec3f,
    f0: vec3f,
}

// Reflection by the two parts of the surface; 0 for light from below the horizon.
struct Reflected {
    diffuse: vec3f,
    specular: vec3f,
}

// `normal` has any length.
fn reflector_of(normal: vec3f, view: vec3f, albedo: vec3f, metal: f32, rough: f32, conserves_energy: bool) -> Reflector {
    var r: Reflector;
    let length = length3(normal);
    let unit = select(view, normal / length, length > 1e-12);
    r.normal = select(unit, -unit, dot(unit, view) < 0.0);
    let pair = orthonormal_pair(r.normal);
    r.tangent = pair[0];
    r.bitangent = pair[1];
    r.view = view;
    r.nov = clamp(dot(r.normal, view), MIN_NOV, 1.0);
    r.alpha = max(rough * rough, MIN_GGX_ALPHA);
    let share = diffuse_share(lut_sample(r.nov, rough), conserves_energy);
    r.diffuse = albedo * (share.value * (1.0 - metal) / PI);
    r.f0 = DIELECTRIC_F0 * (1.0 - metal) + albedo * metal;
    return r;
}

// GGX for a half vector and squared alpha; (1 - (n . h)^2) is computed as a square, without cancellation.
fn ggx(r: Reflector, half_way: vec3f, a: f32) -> f32 {
    let across = cross(r.normal, half_way);
    let spread = a + (1.0 - a) * dot(across, across);
    return a / (PI * spread * spread);
}

// Reflectance times cosine towards the unit `light`, of angular radius `radius`.
fn reflect_light(r: Reflector, light: vec3f, radius: f32) -> Reflected {
    let nol = dot(r.normal, light);
    if !(nol > 0.0) {
        return Reflected(vec3f(0.0), vec3f(0.0));
    }
    let a = min(r.alpha * r.alpha + 0.25 * radius * radius, 1.0);
    let half_way = normalised3(r.view + light);
    let voh = clamp(dot(r.view, half_way), 0.0, 1.0);
    let root_nol = sqrt(a + (1.0 - a) * nol * nol);
    let root_nov = sqrt(a + (1.0 - a) * r.nov * r.nov);
    let lobe = ggx(r, half_way, a) * 0.5 * nol / (r.nov * root_nol + nol * root_nov);
    let away = 1.0 - voh;
    let fresnel = away * away * away * away * away;
    return Reflected(r.diffuse * nol, lobe * (r.f0 + (1.0 - r.f0) * fresnel));
}

fn from_surface(r: Reflector, v: vec3f) -> vec3f {
    return v.x * r.tangent + v.y * r.bitangent + v.z * r.normal;
}

// A direction drawn by the cosine, from two numbers in [0, 1).
fn sample_cosine(r: Reflector, u: vec2f) -> vec3f {
    let phi = 2.0 * PI * u.y;
    return from_surface(r, vec3f(sqrt(u.x) * vec2f(cos(phi), sin(phi)), sqrt(1.0 - u.x)));
}

fn cosine_density(r: Reflector, light: vec3f) -> f32 {
    return max(dot(r.normal, light), 0.0) / PI;
}

// A direction drawn by the lobe of half vectors; below the horizon where it is invalid.
fn sample_lobe(r: Reflector, u: vec2f) -> vec3f {
    let a = r.alpha * r.alpha;
    let scale = 1.0 / (1.0 + (a - 1.0) * u.x);
    let phi = 2.0 * PI * u.y;
    let half_way = from_surface(r, vec3f(sqrt(a * u.x * scale) * vec2f(cos(phi), sin(phi)), sqrt((1.0 - u.x) * scale)));
    let voh = dot(r.view, half_way);
    return select(-r.normal, 2.0 * voh * half_way - r.view, voh > 0.0);
}

fn lobe_density(r: Reflector, light: vec3f) -> f32 {
    let half_way = normalised3(r.view + light);
    let noh = dot(r.normal, half_way);
    let voh = dot(r.view, half_way);
    if !(noh > 0.0 && voh > 0.0) {
        return 0.0;
    }
    return ggx(r, half_way, r.alpha * r.alpha) * noh / (4.0 * voh);
}
