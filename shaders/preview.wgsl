// The preview tier: shades every visible Gaussian once, from its attribute row to a row of coverage and colour.
// A thread owns one Gaussian. No workgroup memory.
const WG_SIZE = 256u;
#import index
#import shading
#import splat

@group(0) @binding(6) var<uniform> model: Layout;
@group(0) @binding(7) var<storage, read> params: array<f32>;
@group(0) @binding(8) var<storage, read> splats: array<Splat>;
// Full attribute rows by Gaussian.
@group(0) @binding(9) var<storage, read> rows: array<vec4f>;
@group(0) @binding(10) var<storage, read_write> colours: array<vec4f>;

const GROUPS = VISIBILITY_GROUP + N_QUADS;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    if gaussian_ix >= model.n {
        return;
    }
    // Rows of what reaches no tile are undefined, and never blended.
    if splats[gaussian_ix].n_tiles == 0u {
        return;
    }
    let at = model.mean + 3u * gaussian_ix;
    let mean = vec3f(params[at], params[at + 1u], params[at + 2u]);
    let row = gaussian_ix * GROUPS;
    let towards = normalised3(view.eye.xyz - mean);
    var s = surface_of_groups(rows[row + 1u], rows[row + 2u], rows[row + 3u], rows[row + 4u], 1.0, towards);
    for (var quad = 0u; quad < N_QUADS; quad++) {
        s.visibility[quad] = masked_quad(quad, rows[row + VISIBILITY_GROUP + quad]);
    }
    let f = shade(&s);
    colours[gaussian_ix] = vec4f(1.0, f.diffuse + f.specular);
}
