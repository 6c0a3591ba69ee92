// Writes one (tile, Gaussian) pair for each tile that a splat reaches, splats in depth order. A thread owns one rank and the
// instances that were counted for it. It never writes past them, and fills unused ones with the index after the last tile,
// which no kernel reads. No workgroup memory.
#import index
#import tiles

const WG_SIZE = 256u;

struct Emission {
    // Number of Gaussians; the next member is the number of instances that the memory holds.
    n: u32,
    n_instances: u32,
    pad_a: u32,
    pad_b: u32,
}

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> emission: Emission;
@group(0) @binding(2) var<storage, read> splats: array<Splat>;
@group(0) @binding(3) var<storage, read> gaussian_of_rank: array<u32>;
@group(0) @binding(4) var<storage, read> first_instance: array<u32>;
@group(0) @binding(5) var<storage, read_write> tile_of_instance: array<u32>;
@group(0) @binding(6) var<storage, read_write> gaussian_of_instance: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let rank_ix = invocation_ix(gid, n_wg);
    if rank_ix >= emission.n {
        return;
    }
    let end = min(first_instance[rank_ix + 1u], emission.n_instances);
    var instance_ix = first_instance[rank_ix];
    if instance_ix >= end {
        return;
    }
    let gaussian_ix = gaussian_of_rank[rank_ix];
    let s = splats[gaussian_ix];
    let rows = tile_rows(s, camera);
    for (var row = rows.x; row < rows.y; row++) {
        let columns = tile_columns(s, camera, row);
        for (var column = columns.x; column < columns.y && instance_ix < end; column++) {
            tile_of_instance[instance_ix] = row * camera.tiles.x + column;
            gaussian_of_instance[instance_ix] = gaussian_ix;
            instance_ix++;
        }
    }
    for (; instance_ix < end; instance_ix++) {
        tile_of_instance[instance_ix] = camera.tiles.x * camera.tiles.y;
        gaussian_of_instance[instance_ix] = gaussian_ix;
    }
}
