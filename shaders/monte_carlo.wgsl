// Samples of the Monte-Carlo estimate of the light that each pixel's surface reflects from an environment: the port of
// `estimate` of crates/scene/src/light/sampler.rs. Directions are drawn by the light, by the cosine and by the lobe, and
// weighted by the combined density of all three. A thread owns a pixel. No workgroup memory. The samples are split over
// several dispatches, so that each is short.
#import camera
#import finite
#import pixel_reflector
#import random
#import ray_tree

// Kept in step with `MonteCarloUniform` of crates/engine/src/gpu/rays/monte_carlo.rs.
struct MonteCarlo {
    // Low and high word.
    seed: vec2u,
    // Number of pixels of the frame before the first one of this view.
    pixels_before: u32,
    // First sample of this dispatch; the next member is the end.
    first_sample: u32,
    end_sample: u32,
    // Numbers of samples drawn by the light and by the cosine; the lobe draws the rest.
    n_light: u32,
    n_cosine: u32,
    n_lobe: u32,
    // Size of the environment.
    width: u32,
    height: u32,
    // 1: the diffuse term has the share of the light that the highlight leaves.
    conserves_energy: u32,
    pad: u32,
}

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> sampling: MonteCarlo;
@group(0) @binding(2) var<uniform> rules: RayRules;
@group(0) @binding(3) var<storage, read> gbuffer: array<vec4f>;
@group(0) @binding(4) var<storage, read> depths: array<f32>;
@group(0) @binding(5) var<storage, read> nodes: array<vec4u>;
@group(0) @binding(6) var<storage, read> members: array<vec4f>;
// Radiance RGB, and the density of drawing a direction in the texel by the light.
@group(0) @binding(7) var<storage, read> texels: array<vec4f>;
// Cumulative shares of the light over rows, then over the columns of each row.
@group(0) @binding(8) var<storage, read> sums: array<f32>;
@group(0) @binding(9) var<storage, read> constants: array<f32>;
// Diffuse and specular part, times coverage.
@group(0) @binding(10) var<storage, read_write> sent: array<vec4f>;

// Clamp of a sample, so that radiance stays finite in f32 under extreme lights.
const MAX_RADIANCE = 1e36;

struct Picked {
    ix: u32,
    // Position within the cell, 0 to 1.
    inside: f32,
}

// The cell of the cumulative sum from `first` on that contains `u`.
fn pick(first: u32, n: u32, u: f32) -> Picked {
    var lo = 0u;
    var hi = n;
    while lo < hi {
        let middle = (lo + hi) / 2u;
        if sums[first + middle] <= u {
            lo = middle + 1u;
        } else {
            hi = middle;
        }
    }
    let ix = min(lo, n - 1u);
    var before = 0.0;
    if ix > 0u {
        before = sums[first + ix - 1u];
    }
    return Picked(ix, clamp((u - before) / max(sums[first + ix] - before, 1e-30), 0.0, 1.0));
}

struct Drawn {
    direction: vec3f,
    texel_ix: u32,
}

fn sample_light(u: vec2f) -> Drawn {
    let row = pick(0u, sampling.height, u.x);
    let column = pick(sampling.height + row.ix * sampling.width, sampling.width, u.y);
    let edges = cos(PI * vec2f(f32(row.ix), f32(row.ix + 1u)) / f32(sampling.height));
    let z = mix(edges.x, edges.y, row.inside);
    let phi = (0.5 - (f32(column.ix) + column.inside) / f32(sampling.width)) * 2.0 * PI;
    let sine = sqrt(max(1.0 - z * z, 0.0));
    return Drawn(vec3f(sine * vec2f(cos(phi), sin(phi)), z), row.ix * sampling.width + column.ix);
}

fn texel_towards(d: vec3f) -> u32 {
    let uv = vec2f(0.5 - atan2(d.y, d.x) / (2.0 * PI), atan2(length(d.xy), d.z) / PI);
    let cell = min(vec2u(max(uv, vec2f(0.0)) * vec2f(f32(sampling.width), f32(sampling.height))), vec2u(sampling.width, sampling.height) - 1u);
    return cell.y * sampling.width + cell.x;
}

fn draw(r: Reflector, sample_ix: u32, u: vec2f) -> Drawn {
    if sample_ix < sampling.n_light {
        return sample_light(u);
    }
    var d = vec3f(0.0);
    if sample_ix < sampling.n_light + sampling.n_cosine {
        d = sample_cosine(r, u);
    } else {
        d = sample_lobe(r, u);
    }
    d = normalised3(d);
    return Drawn(d, texel_towards(d));
}

fn held(v: vec3f) -> vec3f {
    return min(select(v, vec3f(0.0), vec3<bool>(is_nan(v.x), is_nan(v.y), is_nan(v.z))), vec3f(MAX_RADIANCE));
}

// One sample: the environment through the Gaussians, `blocked` in the hidden share.
fn sample_of(r: Reflector, blocked: vec3f, point: vec3f, pixel: u32, sample_ix: u32) -> Reflected {
    let drawn = draw(r, sample_ix, uniform2(vec4u(pixel, sample_ix, sampling.seed)));
    let reflected = reflect_light(r, drawn.direction, 0.0);
    let texel = texels[drawn.texel_ix];
    let density = f32(sampling.n_light) * texel.w
        + f32(sampling.n_cosine) * cosine_density(r, drawn.direction)
        + f32(sampling.n_lobe) * lobe_density(r, drawn.direction);
    if !(density > 0.0) || !(dot(r.normal, drawn.direction) > 0.0) {
        return Reflected(vec3f(0.0), vec3f(0.0));
    }
    let open = ray_transmittance(point, drawn.direction, rules);
    let seen = open * texel.xyz;
    return Reflected(
        held(seen / density * reflected.diffuse),
        held((seen + (1.0 - open) * blocked) / density * reflected.specular),
    );
}

@compute @workgroup_size(16, 16)
fn main(@builtin(global_invocation_id) gid: vec3u) {
    if gid.x >= camera.size.x || gid.y >= camera.size.y {
        return;
    }
    let n = camera.n_pixels;
    let pixel_ix = gid.y * camera.size.x + gid.x;
    let coverage = channel_coverage(gbuffer[pixel_ix]);
    if !(coverage >= MIN_COVERAGE) {
        return;
    }
    let inverse = 1.0 / coverage;
    let ray = pixel_ray(camera, gid.x, gid.y);
    let r = pixel_reflector(pixel_ix, coverage, ray, sampling.conserves_energy == 1u);
    let blocked = channel_blocked(gbuffer[DEPTH_GROUP * n + pixel_ix]) * inverse;
    let point = camera.centre.xyz + depths[pixel_ix] * ray;
    var diffuse = sent[pixel_ix].xyz;
    var specular = sent[n + pixel_ix].xyz;
    if sampling.first_sample == 0u {
        diffuse = r.diffuse * channel_gathered(gbuffer[ROUGH_GROUP * n + pixel_ix]);
        specular = vec3f(0.0);
    }
    for (var sample_ix = sampling.first_sample; sample_ix < sampling.end_sample; sample_ix++) {
        let sample = sample_of(r, blocked, point, sampling.pixels_before + pixel_ix, sample_ix);
        diffuse += coverage * sample.diffuse;
        specular += coverage * sample.specular;
    }
    sent[pixel_ix] = vec4f(held(diffuse), 0.0);
    sent[n + pixel_ix] = vec4f(held(specular), 0.0);
}
