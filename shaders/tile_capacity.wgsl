// How many instances of a view are listed: all of them, or as many as there is memory for. One thread.

struct TileCapacity {
    n_instances: u32,
    pad_a: u32,
    pad_b: u32,
    pad_c: u32,
}

@group(0) @binding(0) var<uniform> capacity: TileCapacity;
// Visible Gaussians; low and high half of the number of instances.
@group(0) @binding(1) var<storage, read> counts: array<u32>;
// Instances listed; 1 once a view had more, until the host clears it; low and high half of the number of this view; its visible
// Gaussians.
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
