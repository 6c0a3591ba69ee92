// Writes one (cell, Gaussian) pair for each cell that a flat Gaussian overlaps, in order of depth. A stable sort by cell then
// keeps each cell's Gaussians in that order. A thread owns one rank. No workgroup memory.
#import index
#import probe

@group(0) @binding(0) var<uniform> sweep: Sweep;
@group(0) @binding(1) var<storage, read> flats: array<Flat>;
@group(0) @binding(2) var<storage, read> gaussian_of_rank: array<u32>;
@group(0) @binding(3) var<storage, read> first_instance: array<u32>;
@group(0) @binding(4) var<storage, read_write> cell_of_instance: array<u32>;
@group(0) @binding(5) var<storage, read_write> gaussian_of_instance: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let rank_ix = invocation_ix(gid, n_wg);
    if rank_ix >= sweep.n {
        return;
    }
    var instance_ix = first_instance[rank_ix];
    let end = min(first_instance[rank_ix + 1u], sweep.n_instances);
    if instance_ix >= end {
        return;
    }
    let gaussian_ix = gaussian_of_rank[rank_ix];
    let cells = unpack4xU8(flats[gaussian_ix].cells);
    for (var row = cells.y; row <= cells.w; row++) {
        for (var column = cells.x; column <= cells.z && instance_ix < end; column++) {
            cell_of_instance[instance_ix] = row * sweep.side + column;
            gaussian_of_instance[instance_ix] = gaussian_ix;
            instance_ix++;
        }
    }
}
