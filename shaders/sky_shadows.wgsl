// Adds the shadows of the sky that the visibility field blurs to gathered light (docs/MODEL.md, section 6). A thread owns one
// Gaussian and iterates over the directions: neighbouring threads read neighbouring transmittances. No workgroup memory.
#import attributes
#import finite
#import gather
#import index
#import sky

@group(0) @binding(0) var<uniform> transport: GatherSize;
@group(0) @binding(1) var<uniform> model: Layout;
@group(0) @binding(2) var<uniform> shape: Tables;
@group(0) @binding(3) var<storage, read> params: array<f32>;
@group(0) @binding(4) var<storage, read> values: array<f32>;
@group(0) @binding(5) var<storage, read> directions: array<vec4f>;
// Outward normals.
@group(0) @binding(6) var<storage, read> normals: array<vec4f>;
// [direction][Gaussian].
@group(0) @binding(7) var<storage, read> transmittances: array<f32>;
// Radiance of the light around each direction.
@group(0) @binding(8) var<storage, read> radiance: array<vec4f>;
@group(0) @binding(9) var<storage, read_write> gathered: array<f32>;
// 64 harmonics per direction.
@group(0) @binding(10) var<storage, read> basis: array<f32>;
@group(0) @binding(11) var<storage, read> globals: array<f32>;

const BASIS = 64u;

// The visibility field of a Gaussian in a direction.
fn field(gaussian_ix: u32, direction_ix: u32) -> f32 {
    let first = model.visibility + model.n_visibility * gaussian_ix;
    var sum = 0.0;
    for (var k = 0u; k < min(model.n_visibility, BASIS); k++) {
        sum += params[first + k] * basis[BASIS * direction_ix + k];
    }
    return sum;
}

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    if gaussian_ix >= transport.n {
        return;
    }
    let normal = normal_of(gaussian_ix, -normals[gaussian_ix].xyz).unit;
    // Parameters that are not finite give a normal that is not finite.
    if !(is_finite(normal.x) && is_finite(normal.y) && is_finite(normal.z)) {
        return;
    }
    var sum = vec3f(0.0);
    for (var direction_ix = 0u; direction_ix < transport.n_directions; direction_ix++) {
        let facing = dot(normal, directions[direction_ix].xyz);
        if facing > 0.0 {
            let open = transmittances[direction_ix * transport.n + gaussian_ix];
            sum += transport.weight * facing * (open - field(gaussian_ix, direction_ix)) * radiance[direction_ix].xyz;
        }
    }
    sum = max(sum, -sky_irradiance(gaussian_ix, normal));
    let row = 6u * gaussian_ix;
#repeat k 3
    gathered[row + $ku] += sum[$k];
#end
}
