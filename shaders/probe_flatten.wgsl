// Projects the occluders along one direction, computes their depth keys and counts the cells of all of them.
// A thread owns one Gaussian. Workgroup memory holds one counter, so that a workgroup adds to the total once.
//
// The host runs this kernel twice: over all directions, to find the lengths of their lists with one read-back, and again
// when it builds the lists. Both runs find exactly the same cells.
#import index
#import probe

@group(0) @binding(0) var<uniform> sweep: Sweep;
@group(0) @binding(1) var<storage, read> frames: array<Frame>;
// Box of the grid: lowest corner, highest corner.
@group(0) @binding(2) var<storage, read> bounds: array<vec4f, 2>;
@group(0) @binding(3) var<storage, read> occluders: array<Occluder>;
@group(0) @binding(4) var<storage, read_write> flats: array<Flat>;
@group(0) @binding(5) var<storage, read_write> depth_keys: array<u32>;
@group(0) @binding(6) var<storage, read_write> gaussians: array<u32>;
// Number of cells per direction, low and high word.
@group(0) @binding(7) var<storage, read_write> totals: array<atomic<u32>>;

var<workgroup> sh_n_cells: atomic<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(global_invocation_id) gid: vec3u,
    @builtin(num_workgroups) n_wg: vec3u,
    @builtin(local_invocation_index) local_ix: u32,
) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    if local_ix == 0u {
        atomicStore(&sh_n_cells, 0u);
    }
    workgroupBarrier();
    if gaussian_ix < sweep.n {
        let frame = frames[sweep.direction_ix];
        let grid = plane_grid(frame, bounds[0].xyz, bounds[1].xyz, sweep.side);
        let flat = flatten(occluders[gaussian_ix], frame, grid);
        flats[gaussian_ix] = flat;
        gaussians[gaussian_ix] = gaussian_ix;
        depth_keys[gaussian_ix] = select(0xffffffffu, sortable(flat.depth), flat.n_cells > 0u);
        // At most 256 times 65,536: no overflow within a workgroup.
        atomicAdd(&sh_n_cells, flat.n_cells);
    }
    workgroupBarrier();
    if local_ix == 0u {
        let more = atomicLoad(&sh_n_cells);
        let before = atomicAdd(&totals[2u * sweep.direction_ix], more);
        // The sum wrapped around: carry.
        if before + more < before {
            atomicAdd(&totals[2u * sweep.direction_ix + 1u], 1u);
        }
    }
}
