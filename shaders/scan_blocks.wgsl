// Exclusive prefix sums inside blocks of 1024 elements, and the total of each block.
// A thread owns four consecutive elements and one prefix; a workgroup owns a block. Workgroup memory holds one partial
// sum per thread (2 KiB). Elements past the input count as zero, so an output one longer than its input ends with the
// total.
#import generated/kernels
#import index
#import workgroup_scan

const WG_SIZE = 256u;
const PER_THREAD = SCAN_BLOCK / WG_SIZE;

struct ScanSize {
    // Number of elements read; the next member is the number written, which is not smaller.
    n_in: u32,
    n_out: u32,
    pad_a: u32,
    pad_b: u32,
}

@group(0) @binding(0) var<uniform> size: ScanSize;
@group(0) @binding(1) var<storage, read> values: array<u32>;
@group(0) @binding(2) var<storage, read_write> prefixes: array<u32>;
@group(0) @binding(3) var<storage, read_write> block_sums: array<u32>;

fn value_at(element_ix: u32) -> u32 {
    if element_ix >= size.n_in {
        return 0u;
    }
    return values[element_ix];
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) wid: vec3u,
    @builtin(num_workgroups) n_wg: vec3u,
    @builtin(local_invocation_index) local_ix: u32,
) {
    let block_ix = workgroup_ix(wid, n_wg);
    let n_blocks = (size.n_out + WG_SIZE * PER_THREAD - 1u) / (WG_SIZE * PER_THREAD);
    // In a folded dispatch, workgroups beyond the last block only take part in the barriers.
    let first_ix = min(block_ix, n_blocks) * WG_SIZE * PER_THREAD + local_ix * PER_THREAD;
    let own = vec4u(value_at(first_ix), value_at(first_ix + 1u), value_at(first_ix + 2u), value_at(first_ix + 3u));
    let scan = scan_workgroup(local_ix, own.x + own.y + own.z + own.w);
    if block_ix >= n_blocks {
        return;
    }
    if local_ix == 0u {
        block_sums[block_ix] = scan.total;
    }
    var before = scan.before;
#repeat k 4
    if first_ix + $ku < size.n_out {
        prefixes[first_ix + $ku] = before;
    }
    before += own[$k];
#end
}
