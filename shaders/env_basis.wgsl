// Basis of the learned indirect light, `E_j = sum over nodes of B_j(node) L_low(node)` (article Eq. 20); the host computes B.
// A thread owns one of the 16 x 3 values. No workgroup memory.
const WG_SIZE = 64u;
#import tables

@group(0) @binding(0) var<uniform> tables: Tables;
@group(0) @binding(1) var<storage, read> values: array<f32>;
// `[16][nodes of the roughest level]`.
@group(0) @binding(2) var<storage, read> reading: array<f32>;
@group(0) @binding(3) var<storage, read_write> basis: array<f32>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u) {
    if gid.x >= 48u {
        return;
    }
    let edge = tables.specular_n[1].y;
    let n_nodes = 6u * edge * edge;
    let first = tables.specular_first[1].y;
    var sum = 0.0;
    for (var node_ix = 0u; node_ix < n_nodes; node_ix++) {
        sum += reading[gid.x / 3u * n_nodes + node_ix] * values[first + 3u * node_ix + gid.x % 3u];
    }
    basis[gid.x] = sum;
}
