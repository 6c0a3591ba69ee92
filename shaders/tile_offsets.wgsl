// First slot of each tile in the sorted instances (those that were counted and that the memory holds), and the end. A thread
// owns one tile and runs a binary search, which takes as many steps for an empty tile as for a full one. No workgroup memory.
#import index

const WG_SIZE = 256u;

struct TileCounts {
    n_tiles: u32,
    // Maximum number of instances.
    n_instances: u32,
    pad_a: u32,
    pad_b: u32,
}

@group(0) @binding(0) var<uniform> tile_counts: TileCounts;
@group(0) @binding(1) var<storage, read> tile_of_slot: array<u32>;
@group(0) @binding(2) var<storage, read> limit: array<u32>;
@group(0) @binding(3) var<storage, read_write> first_slot: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let tile_ix = invocation_ix(gid, n_wg);
    if tile_ix > tile_counts.n_tiles {
        return;
    }
    var lo = 0u;
    var hi = min(tile_counts.n_instances, limit[0]);
    while lo < hi {
        let middle = lo + (hi - lo) / 2u;
        if tile_of_slot[middle] < tile_ix {
            lo = middle + 1u;
        } else {
            hi = middle;
        }
    }
    first_slot[tile_ix] = lo;
}
