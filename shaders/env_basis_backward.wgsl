// Adds the gradient of the light through the indirect basis to that of the roughest level of the tables.
// A thread owns one float of that level. No workgroup memory.
const WG_SIZE = 256u;
#import index
#import tables

@group(0) @binding(0) var<uniform> tables: Tables;
@group(0) @binding(1) var<storage, read> basis_gradient: array<f32>;
@group(0) @binding(2) var<storage, read> reading: array<f32>;
@group(0) @binding(3) var<storage, read_write> tables_gradient: array<f32>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let float_ix = invocation_ix(gid, n_wg);
    let edge = tables.specular_n[1].y;
    let n_nodes = 6u * edge * edge;
    if float_ix >= 3u * n_nodes {
        return;
    }
    var sum = 0.0;
    for (var j = 0u; j < 16u; j++) {
        sum += reading[j * n_nodes + float_ix / 3u] * basis_gradient[3u * j + float_ix % 3u];
    }
    tables_gradient[tables.specular_first[1].y + float_ix] += sum;
}
