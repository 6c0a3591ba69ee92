// G-buffer to the planes that a frame was asked for (src/render/frame.rs): linear, scene-referred, one plane after the
// other. A thread owns a pixel; workgroups are squares of 16 x 16, whose pixels look up neighbouring table nodes. No
// workgroup memory.
#import shading
#import pixel_surface

// Kept in step with `DevelopUniform` of src/engine/gpu/develop.rs.
struct Develop {
    // Bit k: output k of `render::Output` is wanted.
    wanted: u32,
    // Capture units a unit of the normalised world.
    depth_scale: f32,
    // Depth where nothing is; WGSL has no word for it.
    infinity: f32,
    pad: u32,
}

@group(0) @binding(6) var<uniform> develop: Develop;
@group(0) @binding(7) var<storage, read> gbuffer: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> planes: array<f32>;

// Floats before the plane that is written next.
var<private> next_plane: u32;

fn is_wanted(output: u32) -> bool {
    return (develop.wanted & (1u << output)) != 0u;
}

fn put_scalar(output: u32, pixel_ix: u32, value: f32) {
    if is_wanted(output) {
        planes[next_plane + pixel_ix] = value;
        next_plane += view.n_pixels;
    }
}

fn put_colour(output: u32, pixel_ix: u32, value: vec3f) {
    if is_wanted(output) {
        let first = next_plane + 3u * pixel_ix;
        planes[first] = value.x;
        planes[first + 1u] = value.y;
        planes[first + 2u] = value.z;
        next_plane += 3u * view.n_pixels;
    }
}

const RGB = 0u;
const ALBEDO = 1u;
const NORMAL = 2u;
const METALLIC = 3u;
const ROUGHNESS = 4u;
const VISIBILITY = 5u;
const DEPTH = 6u;
const ALPHA = 7u;
const DIFFUSE = 8u;
const SPECULAR = 9u;
const RADIANCE = 10u;
const LIT = (1u << RGB) | (1u << DIFFUSE) | (1u << SPECULAR);

@compute @workgroup_size(16, 16)
fn main(@builtin(global_invocation_id) gid: vec3u) {
    if gid.x >= view.size.x || gid.y >= view.size.y {
        return;
    }
    let pixel_ix = gid.y * view.size.x + gid.x;
    let first = gbuffer[pixel_ix];
    let coverage = first.x;
    var s: Surface;
    var diffuse = vec3f(0.0);
    var specular = vec3f(0.0);
    var normal = vec3f(0.0);
    var ambient = 0.0;
    var radiance = vec3f(0.0);
    var depth = develop.infinity;
    if coverage >= LEAST_COVERAGE {
        s = pixel_surface(gid.xy, pixel_ix, coverage);
        if (develop.wanted & LIT) != 0u {
            let f = shade(&s);
            diffuse = f.diffuse * coverage;
            specular = f.specular * coverage;
        }
        let length = length3(s.normal);
        let unit = s.normal / length;
        let facing = select(unit, -unit, dot(unit, s.view) < 0.0);
        normal = select(vec3f(0.0), facing, length > LEAST_COVERAGE);
        if is_wanted(VISIBILITY) {
            ambient = clamp(ambient_occlusion(&s, facing), 0.0, 1.0);
        }
        depth = gbuffer[3u * view.n_pixels + pixel_ix].y / coverage * develop.depth_scale;
        let shown = clamp(first.yzw / coverage, vec3f(0.0), vec3f(1.0));
        radiance = vec3f(linear_from_srgb(shown.x), linear_from_srgb(shown.y), linear_from_srgb(shown.z)) * coverage;
    }
    next_plane = 0u;
    put_colour(RGB, pixel_ix, diffuse + specular);
    put_colour(ALBEDO, pixel_ix, s.albedo);
    put_colour(NORMAL, pixel_ix, normal);
    put_scalar(METALLIC, pixel_ix, s.metal);
    put_scalar(ROUGHNESS, pixel_ix, s.rough);
    put_scalar(VISIBILITY, pixel_ix, ambient);
    put_scalar(DEPTH, pixel_ix, depth);
    put_scalar(ALPHA, pixel_ix, coverage);
    put_colour(DIFFUSE, pixel_ix, diffuse);
    put_colour(SPECULAR, pixel_ix, specular);
    put_colour(RADIANCE, pixel_ix, radiance);
}
