// Per Gaussian, the input of a bounce: the irradiance of the sky through its own visibility plus the arriving shares of the
// dominant lights, and the share of its irradiance that a diffuse surface reflects (albedo (1 - metal) / pi). A thread owns
// one Gaussian. No workgroup memory.
#import attributes
#import finite
#import index
#import measured
#import sky
#import tables

const WG_SIZE = 256u;
const FRAC_1_PI = 0.31830989;

@group(0) @binding(0) var<uniform> model: Layout;
@group(0) @binding(1) var<uniform> shape: Tables;
@group(0) @binding(2) var<storage, read> params: array<f32>;
@group(0) @binding(3) var<storage, read> globals: array<f32>;
@group(0) @binding(4) var<storage, read> values: array<f32>;
@group(0) @binding(5) var<storage, read> normals: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> direct: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> diffuse: array<vec4f>;
@group(0) @binding(8) var<storage, read> gathered: array<f32>;

// Irradiance of the dominant lights at a surface with this unit normal.
fn of_lights(gaussian_ix: u32, normal: vec3f) -> vec3f {
    let arriving = arriving_at(gaussian_ix, model.n);
    var sum = vec3f(0.0);
    for (var k = 0u; k < shape.n_lights; k++) {
        let at = shape.first_light + 3u * k;
        let light = vec3f(values[at], values[at + 1u], values[at + 2u]);
        sum += arriving[k] * max(dot(normal, shape.lights[k].xyz), 0.0) * light;
    }
    return sum;
}

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    if gaussian_ix >= model.n {
        return;
    }
    let normal = normals[gaussian_ix].xyz;
    var sky = vec3f(0.0);
    var lights = vec3f(0.0);
    // Parameters that are not finite give a normal that is not finite.
    if is_finite(normal.x) && is_finite(normal.y) && is_finite(normal.z) {
        sky = sky_irradiance(gaussian_ix, normal);
        lights = of_lights(gaussian_ix, normal);
    }
    direct[gaussian_ix] = vec4f(sky + lights, 0.0);
    let rest = 1.0 - sigmoid(params[model.metal + gaussian_ix]);
    let albedo = clamp(albedo_of(gaussian_ix), vec3f(0.0), vec3f(1.0));
    diffuse[gaussian_ix] = vec4f(albedo * rest * FRAC_1_PI, 0.0);
}
