// The preview tier: shades every visible Gaussian once, as a surface with its attributes, into a row of coverage and linear
// colour that is then blended (src/render/preview.rs). A thread owns a Gaussian; no workgroup memory.
const WG_SIZE = 256u;
#import index
#import shading
#import gaussian_surface

@group(0) @binding(6) var<uniform> model: Layout;
@group(0) @binding(7) var<storage, read> params: array<f32>;
@group(0) @binding(8) var<storage, read> splats: array<Splat>;
// Rows of all channels.
@group(0) @binding(9) var<storage, read> attributes: array<vec4f>;
@group(0) @binding(10) var<storage, read_write> colours: array<vec4f>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    if gaussian_ix >= model.n {
        return;
    }
    if !is_drawn(gaussian_ix) {
        return;
    }
    var s = gaussian_surface(gaussian_ix);
    let f = shade(&s);
    colours[gaussian_ix] = vec4f(1.0, f.diffuse + f.specular);
}
