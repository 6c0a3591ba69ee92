// Adds to each prefix the sum of all blocks before its own. A thread owns one element. No workgroup memory.
#import generated/kernels
#import index

const WG_SIZE = 256u;

struct ScanSize {
    n_in: u32,
    n_out: u32,
    pad_a: u32,
    pad_b: u32,
}

@group(0) @binding(0) var<uniform> size: ScanSize;
@group(0) @binding(1) var<storage, read> before_block: array<u32>;
@group(0) @binding(2) var<storage, read_write> prefixes: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let element_ix = invocation_ix(gid, n_wg);
    if element_ix >= size.n_out {
        return;
    }
    prefixes[element_ix] += before_block[element_ix / SCAN_BLOCK];
}
