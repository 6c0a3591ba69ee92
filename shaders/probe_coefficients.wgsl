// Visibility coefficients from transmittances: 4 pi / D sum_d V(w_d) Y(w_d).
// A thread owns one Gaussian and 16 of its coefficients, in registers, so that each transmittance is read at most four
// times and no sum needs memory. The threads of a workgroup share the coefficients, so the basis is read uniformly.
#import index

const WG_SIZE = 256u;

struct Projection {
    n: u32,
    n_directions: u32,
    n_coefficients: u32,
    // 4 pi / D.
    weight: f32,
}

@group(0) @binding(0) var<uniform> projection: Projection;
// 64 floats per direction, zero beyond the last coefficient.
@group(0) @binding(1) var<storage, read> basis: array<vec4f>;
@group(0) @binding(2) var<storage, read> transmittances: array<f32>;
@group(0) @binding(3) var<storage, read_write> coefficients: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) wid: vec3u,
    @builtin(num_workgroups) n_wg: vec3u,
    @builtin(local_invocation_index) local_ix: u32,
) {
    let n_blocks = (projection.n + WG_SIZE - 1u) / WG_SIZE;
    let n_chunks = (projection.n_coefficients + 15u) / 16u;
    let group_ix = workgroup_ix(wid, n_wg);
    let chunk_ix = group_ix / max(n_blocks, 1u);
    let gaussian_ix = (group_ix % max(n_blocks, 1u)) * WG_SIZE + local_ix;
    if chunk_ix >= n_chunks || gaussian_ix >= projection.n {
        return;
    }
#repeat k 4
    var sum_$k = vec4f(0.0);
#end
    for (var direction_ix = 0u; direction_ix < projection.n_directions; direction_ix++) {
        let seen = projection.weight * transmittances[direction_ix * projection.n + gaussian_ix];
        let first = 16u * direction_ix + 4u * chunk_ix;
#repeat k 4
        sum_$k += seen * basis[first + $ku];
#end
    }
    let row = gaussian_ix * projection.n_coefficients;
#repeat k 4
#repeat c 4
    if 16u * chunk_ix + 4u * $ku + $cu < projection.n_coefficients {
        coefficients[row + 16u * chunk_ix + 4u * $ku + $cu] = sum_$k[$c];
    }
#end
#end
}
