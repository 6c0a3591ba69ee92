// Reflection of one unoccluded small light by each Gaussian, in rows of two groups for blending: 1 and the sum, 0 and the
// specular part. A thread owns a Gaussian. No workgroup memory.
#import index
#import generated/channels
#import generated/parameters
#import camera
#import splat
#import sharp_reflection

const WG_SIZE = 256u;

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> light: SharpLight;
@group(0) @binding(2) var<uniform> model: Layout;
@group(0) @binding(3) var<storage, read> params: array<f32>;
@group(0) @binding(4) var<storage, read> splats: array<Splat>;
@group(0) @binding(5) var<storage, read> attributes: array<vec4f>;
@group(0) @binding(6) var<storage, read> constants: array<f32>;
@group(0) @binding(7) var<storage, read_write> reflected: array<vec4f>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    if gaussian_ix >= model.n {
        return;
    }
    if splats[gaussian_ix].n_tiles == 0u {
        return;
    }
    let at = model.mean + 3u * gaussian_ix;
    let to_mean = vec3f(params[at], params[at + 1u], params[at + 2u]) - camera.centre.xyz;
    let row = gaussian_ix * light.row_groups;
    let material = attributes[row + ALBEDO_GROUP];
    let r = reflector_of(
        channel_normal(attributes[row + NORMAL_GROUP]),
        -normalised3(to_mean),
        channel_albedo(material),
        channel_metal(material),
        channel_rough(attributes[row + ROUGH_GROUP]),
        light.conserves_energy == 1u,
    );
    let sent = sent_of(r, light, params[model.sheen + gaussian_ix]);
    reflected[2u * gaussian_ix] = vec4f(1.0, sent.diffuse + sent.specular);
    reflected[2u * gaussian_ix + 1u] = vec4f(0.0, sent.specular);
}
