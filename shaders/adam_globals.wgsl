// Adam for the parameters that all Gaussians share: albedo prototypes, then the raw environment. A thread owns one float. No
// workgroup memory.
#import index
#import status
#import adam
#import finite

const WG_SIZE = 256u;

struct AdamGlobals {
    // Number of floats of the prototypes, and of all parameters.
    n_prototypes: u32,
    n: u32,
    // Rates over the correction of the first moment; 0: unchanged.
    rate_prototypes: f32,
    rate_environment: f32,
    // Root of the correction of the second moment.
    correction: f32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
}

@group(0) @binding(0) var<uniform> uniforms: AdamGlobals;
@group(0) @binding(1) var<storage, read> gradient: array<f32>;
@group(0) @binding(2) var<storage, read_write> globals: array<f32>;
@group(0) @binding(3) var<storage, read_write> first: array<f32>;
@group(0) @binding(4) var<storage, read_write> second: array<f32>;
@group(0) @binding(5) var<storage, read_write> status: array<atomic<u32>>;
// Status of the tile lists (tile_capacity.wgsl): if they were too short, nothing is updated.
@group(0) @binding(6) var<storage, read> list_status: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let element_ix = invocation_ix(gid, n_wg);
    if element_ix >= uniforms.n || list_status[1] != 0u {
        return;
    }
    let rate = select(uniforms.rate_environment, uniforms.rate_prototypes, element_ix < uniforms.n_prototypes);
    if !(rate > 0.0) {
        return;
    }
    let g = gradient[element_ix];
    if !is_finite(g) {
        atomicOr(&status[STATUS_POISON], POISON_GLOBAL);
        return;
    }
    let by = adam(first[element_ix], second[element_ix], g, rate, uniforms.correction);
    first[element_ix] = by.first;
    second[element_ix] = by.second;
    globals[element_ix] -= by.step;
}
