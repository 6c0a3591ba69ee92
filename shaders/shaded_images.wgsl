// Both branches of a pass whose Gaussians were shaded before blending, composited over the background. The G-buffer holds
// radiance. A thread owns a pixel. No workgroup memory.
const WG_SIZE = 256u;
#import generated/channels
#import index
#import composite
#import display

@group(0) @binding(0) var<uniform> composite: Composite;
// The groups up to material, or more.
@group(0) @binding(1) var<storage, read> gbuffer: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> physical: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> radiance: array<vec4f>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let pixel_ix = invocation_ix(gid, n_wg);
    if pixel_ix >= composite.n_pixels {
        return;
    }
    let first = gbuffer[pixel_ix];
    let coverage = channel_coverage(first);
    let behind = composite.background.xyz * (1.0 - coverage);
    radiance[pixel_ix] = vec4f(channel_radiance(first) + behind, 0.0);
    var shown = vec3f(0.0);
    if coverage >= MIN_COVERAGE {
        let outgoing = channel_outgoing(gbuffer[ROUGH_GROUP * composite.n_pixels + pixel_ix]);
        shown = display(outgoing / coverage, composite.srgb != 0u, composite.peak);
    }
    physical[pixel_ix] = vec4f(shown * coverage + behind, 0.0);
}
