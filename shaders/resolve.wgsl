// Converts a G-buffer to the requested planes, one after another in one buffer, each pixel by pixel with its own number of
// channels: the port of crates/engine/src/cpu/resolve.rs. A thread owns a pixel. No workgroup memory. Planes are written as
// bits, because WGSL has no literal for infinity, the depth of an empty pixel.
#import shading
#import pixel_surface

// Kept in step with `ResolveUniform` of crates/engine/src/gpu/resolve/mod.rs.
struct Resolve {
    // First float of each plane, or UNWANTED; the last member of the last row is unused.
    first: array<vec4u, 3>,
    // Factor from model to capture units.
    depth_scale: f32,
    // Sources of light, as bits: LIGHT_SHADED, LIGHT_SENT.
    light: u32,
    pad_a: u32,
    pad_b: u32,
}

@group(0) @binding(6) var<uniform> wanted: Resolve;
@group(0) @binding(7) var<storage, read> gbuffer: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> planes: array<u32>;
// Diffuse and specular radiance traced along rays, times coverage; read only with LIGHT_SENT.
@group(0) @binding(9) var<storage, read> sent: array<vec4f>;

const UNWANTED = 0xffffffffu;
// Light from the tables, shaded at Gaussians or here.
const LIGHT_SHADED = 1u;
// Light from `sent`.
const LIGHT_SENT = 2u;
const INFINITY_BITS = 0x7f800000u;
// `Output` of crates/scene/src/output.rs.
const RGB = 0u;
const ALBEDO = 1u;
const NORMAL = 2u;
const METALLIC = 3u;
const ROUGHNESS = 4u;
const VISIBILITY_PLANE = 5u;
const DEPTH = 6u;
const ALPHA = 7u;
const DIFFUSE = 8u;
const SPECULAR = 9u;
const RADIANCE = 10u;

fn first_of(plane: u32) -> u32 {
    return wanted.first[plane / 4u][plane % 4u];
}

fn is_wanted(plane: u32) -> bool {
    return first_of(plane) != UNWANTED;
}

fn put(plane: u32, pixel_ix: u32, value: f32) {
    if is_wanted(plane) {
        planes[first_of(plane) + pixel_ix] = bitcast<u32>(value);
    }
}

fn put_rgb(plane: u32, pixel_ix: u32, value: vec3f) {
    if is_wanted(plane) {
        let at = first_of(plane) + 3u * pixel_ix;
        planes[at] = bitcast<u32>(value.x);
        planes[at + 1u] = bitcast<u32>(value.y);
        planes[at + 2u] = bitcast<u32>(value.z);
    }
}

fn put_nothing(pixel_ix: u32) {
    put_rgb(RGB, pixel_ix, vec3f(0.0));
    put_rgb(ALBEDO, pixel_ix, vec3f(0.0));
    put_rgb(NORMAL, pixel_ix, vec3f(0.0));
    put(METALLIC, pixel_ix, 0.0);
    put(ROUGHNESS, pixel_ix, 0.0);
    put(VISIBILITY_PLANE, pixel_ix, 0.0);
    if is_wanted(DEPTH) {
        planes[first_of(DEPTH) + pixel_ix] = INFINITY_BITS;
    }
    put_rgb(DIFFUSE, pixel_ix, vec3f(0.0));
    put_rgb(SPECULAR, pixel_ix, vec3f(0.0));
    put_rgb(RADIANCE, pixel_ix, vec3f(0.0));
}

// Radiance of a pixel, times coverage.
struct Light {
    diffuse: vec3f,
    specular: vec3f,
}

// Light from the tables. For Gaussians shaded before blending, the G-buffer already has the radiance.
fn shaded_light(s: ptr<function, Surface>, pixel_ix: u32, coverage: f32) -> Light {
    if shading.shade_at == SHADE_AT_PIXEL {
        let f = shade(s);
        return Light(f.diffuse * coverage, f.specular * coverage);
    }
    let specular = channel_specular(gbuffer[DEPTH_GROUP * camera.n_pixels + pixel_ix]);
    return Light(channel_outgoing(gbuffer[ROUGH_GROUP * camera.n_pixels + pixel_ix]) - specular, specular);
}

@compute @workgroup_size(16, 16)
fn main(@builtin(global_invocation_id) gid: vec3u) {
    if gid.x >= camera.size.x || gid.y >= camera.size.y {
        return;
    }
    let pixel_ix = gid.y * camera.size.x + gid.x;
    let first = gbuffer[pixel_ix];
    let coverage = channel_coverage(first);
    put(ALPHA, pixel_ix, coverage);
    if !(coverage >= MIN_COVERAGE) {
        put_nothing(pixel_ix);
        return;
    }
    var s = pixel_surface(gid.xy, pixel_ix, coverage);
    if is_wanted(RGB) || is_wanted(DIFFUSE) || is_wanted(SPECULAR) {
        var light = Light(vec3f(0.0), vec3f(0.0));
        if (wanted.light & LIGHT_SHADED) != 0u {
            light = shaded_light(&s, pixel_ix, coverage);
        }
        if (wanted.light & LIGHT_SENT) != 0u {
            light.diffuse += sent[pixel_ix].xyz;
            light.specular += sent[camera.n_pixels + pixel_ix].xyz;
        }
        put_rgb(RGB, pixel_ix, light.diffuse + light.specular);
        put_rgb(DIFFUSE, pixel_ix, light.diffuse);
        put_rgb(SPECULAR, pixel_ix, light.specular);
    }
    let length = length3(s.normal);
    let unit = s.normal / length;
    let normal = select(unit, -unit, dot(unit, s.view) < 0.0);
    put_rgb(ALBEDO, pixel_ix, s.albedo);
    put_rgb(NORMAL, pixel_ix, select(vec3f(0.0), normal, length > MIN_COVERAGE));
    put(METALLIC, pixel_ix, s.metal);
    put(ROUGHNESS, pixel_ix, s.rough);
    if is_wanted(VISIBILITY_PLANE) {
        put(VISIBILITY_PLANE, pixel_ix, clamp(ambient_occlusion(&s, normal), 0.0, 1.0));
    }
    put(DEPTH, pixel_ix, channel_depth(gbuffer[DEPTH_GROUP * camera.n_pixels + pixel_ix]) / coverage * wanted.depth_scale);
    let shown = clamp(channel_radiance(first) / coverage, vec3f(0.0), vec3f(1.0));
    let linear = vec3f(linear_from_srgb(shown.x), linear_from_srgb(shown.y), linear_from_srgb(shown.z));
    put_rgb(RADIANCE, pixel_ix, linear * coverage);
}
