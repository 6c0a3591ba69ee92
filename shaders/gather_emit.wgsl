// Radiance of each Gaussian in this round: diffuse (sky + gathered so far). A thread owns one Gaussian. No workgroup memory.
// This is a separate kernel because the next one reads the radiance once per link, at random positions.
#import gather
#import index

@group(0) @binding(0) var<uniform> transport: GatherSize;
@group(0) @binding(1) var<storage, read> direct: array<vec4f>;
@group(0) @binding(2) var<storage, read> diffuse: array<vec4f>;
@group(0) @binding(3) var<storage, read> gathered: array<f32>;
@group(0) @binding(4) var<storage, read_write> emitted: array<vec4f>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    if gaussian_ix >= transport.n {
        return;
    }
    let row = 6u * gaussian_ix;
    let irradiance = direct[gaussian_ix].xyz + vec3f(gathered[row], gathered[row + 1u], gathered[row + 2u]);
    emitted[gaussian_ix] = vec4f(diffuse[gaussian_ix].xyz * irradiance, 0.0);
}
