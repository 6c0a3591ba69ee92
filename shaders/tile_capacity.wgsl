// Number of listed instances of a view: all of them, or as many as the memory holds. One thread runs.

struct TileCapacity {
    n_instances: u32,
    pad_a: u32,
    pad_b: u32,
    pad_c: u32,
}

@group(0) @binding(0) var<uniform> capacity: TileCapacity;
// Number of visible Gaussians; number of instances, low and high word.
@group(0) @binding(1) var<storage, read> counts: array<u32>;
// Number of listed instances; 1 after a view with more instances than memory, until the host clears it; instances of this
// view, low and high word; its visible Gaussians.
@group(0) @binding(2) var<storage, read_write> list_status: array<u32>;

@compute @workgroup_size(1)
fn main() {
    let is_short = counts[2] != 0u || counts[1] > capacity.n_instances;
    list_status[0] = select(counts[1], capacity.n_instances, is_short);
    if is_short {
        list_status[1] = 1u;
    }
    list_status[2] = counts[1];
    list_status[3] = counts[2];
    list_status[4] = counts[0];
}
