// Gradient of the first group of the G-buffer (GEOMETRY: also normal and plane) from the gradients of the radiance image and
// of the buffers. A thread owns a pixel. No workgroup memory.
const WG_SIZE = 256u;
#import index
#import composite
#import generated/channels

@group(0) @binding(0) var<uniform> composite: Composite;
@group(0) @binding(1) var<storage, read> by_radiance: array<vec4f>;
// See surface_terms.wgsl.
@group(0) @binding(2) var<storage, read> by_buffers: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> by_gbuffer: array<vec4f>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let pixel_ix = invocation_ix(gid, n_wg);
    if pixel_ix >= composite.n_pixels {
        return;
    }
    let g = by_radiance[pixel_ix].xyz;
    let by_coverage = by_buffers[composite.n_pixels + pixel_ix].x - dot(g, composite.background.xyz);
    by_gbuffer[pixel_ix] = vec4f(by_coverage, g);
#ifdef GEOMETRY
    by_gbuffer[NORMAL_GROUP * composite.n_pixels + pixel_ix] = by_buffers[pixel_ix];
#endif
}
