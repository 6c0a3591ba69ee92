// Values and gradients of the harmonics of degree 6 along given directions, and rotations of given quaternions, for the
// tests of the shared pieces. A thread owns one direction; no workgroup memory.
const WG_SIZE = 256u;
#import index
#import quaternion
#import sh

@group(0) @binding(0) var<storage, read> directions: array<vec4f>;
// [direction][49] of value and gradient, then 3 columns and the quaternion's gradient under g = those columns squared.
@group(0) @binding(1) var<storage, read_write> answers: array<vec4f>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let direction_ix = invocation_ix(gid, n_wg);
    if direction_ix >= arrayLength(&directions) {
        return;
    }
    let given = directions[direction_ix];
    var y: array<f32, 49>;
    var dy: array<vec3f, 49>;
    var plain: array<f32, 49>;
    let d = normalised3(given.xyz);
    sh_basis_with_gradient(6u, d, &y, &dy);
    sh_basis(6u, d, &plain);
    let first = direction_ix * 53u;
    for (var j = 0u; j < 49u; j++) {
        answers[first + j] = vec4f(select(-999.0, y[j], abs(y[j] - plain[j]) <= 1e-6 * max(1.0, abs(y[j]))), dy[j]);
    }
    let q = rotation_of(given);
    for (var c = 0u; c < 3u; c++) {
        answers[first + 49u + c] = vec4f(q[c], 0.0);
    }
    answers[first + 52u] = rotation_backward(given, mat3x3f(q[0] * q[0], q[1] * q[1], q[2] * q[2]));
}
