// Converts the blended values to the canvas: display-referred, premultiplied (docs/MODEL.md, section 4). One triangle covers
// the picture.
#import camera
#import display
#import generated/parameters
#import quaternion

struct Present {
    // Display-referred colour behind the model; opaque where w is 1.
    background: vec4f,
    // Exposure factor of colours.
    gain: f32,
    // The displayed layer: RADIANCE and so on.
    what: u32,
    // Width and height of the map of the light behind the model; 0: none.
    map_size: vec2u,
    // Depths that appear black and white.
    depths: vec2f,
    // Code of the visibility form.
    visibility_form: u32,
    pad: u32,
}

const RADIANCE = 0u;
const ALBEDO = 1u;
const NORMAL = 2u;
const DEPTH = 4u;
const OCCLUSION = 5u;

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> present: Present;
// Blended values, and the remaining transmittance.
@group(0) @binding(2) var blended: texture_2d<f32>;
// Radiance rgb, row by row, +z first.
@group(0) @binding(3) var<storage, read> map: array<f32>;

fn texel(x: i32, y: i32) -> vec3f {
    let size = vec2i(present.map_size);
    let at = 3 * (clamp(y, 0, size.y - 1) * size.x + (x + size.x) % size.x);
    return vec3f(map[at], map[at + 1], map[at + 2]);
}

// The light along a unit direction: `EnvMap::sample` of crates/scene/src/environment.rs.
fn light_behind(d: vec3f) -> vec3f {
    let size = vec2f(present.map_size);
    let u = fract(0.5 - atan2(d.y, d.x) / 6.283185307);
    let v = acos(clamp(d.z, -1.0, 1.0)) / 3.141592654;
    let place = vec2f(u * size.x - 0.5, clamp(v * size.y - 0.5, 0.0, size.y - 1.0));
    let first = vec2i(floor(place));
    let fraction = place - floor(place);
    let above = mix(texel(first.x, first.y), texel(first.x + 1, first.y), fraction.x);
    let below = mix(texel(first.x, first.y + 1), texel(first.x + 1, first.y + 1), fraction.x);
    return mix(above, below, fraction.y);
}

// Composites over the background, premultiplied.
fn over_background(shown: vec3f, coverage: f32) -> vec4f {
    let behind = present.background * (1.0 - coverage);
    return vec4f(shown * coverage + behind.rgb * present.background.a, coverage + behind.a);
}

// `squash` of docs/MODEL.md, section 4; 1 without occlusion.
fn squash(openness: vec3f) -> vec3f {
    switch present.visibility_form {
        case VISIBILITY_OFF: { return vec3f(1.0); }
        case VISIBILITY_SIGMOID: { return 1.0 / (1.0 + exp(min(-openness, vec3f(80.0)))); }
        default: { return clamp(openness, vec3f(0.0), vec3f(1.0)); }
    }
}

@vertex
fn corner(@builtin(vertex_index) corner_ix: u32) -> @builtin(position) vec4f {
    return vec4f(f32(corner_ix & 1u) * 4.0 - 1.0, f32(corner_ix >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(position.xy);
    let sum = textureLoad(blended, pixel, 0);
    let coverage = 1.0 - sum.a;
    let ray = normalised3(pixel_ray(camera, pixel.x, pixel.y));
    let is_there = coverage >= MIN_COVERAGE;
    let value = select(vec3f(0.0), sum.rgb / max(coverage, MIN_COVERAGE), is_there);
    switch present.what {
        case RADIANCE: {
            if present.map_size.x > 0u {
                let all = sum.rgb + (1.0 - coverage) * light_behind(ray);
                return vec4f(display(all * present.gain, true, 1.0), 1.0);
            }
            return over_background(display(value * present.gain, true, 1.0), coverage);
        }
        case ALBEDO: { return over_background(display(value, true, 1.0), coverage); }
        case NORMAL: {
            let facing = select(value, -value, dot(value, ray) > 0.0);
            return vec4f(select(vec3f(0.0), normalised3(facing), is_there) * 0.5 + 0.5, 1.0);
        }
        case DEPTH: {
            let share = clamp((value - present.depths.x) / (present.depths.y - present.depths.x), vec3f(0.0), vec3f(1.0));
            return vec4f(select(vec3f(1.0), share, is_there), 1.0);
        }
        case OCCLUSION: { return vec4f(select(vec3f(0.0), squash(value), is_there), 1.0); }
        default: { return vec4f(clamp(value, vec3f(0.0), vec3f(1.0)), 1.0); }
    }
}
