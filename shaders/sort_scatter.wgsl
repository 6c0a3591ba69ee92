// Moves the pairs of a block of 2048 to their sorted positions by one digit of up to 8 bits, keeping the order of equal
// digits.
//
// A workgroup owns a block. It sorts the block in workgroup memory by the digit, four bits at a time, and then writes it in
// sorted order, so that neighbouring threads write neighbouring addresses wherever a digit occurs more than once.
// A four-bit step needs each pair's rank: a thread counts the digits of its eight consecutive pairs in its own column of
// `sh_rank`, two 16-bit counters per word (digits d and d + 8), digit-major. A prefix sum over all 2048 words in that order
// is the position of the first pair of each (digit, thread), lower halves first. This needs one scan over the threads for all
// sixteen digits. Workgroup memory: pairs 16 KiB, ranks 8 KiB, scan 2 KiB, digit starts 1 KiB.
#import index
#import workgroup_scan
#import radix

@group(0) @binding(0) var<uniform> sort: SortPass;
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read> values: array<u32>;
// First position of each (digit, block), in the order of `sort_count`.
@group(0) @binding(3) var<storage, read> places: array<u32>;
@group(0) @binding(4) var<storage, read> limit: array<u32>;
@group(0) @binding(5) var<storage, read_write> sorted_keys: array<u32>;
@group(0) @binding(6) var<storage, read_write> sorted_values: array<u32>;

var<workgroup> sh_key: array<u32, SORT_BLOCK>;
var<workgroup> sh_value: array<u32, SORT_BLOCK>;
var<workgroup> sh_rank: array<u32, SORT_BLOCK>;
var<workgroup> sh_start: array<u32, 256>;

// One stable four-bit step; `step_shift` counts from the digit's lowest bit.
fn sort_step(local_ix: u32, step_shift: u32) {
#repeat k 8
    sh_rank[$ku * WG_SIZE + local_ix] = 0u;
#end
    // Each thread uses its own column only, so no barrier is needed.
#repeat k 8
    let key_$k = sh_key[local_ix * PER_THREAD + $ku];
    let value_$k = sh_value[local_ix * PER_THREAD + $ku];
    let digit_$k = (digit_of(key_$k, sort) >> step_shift) & 15u;
    let column_$k = (digit_$k & 7u) * WG_SIZE + local_ix;
    let half_$k = (digit_$k >> 3u) * 16u;
    let counted_$k = sh_rank[column_$k];
    let rank_$k = (counted_$k >> half_$k) & 0xffffu;
    sh_rank[column_$k] = counted_$k + (1u << half_$k);
#end
    workgroupBarrier();
    var sum = 0u;
#repeat k 8
    sum += sh_rank[local_ix * PER_THREAD + $ku];
#end
    let scan = scan_workgroup(local_ix, sum);
    var before = scan.before;
#repeat k 8
    {
        let own = sh_rank[local_ix * PER_THREAD + $ku];
        sh_rank[local_ix * PER_THREAD + $ku] = before;
        before += own;
    }
#end
    // Digits 8 to 15 come after all of 0 to 7.
    let n_low = scan.total & 0xffffu;
    workgroupBarrier();
#repeat k 8
    {
        let first = (sh_rank[column_$k] >> half_$k) & 0xffffu;
        let place = first + rank_$k + select(0u, n_low, half_$k > 0u);
        sh_key[place] = key_$k;
        sh_value[place] = value_$k;
    }
#end
    workgroupBarrier();
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) wid: vec3u,
    @builtin(num_workgroups) n_wg: vec3u,
    @builtin(local_invocation_index) local_ix: u32,
) {
    let block_ix = min(workgroup_ix(wid, n_wg), sort.n_blocks);
    let first_ix = block_ix * SORT_BLOCK;
    let n = min(sort.n, limit[0]);
    // The whole workgroup has no pair.
    if first_ix >= n {
        return;
    }
    for (var k = 0u; k < PER_THREAD; k++) {
        let at = k * WG_SIZE + local_ix;
        // Padding has the last digit and comes last, after the real pairs.
        var key = 0xffffffffu;
        var value = 0u;
        if first_ix + at < n {
            key = keys[first_ix + at];
            value = values[first_ix + at];
        }
        sh_key[at] = key;
        sh_value[at] = value;
    }
    workgroupBarrier();
    sort_step(local_ix, 0u);
    if sort.n_digits > 16u {
        sort_step(local_ix, 4u);
    }
    for (var k = 0u; k < PER_THREAD; k++) {
        let at = k * WG_SIZE + local_ix;
        let digit = digit_of(sh_key[at], sort);
        var is_first = at == 0u;
        if at > 0u {
            is_first = digit_of(sh_key[at - 1u], sort) != digit;
        }
        if is_first {
            sh_start[digit] = at;
        }
    }
    workgroupBarrier();
    if block_ix >= sort.n_blocks {
        return;
    }
    for (var k = 0u; k < PER_THREAD; k++) {
        let at = k * WG_SIZE + local_ix;
        if first_ix + at < n {
            let key = sh_key[at];
            let digit = digit_of(key, sort);
            let place = places[digit * sort.n_blocks + block_ix] + at - sh_start[digit];
            sorted_keys[place] = key;
            sorted_values[place] = sh_value[at];
        }
    }
}
