// Draws splats front to back (docs/MODEL.md, sections 2 and 3), one instance per splat. Red, green and blue receive the blended
// value, alpha the remaining transmittance, which starts at 1. The target's alpha weights the fragment's colour. With
// OCCLUSION the blended value is each Gaussian's openness along the pixel's normal from an earlier pass.
#import alpha
#import camera
#import generated/channels
#ifdef OCCLUSION
#import generated/parameters
#import quaternion
#import sh
#endif

struct Drawing {
    // The blended value: the colour or one of the attributes.
    what: u32,
}

// 0 is the colour.
const ALBEDO = 1u;
const NORMAL = 2u;
const ROUGHNESS = 3u;
const METALNESS = 4u;
const DEPTH = 5u;

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> drawing: Drawing;
@group(0) @binding(2) var<storage, read> splats: array<Splat>;
// Coverage and colour.
@group(0) @binding(3) var<storage, read> colours: array<vec4f>;
// Attribute rows up to material.
@group(0) @binding(4) var<storage, read> attributes: array<vec4f>;
@group(0) @binding(5) var<storage, read> gaussian_of_rank: array<u32>;
#ifdef OCCLUSION
@group(0) @binding(6) var<uniform> model: Layout;
@group(0) @binding(7) var<storage, read> params: array<f32>;
// Blended normals.
@group(0) @binding(8) var normals: texture_2d<f32>;
#endif

// Slightly below the largest half float, so that the target cannot become infinite.
const MAX_RADIANCE = 60000.0;

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) @interpolate(flat) place: vec4f,
    @location(1) @interpolate(flat) axes: vec4f,
    @location(2) @interpolate(flat) colour: vec3f,
    @location(3) @interpolate(flat) gaussian_ix: u32,
}

fn blended(gaussian_ix: u32, depth: f32) -> vec3f {
    let row = gaussian_ix * GROUPS_MATERIAL;
    switch drawing.what {
        case ALBEDO: { return channel_albedo(attributes[row + ALBEDO_GROUP]); }
        case NORMAL: { return channel_normal(attributes[row + NORMAL_GROUP]); }
        case ROUGHNESS: { return vec3f(channel_rough(attributes[row + ROUGH_GROUP])); }
        case METALNESS: { return vec3f(channel_metal(attributes[row + ALBEDO_GROUP])); }
        case DEPTH: { return vec3f(depth); }
        default: { return min(colours[gaussian_ix].yzw, vec3f(MAX_RADIANCE)); }
    }
}

@vertex
fn corner(@builtin(vertex_index) corner_ix: u32, @builtin(instance_index) rank_ix: u32) -> Corner {
    let gaussian_ix = gaussian_of_rank[rank_ix];
    let s = splats[gaussian_ix];
    var out: Corner;
    if s.flags != SPLAT_VISIBLE || s.n_tiles == 0u {
        // Outside of the clip volume.
        out.position = vec4f(2.0, 2.0, 0.0, 1.0);
        return out;
    }
    let f = footprint_of(s);
    // The square around the circle of alpha = ALPHA_MIN, in the coordinates in which splats are round.
    let side = vec2f(f32(corner_ix & 1u), f32(corner_ix >> 1u)) * 2.0 - 1.0;
    let round = side * (sqrt(max(s.reach, 0.0)) * sqrt(2.0) * TO_LOG2);
    let dy = round.y / f.axes.z;
    let dx = (round.x - f.axes.y * dy) / f.axes.x;
    let place = (s.mean + vec2f(dx, dy)) / vec2f(camera.size) * 2.0 - 1.0;
    out.position = vec4f(place.x, -place.y, 0.0, 1.0);
    out.place = f.place;
    out.axes = f.axes;
    out.colour = blended(gaussian_ix, s.depth);
    out.gaussian_ix = gaussian_ix;
    return out;
}

#ifdef OCCLUSION
// `<c, NRSH(n)>` of a Gaussian, for the normal of a pixel turned to the camera (docs/MODEL.md section 4).
fn openness(gaussian_ix: u32, pixel: vec2u) -> f32 {
    let normal = normalised3(textureLoad(normals, pixel, 0).rgb);
    let away = pixel_ray(camera, pixel.x, pixel.y);
    let sh_degree = sh_degree_of(model.n_visibility);
    var y: array<f32, 49>;
    sh_basis(sh_degree, select(normal, -normal, dot(normal, away) > 0.0), &y);
    var factors = NRSH_FACTORS;
    var sum = 0.0;
    for (var l = 0u; l <= sh_degree; l++) {
        for (var j = l * l; j < (l + 1u) * (l + 1u); j++) {
            sum += factors[l] * y[j] * params[model.visibility + model.n_visibility * gaussian_ix + j];
        }
    }
    return sum;
}
#endif

@fragment
fn fragment(corner: Corner) -> @location(0) vec4f {
    let alpha = capped(alpha_at(Footprint(corner.place, corner.axes), corner.position.xy));
    if !(alpha > 0.0) {
        discard;
    }
#ifdef OCCLUSION
    let colour = vec3f(openness(corner.gaussian_ix, vec2u(corner.position.xy)));
#else
    let colour = corner.colour;
#endif
    return vec4f(colour * alpha, alpha);
}
