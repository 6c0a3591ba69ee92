// Copies measurements to the Gaussians of the next generation: each new row is the row of its source. A thread owns one
// value of the new rows, so that writes are coalesced. No workgroup memory.
#import index

const WG_SIZE = 256u;

struct InheritedRows {
    // Values of all new rows.
    n_values: u32,
    // Values of a row.
    width: u32,
    // First value of the old and of the new rows.
    old_start: u32,
    new_start: u32,
}

@group(0) @binding(0) var<uniform> rows: InheritedRows;
// Per new Gaussian: its old one, and its kind.
@group(0) @binding(1) var<storage, read> plan: array<vec2u>;
@group(0) @binding(2) var<storage, read> old_values: array<f32>;
@group(0) @binding(3) var<storage, read_write> new_values: array<f32>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let ix = invocation_ix(gid, n_wg);
    if ix >= rows.n_values {
        return;
    }
    let source_ix = plan[ix / rows.width].x;
    new_values[rows.new_start + ix] = old_values[rows.old_start + source_ix * rows.width + ix % rows.width];
}
