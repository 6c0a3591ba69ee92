// Number of tiles of each Gaussian in depth order. A thread owns one rank. No workgroup memory.
#import index
#import splat

const WG_SIZE = 256u;

struct Ranks {
    n: u32,
    pad_a: u32,
    pad_b: u32,
    pad_c: u32,
}

@group(0) @binding(0) var<uniform> ranks: Ranks;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> gaussian_of_rank: array<u32>;
@group(0) @binding(3) var<storage, read_write> n_tiles_of_rank: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let rank_ix = invocation_ix(gid, n_wg);
    if rank_ix >= ranks.n {
        return;
    }
    n_tiles_of_rank[rank_ix] = splats[gaussian_of_rank[rank_ix]].n_tiles;
}
