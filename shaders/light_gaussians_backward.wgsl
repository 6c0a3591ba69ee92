// The way back through light_gaussians: in each Gaussian's row of splat gradients, what its diffuse radiance has is added to
// its normal, albedo, metalness and (with VISIBILITY) visibility; what the diffuse table gets goes by
// shared/table_shares.wgsl. A thread owns a Gaussian. Neighbours in memory have normals of their own, so that few share a
// cell: sorting all Gaussians by cell first would save additions to memory; it was not tried.
const WG_SIZE = 256u;
#import index
#import shading_backward
#import gaussian_surface
#import gathered
#import table_shares

@group(0) @binding(6) var<uniform> model: Layout;
@group(0) @binding(7) var<storage, read> params: array<f32>;
@group(0) @binding(8) var<storage, read> splats: array<Splat>;
// Rows of all channels, diffuse radiance in them.
@group(0) @binding(9) var<storage, read> attributes: array<vec4f>;
@group(0) @binding(10) var<storage, read> gathered: array<f32>;
// Rows of HEADER_GROUPS and the differentiated groups.
@group(0) @binding(11) var<storage, read_write> splat_gradients: array<vec4f>;
@group(0) @binding(12) var<storage, read_write> by_tables: array<accumulator>;

const HEADER_GROUPS = 2u;
#ifdef VISIBILITY
const BY_GROUPS = VISIBILITY_GROUP + N_QUADS;
#else
const BY_GROUPS = 4u;
#endif

// The Gaussian that the workgroup begins with.
var<private> first_ix: u32;

fn member_visibility(local_ix: u32, quad: u32) -> vec4f {
    return gaussian_visibility(first_ix + local_ix, quad);
}

// What a Gaussian owes to the diffuse table.
struct Share {
    cell: u32,
    weight: vec4f,
    by: vec3f,
}

fn gaussian_backward(gaussian_ix: u32) -> Share {
    var share = Share(NO_CELL, vec4f(0.0), vec3f(0.0));
    let row = gaussian_ix * (HEADER_GROUPS + BY_GROUPS) + HEADER_GROUPS;
    let g = splat_gradients[row + 3u].yzw;
    if all(g == vec3f(0.0)) {
        return share;
    }
    var s = gaussian_surface(gaussian_ix);
    s.diffuse = vec3f(0.0);
    if has_gathered(gaussian_ix) {
        s.diffuse = gathered_vec3(6u * gaussian_ix);
    }
    let normal = facing_normal(&s);
    var f = lambert(&s, normal);
    var by: SurfaceGradient;
    var by_normal = lambert_backward(&s, &f, g, &by);
    by_normal += visibility_backward(&s, normal, normal, vec2f(by.ambient_raw, 0.0), &by)[0];
    splat_gradients[row + 1u] += vec4f(select(by_normal, -by_normal, any(normal != s.normal)), 0.0);
    splat_gradients[row + 2u] += vec4f(by.albedo, by.metal);
#ifdef VISIBILITY
    for (var quad = 0u; quad < N_QUADS; quad++) {
        splat_gradients[row + VISIBILITY_GROUP + quad] += by.visibility[quad];
    }
#endif
    share.cell = cell_of(DIFFUSE_LEVEL, f.taps, by.irradiance);
    share.weight = f.taps.weight;
    share.by = by.irradiance;
    return share;
}

@compute @workgroup_size(WG_SIZE)
fn main(
    @builtin(global_invocation_id) gid: vec3u,
    @builtin(num_workgroups) n_wg: vec3u,
    @builtin(local_invocation_index) local_ix: u32,
) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    first_ix = gaussian_ix - local_ix;
    var share = Share(NO_CELL, vec4f(0.0), vec3f(0.0));
    if gaussian_ix < model.n {
        if is_drawn(gaussian_ix) {
            share = gaussian_backward(gaussian_ix);
        }
    }
    add_shares(true, local_ix, share.cell, share.weight, vec4f(share.by, 0.0));
}
