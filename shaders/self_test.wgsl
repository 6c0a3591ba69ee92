// Adds 1 to one sum per invocation and writes its index. Tests that dispatches, their folding and float accumulation work on a
// device before it is used. A thread owns one element of `seen`. No workgroup memory.
const WG_SIZE = 256u;
#import index

@group(0) @binding(0) var<storage, read_write> seen: array<u32>;
@group(0) @binding(1) var<storage, read_write> sums: array<accumulator>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let element_ix = invocation_ix(gid, n_wg);
    if element_ix >= arrayLength(&seen) {
        return;
    }
    seen[element_ix] = element_ix;
    accumulate!(sums[element_ix % 2u], 1.0);
}
