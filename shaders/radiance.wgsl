// The radiance branch alone over the background, for passes without material. A thread owns a pixel. No workgroup
// memory.
const WG_SIZE = 256u;
#import index
#import composite
#import generated/channels

@group(0) @binding(0) var<uniform> composite: Composite;
@group(0) @binding(1) var<storage, read> gbuffer: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> radiance: array<vec4f>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let pixel_ix = invocation_ix(gid, n_wg);
    if pixel_ix >= composite.n_pixels {
        return;
    }
    let first = gbuffer[pixel_ix];
    radiance[pixel_ix] = vec4f(channel_radiance(first) + composite.background.xyz * (1.0 - channel_coverage(first)), 0.0);
}
