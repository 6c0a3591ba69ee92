// Number of cells of each flat Gaussian in order of depth, for the prefix sum of list positions.
// A thread owns one rank. No workgroup memory.
#import index
#import probe

@group(0) @binding(0) var<uniform> sweep: Sweep;
@group(0) @binding(1) var<storage, read> flats: array<Flat>;
@group(0) @binding(2) var<storage, read> gaussian_of_rank: array<u32>;
@group(0) @binding(3) var<storage, read_write> n_cells_of_rank: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let rank_ix = invocation_ix(gid, n_wg);
    if rank_ix >= sweep.n {
        return;
    }
    n_cells_of_rank[rank_ix] = flats[gaussian_of_rank[rank_ix]].n_cells;
}
