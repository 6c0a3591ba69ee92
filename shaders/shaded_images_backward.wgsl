// Gradients of the G-buffer of a pass whose Gaussians were shaded before blending, from the gradients of both images
// (shaded_images.wgsl) and of the buffers. A thread owns a pixel and writes all n_groups groups, zeros beyond material. No
// workgroup memory.
const WG_SIZE = 256u;
#import generated/channels
#import index
#import composite
#import display

@group(0) @binding(0) var<uniform> composite: Composite;
@group(0) @binding(1) var<storage, read> gbuffer: array<vec4f>;
@group(0) @binding(2) var<storage, read> by_physical: array<vec4f>;
@group(0) @binding(3) var<storage, read> by_radiance: array<vec4f>;
// See surface_terms.wgsl.
@group(0) @binding(4) var<storage, read> by_buffers: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> by_gbuffer: array<vec4f>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let pixel_ix = invocation_ix(gid, n_wg);
    let n = composite.n_pixels;
    if pixel_ix >= n {
        return;
    }
    let coverage = channel_coverage(gbuffer[pixel_ix]);
    let g = by_physical[pixel_ix].xyz;
    let g_radiance = by_radiance[pixel_ix].xyz;
    let on_material = by_buffers[n + pixel_ix];
    var by_coverage = on_material.x - dot(g + g_radiance, composite.background.xyz);
    var by_sum = vec3f(0.0);
    if coverage >= MIN_COVERAGE {
        let is_srgb = composite.srgb != 0u;
        let light = channel_outgoing(gbuffer[ROUGH_GROUP * n + pixel_ix]) / coverage;
        let by_light = display_backward(light, g * coverage, is_srgb, composite.peak);
        by_coverage += dot(g, display(light, is_srgb, composite.peak)) - dot(by_light, light) / coverage;
        by_sum = by_light / coverage;
    }
    by_gbuffer[pixel_ix] = vec4f(by_coverage, g_radiance);
    by_gbuffer[NORMAL_GROUP * n + pixel_ix] = by_buffers[pixel_ix];
    by_gbuffer[ALBEDO_GROUP * n + pixel_ix] = vec4f(vec3f(0.0), on_material.y);
    by_gbuffer[ROUGH_GROUP * n + pixel_ix] = vec4f(on_material.z, by_sum);
    for (var group = GROUPS_MATERIAL; group < composite.n_groups; group++) {
        by_gbuffer[group * n + pixel_ix] = vec4f(0.0);
    }
}
