// The extent of the grids along one axis, from the occluders' sorted coordinates: the middle 98 % plus half of that on either
// side, limited to the occluders' range. Otherwise a few far-away Gaussians would put all others into one cell. One thread
// runs: a binary search and four reads. No workgroup memory.
#import probe

@group(0) @binding(0) var<uniform> sweep: Sweep;
// Ascending; Gaussians that hide nothing come last.
@group(0) @binding(1) var<storage, read> keys: array<u32>;
// Lowest corner, highest corner, four floats each; `direction_ix` of the sweep is the axis.
@group(0) @binding(2) var<storage, read_write> bounds: array<f32, 8>;

@compute @workgroup_size(1)
fn main() {
    let axis = min(sweep.direction_ix - sweep.n_directions, 2u);
    var n_valid = 0u;
    var hi = sweep.n;
    while n_valid < hi {
        let middle = n_valid + (hi - n_valid) / 2u;
        if keys[middle] != 0xffffffffu {
            n_valid = middle + 1u;
        } else {
            hi = middle;
        }
    }
    var lowest = 0.0;
    var highest = 0.0;
    if n_valid > 0u {
        let skipped = n_valid / 100u;
        let first = float_of_sortable(keys[skipped]);
        let last = float_of_sortable(keys[n_valid - 1u - skipped]);
        let margin = 0.5 * (last - first);
        lowest = max(float_of_sortable(keys[0]), first - margin);
        highest = min(float_of_sortable(keys[n_valid - 1u]), last + margin);
    }
    bounds[axis] = lowest;
    bounds[4u + axis] = highest;
}
