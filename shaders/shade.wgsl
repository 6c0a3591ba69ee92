// G-buffer to the images of both branches, composited over the background. A thread owns a pixel. A
// workgroup is a square of 16 x 16 pixels, which look up neighbouring table nodes. No workgroup memory.
#import shading
#import pixel_surface

@group(0) @binding(6) var<storage, read> gbuffer: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> physical: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> radiance: array<vec4f>;

@compute @workgroup_size(16, 16)
fn main(@builtin(global_invocation_id) gid: vec3u) {
    if gid.x >= camera.size.x || gid.y >= camera.size.y {
        return;
    }
    let pixel_ix = gid.y * camera.size.x + gid.x;
    let first = gbuffer[pixel_ix];
    let coverage = channel_coverage(first);
    let behind = shading.background.xyz * (1.0 - coverage);
    radiance[pixel_ix] = vec4f(channel_radiance(first) + behind, 0.0);
    if !(coverage >= MIN_COVERAGE) {
        physical[pixel_ix] = vec4f(behind, 0.0);
        return;
    }
    var s = pixel_surface(gid.xy, pixel_ix, coverage);
    let f = shade(&s);
    let shown = display(f.diffuse + f.specular, shading.srgb != 0u, shading.peak);
    physical[pixel_ix] = vec4f(shown * coverage + behind, 0.0);
}
