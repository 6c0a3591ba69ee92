// Number of keys with each digit in each block of 2048 keys, as `counts[digit * n_blocks + block]`. An exclusive prefix sum
// over `counts` is the position of each block's share of each digit. A workgroup owns a block, a thread eight keys (strided, so
// that reads are coalesced). Workgroup memory holds the 256 counters, which are incremented atomically.
#import index
#import radix

@group(0) @binding(0) var<uniform> sort: SortPass;
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read> limit: array<u32>;
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;

var<workgroup> sh_count: array<atomic<u32>, 256>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) wid: vec3u,
    @builtin(num_workgroups) n_wg: vec3u,
    @builtin(local_invocation_index) local_ix: u32,
) {
    let n = min(sort.n, limit[0]);
    let block_ix = min(workgroup_ix(wid, n_wg), sort.n_blocks);
    atomicStore(&sh_count[local_ix], 0u);
    workgroupBarrier();
    for (var k = 0u; k < PER_THREAD; k++) {
        let element_ix = block_ix * SORT_BLOCK + k * WG_SIZE + local_ix;
        if element_ix < n {
            atomicAdd(&sh_count[digit_of(keys[element_ix], sort)], 1u);
        }
    }
    workgroupBarrier();
    if block_ix < sort.n_blocks && local_ix < sort.n_digits {
        counts[local_ix * sort.n_blocks + block_ix] = atomicLoad(&sh_count[local_ix]);
    }
}
