// Backward pass of light_gaussians. In each Gaussian's row of splat gradients, the gradient by its light is propagated to its
// position, its normal, its material and, with ALL_CHANNELS, its indirect light and visibility. shared/table_shares.wgsl adds
// the gradient of the light tables; the gradient of the dominant lights is summed per workgroup. A thread owns a Gaussian.
const WG_SIZE = 256u;
#import index
#import shading_backward
#import gaussian_surface
#import table_shares
#import reduce

@group(0) @binding(6) var<uniform> model: Layout;
@group(0) @binding(7) var<storage, read> params: array<f32>;
@group(0) @binding(8) var<storage, read> splats: array<Splat>;
@group(0) @binding(9) var<storage, read> gathered: array<f32>;
@group(0) @binding(10) var<storage, read> indirect_basis: array<f32>;
@group(0) @binding(11) var<storage, read> attributes: array<vec4f>;
// Rows of HEADER_GROUPS and the differentiated groups; all groups of the attributes are differentiated.
@group(0) @binding(12) var<storage, read_write> splat_gradients: array<vec4f>;
@group(0) @binding(13) var<storage, read_write> by_tables: array<accumulator>;

// The first Gaussian of the workgroup.
var<private> first_ix: u32;

fn member_visibility(local_ix: u32, quad: u32) -> vec4f {
    return masked_quad(quad, visibility_quad(first_ix + local_ix, quad));
}

fn gaussian_backward(gaussian_ix: u32) -> Shares {
    let row = gaussian_ix * (HEADER_GROUPS + ROW_GROUPS) + HEADER_GROUPS;
    let g = channel_outgoing(splat_gradients[row + ROUGH_GROUP]);
    if all(g == vec3f(0.0)) {
        return no_shares();
    }
    var s = gaussian_surface(gaussian_ix);
    var f = shade(&s);
    var by = shade_backward(&s, &f, g);
    splat_gradients[row + NORMAL_GROUP] += vec4f(by.normal, 0.0);
    splat_gradients[row + ALBEDO_GROUP] += vec4f(by.albedo, by.metal);
    // The gradient by the outgoing radiance is consumed; its first channel now carries the gradient by sheen.
    let by_rough = channel_rough(splat_gradients[row + ROUGH_GROUP]) + by.rough;
    splat_gradients[row + ROUGH_GROUP] = vec4f(by_rough, by.sheen, g.yz);
#ifdef ALL_CHANNELS
    splat_gradients[row + DEPTH_GROUP] += vec4f(0.0, by.blocked);
    for (var quad = 0u; quad < N_QUADS; quad++) {
        splat_gradients[row + VISIBILITY_GROUP + quad] += by.visibility[quad];
    }
#endif
    // The view direction is that of the ray through the splat's projected mean; it depends on nothing else.
    let across = dot(s.view, by.view) * s.view - by.view;
    let turned = vec2f(dot(across, camera.rotation[0].xyz), dot(across, camera.rotation[1].xyz));
    let by_place = turned * splats[gaussian_ix].depth / (length3(to_gaussian(gaussian_ix)) * camera.focal);
    splat_gradients[row - HEADER_GROUPS] += vec4f(by_place, 0.0, 0.0);
    return shares_of(&f, &by, 1.0);
}

@compute @workgroup_size(WG_SIZE)
fn main(
    @builtin(global_invocation_id) gid: vec3u,
    @builtin(num_workgroups) n_wg: vec3u,
    @builtin(local_invocation_index) local_ix: u32,
) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    first_ix = gaussian_ix - local_ix;
    var shares = no_shares();
    if gaussian_ix < model.n {
        if is_drawn(gaussian_ix) {
            shares = gaussian_backward(gaussian_ix);
        }
    }
    add_all_shares(local_ix, &shares);
    // All Gaussians add to the same few floats, so a workgroup adds once.
    for (var k = 0u; k < tables.n_lights; k++) {
        let total = workgroup_sum(local_ix, vec4f(shares.lights[k], 0.0));
        if local_ix < 3u {
            accumulate!(by_tables[tables.first_light + 3u * k + local_ix], total[local_ix]);
        }
    }
}
