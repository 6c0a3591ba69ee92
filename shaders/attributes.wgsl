// Attribute rows of visible splats, the input of blending (docs/MODEL.md, section 3): the port of cpu/attributes.rs.
// GROUPS vec4 per row: 1 = colour, 2 = geometry, 4 = material, more = all channels.
// A thread owns one Gaussian. No workgroup memory. Threads follow the order of the Gaussians, not of depth: parameters of
// neighbours are contiguous, while in depth order every read would touch another cache line.
#import attributes
#import generated/channels
#import incoming
#import index
#import sh
#import splat
#import camera

const WG_SIZE = 256u;

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> model: Layout;
@group(0) @binding(2) var<storage, read> params: array<f32>;
@group(0) @binding(3) var<storage, read> globals: array<f32>;
@group(0) @binding(4) var<storage, read> splats: array<Splat>;
// See shared/incoming.wgsl.
@group(0) @binding(5) var<storage, read> gathered: array<f32>;
// E_j of Eq. 20: 16 x 3.
@group(0) @binding(6) var<storage, read> indirect_basis: array<f32>;
@group(0) @binding(7) var<storage, read_write> rows: array<vec4f>;

fn radiance_of(gaussian_ix: u32, to_mean: vec3f) -> vec3f {
    var basis: array<f32, 49>;
    sh_basis(sh_degree_of(model.n_radiance), normalised3(to_mean), &basis);
    var colour = vec3f(0.5);
    let first = model.radiance + 3u * model.n_radiance * gaussian_ix;
    for (var j = 0u; j < model.n_radiance; j++) {
        colour += basis[j] * params_vec3(first + 3u * j);
    }
    return max(colour, vec3f(0.0));
}

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    if gaussian_ix >= model.n {
        return;
    }
    if splats[gaussian_ix].n_tiles == 0u {
        return;
    }
    let to_mean = params_vec3(model.mean + 3u * gaussian_ix) - camera.centre.xyz;
    let row = gaussian_ix * GROUPS;
    rows[row + COVERAGE_GROUP] = vec4f(1.0, radiance_of(gaussian_ix, to_mean));
#ifndef COLOUR
    let normal = normal_of(gaussian_ix, to_mean);
    rows[row + NORMAL_GROUP] = vec4f(normal.unit, dot(normal.unit, to_mean));
#ifndef GEOMETRY
    let albedo = clamp(albedo_of(gaussian_ix), vec3f(0.0), vec3f(1.0));
    rows[row + ALBEDO_GROUP] = vec4f(albedo, sigmoid(params[model.metal + gaussian_ix]));
    let rough = sigmoid(params[model.rough + gaussian_ix]);
#ifdef MATERIAL
    rows[row + ROUGH_GROUP] = vec4f(rough, 0.0, 0.0, 0.0);
#else
    let incident = incident_light(gaussian_ix);
    rows[row + ROUGH_GROUP] = vec4f(rough, incident.gathered);
    rows[row + DEPTH_GROUP] = vec4f(splats[gaussian_ix].depth, incident.blocked);
    for (var group = VISIBILITY_GROUP; group < GROUPS; group++) {
        rows[row + group] = visibility_quad(gaussian_ix, group - VISIBILITY_GROUP);
    }
#endif
#endif
#endif
}
