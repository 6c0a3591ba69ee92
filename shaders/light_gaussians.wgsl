// Radiance of each Gaussian towards the camera, from its attribute row: written into that row or, with COLOUR, into a row of
// coverage and linear colour that is blended instead. A thread owns a Gaussian. No workgroup memory.
const WG_SIZE = 256u;
#import index
#import shading
#import gaussian_surface

@group(0) @binding(6) var<uniform> model: Layout;
@group(0) @binding(7) var<storage, read> params: array<f32>;
@group(0) @binding(8) var<storage, read> splats: array<Splat>;
@group(0) @binding(9) var<storage, read> gathered: array<f32>;
@group(0) @binding(10) var<storage, read> indirect_basis: array<f32>;
#ifdef COLOUR
@group(0) @binding(11) var<storage, read> attributes: array<vec4f>;
@group(0) @binding(12) var<storage, read_write> colours: array<vec4f>;
#else
@group(0) @binding(11) var<storage, read_write> attributes: array<vec4f>;
#endif

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
    let light = f.diffuse + f.specular;
#ifdef COLOUR
    colours[gaussian_ix] = vec4f(1.0, light);
#else
    let row = gaussian_ix * ROW_GROUPS;
    attributes[row + ROUGH_GROUP] = vec4f(s.rough, light);
#ifdef ALL_CHANNELS
    attributes[row + DEPTH_GROUP] = vec4f(channel_depth(attributes[row + DEPTH_GROUP]), f.specular);
#endif
#endif
}
