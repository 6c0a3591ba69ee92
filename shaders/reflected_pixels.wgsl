// Reflection of one unoccluded small light by the surface of each pixel, times coverage: the sum, and the specular part. A
// thread owns a pixel. No workgroup memory.
#import index
#import pixel_reflector
#import sharp_reflection

const WG_SIZE = 256u;

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> light: SharpLight;
@group(0) @binding(2) var<storage, read> gbuffer: array<vec4f>;
@group(0) @binding(3) var<storage, read> constants: array<f32>;
@group(0) @binding(4) var<storage, read_write> reflected: array<vec4f>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let pixel_ix = invocation_ix(gid, n_wg);
    if pixel_ix >= camera.n_pixels {
        return;
    }
    let coverage = channel_coverage(gbuffer[pixel_ix]);
    var sent = Reflected(vec3f(0.0), vec3f(0.0));
    if coverage >= MIN_COVERAGE {
        let ray = pixel_ray(camera, pixel_ix % camera.size.x, pixel_ix / camera.size.x);
        sent = sent_of(pixel_reflector(pixel_ix, coverage, ray, light.conserves_energy == 1u), light, 0.0);
    }
    reflected[pixel_ix] = vec4f(coverage, coverage * (sent.diffuse + sent.specular));
    reflected[camera.n_pixels + pixel_ix] = vec4f(0.0, coverage * sent.specular);
}
