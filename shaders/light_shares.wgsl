// Arriving share of each dominant light at each Gaussian: the mean transmittance over the light's disc, written after the
// gathered light (shared/measured.wgsl). A thread owns one Gaussian. No workgroup memory.
#import index

const WG_SIZE = 256u;

struct LightShares {
    // Number of measured directions of each light; 0: the light does not exist.
    n_directions: vec4u,
    // Number of Gaussians.
    n: u32,
    pad_a: u32,
    pad_b: u32,
    pad_c: u32,
}

@group(0) @binding(0) var<uniform> shares: LightShares;
// [direction][Gaussian], beginning with the directions of the first light.
@group(0) @binding(1) var<storage, read> transmittances: array<f32>;
@group(0) @binding(2) var<storage, read_write> gathered: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    if gaussian_ix >= shares.n {
        return;
    }
    var first = 0u;
    for (var k = 0u; k < 4u; k++) {
        let end = first + shares.n_directions[k];
        var share = 1.0;
        if end > first {
            var sum = 0.0;
            for (var direction_ix = first; direction_ix < end; direction_ix++) {
                sum += transmittances[direction_ix * shares.n + gaussian_ix];
            }
            share = clamp(sum / f32(end - first), 0.0, 1.0);
        }
        gathered[6u * shares.n + 4u * gaussian_ix + k] = share;
        first = end;
    }
}
