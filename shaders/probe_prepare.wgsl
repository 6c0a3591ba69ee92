// Input of the probes: occluders with their scaled axes, outward normals, and query points. A thread owns one Gaussian. No
// workgroup memory. This kernel runs once per measurement, the following ones once per direction.
#import index
#import generated/parameters
#import probe
#import quaternion

// Coordinate of the query point of a Gaussian with unusable parameters (not finite, or too far out): outside
// of everything measured.
const NOWHERE = 2.0 * FAR_OUT;

struct ProbeStart {
    // Offset of a query along the outward normal, in standard deviations; `lift` adds world units.
    offset: f32,
    lift: f32,
    // Addend to the query's own standard deviation along the normal, for its clearance.
    bias: f32,
    pad: u32,
}

@group(0) @binding(0) var<uniform> model: Layout;
@group(0) @binding(1) var<uniform> start: ProbeStart;
@group(0) @binding(2) var<storage, read> params: array<f32>;
@group(0) @binding(3) var<storage, read_write> occluders: array<Occluder>;
// Query point, and the smallest distance of an occluder.
@group(0) @binding(4) var<storage, read_write> queries: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> normals: array<vec4f>;

fn vec3_at(at: u32) -> vec3f {
    return vec3f(params[at], params[at + 1u], params[at + 2u]);
}

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    if gaussian_ix >= model.n {
        return;
    }
    let mean = vec3_at(model.mean + 3u * gaussian_ix);
    let log_scale = vec3_at(model.log_scale + 3u * gaussian_ix);
    let at = model.quaternion + 4u * gaussian_ix;
    let quaternion = vec4f(params[at], vec3_at(at + 1u));
    let logit = params[model.opacity + gaussian_ix];
    let rotation = rotation_of(quaternion);
    // e^34.5 = 1e15: larger scales cannot be projected, and their squares would not stay finite.
    let scale = exp(clamp(log_scale, vec3f(-60.0), vec3f(34.5)));
    var o: Occluder;
    o.mean = mean;
#repeat k 3
    o.axes[$k] = vec4f(scale[$k] * rotation[$k], 0.0);
#end
    let sized = !(is_nan(log_scale.x) || is_nan(log_scale.y) || is_nan(log_scale.z));
    let usable = sized && within_reason(mean) && is_finite(quaternion.x) && all_finite3(quaternion.yzw);
    o.opacity = select(0.0, 1.0 / (1.0 + exp(-clamp(logit, -80.0, 80.0))), usable && !is_nan(logit));
    occluders[gaussian_ix] = o;

    // The shortest axis, on the side to which the degree-1 part of the field points: Y_1 = k (-y, z, -x).
    let second = select(rotation[2], rotation[1], log_scale.y <= log_scale.z);
    var normal = select(second, rotation[0], log_scale.x <= log_scale.y && log_scale.x <= log_scale.z);
    if model.n_visibility >= 4u {
        let row = model.visibility + model.n_visibility * gaussian_ix;
        let open = vec3f(-params[row + 3u], -params[row + 1u], params[row + 2u]);
        if dot(open, normal) < 0.0 {
            normal = -normal;
        }
    }
    normals[gaussian_ix] = vec4f(normal, 0.0);
    let sigma = length(vec3f(dot(o.axes[0].xyz, normal), dot(o.axes[1].xyz, normal), dot(o.axes[2].xyz, normal)));
    let query = vec4f(mean + (start.offset * sigma + start.lift) * normal, sigma + start.bias);
    queries[gaussian_ix] = select(vec4f(NOWHERE), query, usable);
}
