// Projects Gaussians to splats (docs/MODEL.md, section 2), counts the tiles of each and computes its sort key.
// A thread owns one Gaussian. Workgroup memory holds two counters, so that a workgroup adds to the global counts once.
//
// The determinant of the screen covariance M M^T is computed as the squared length of the cross product of M's rows: for
// needles `xx yy - xy^2` would be the difference of two large numbers, and WGSL has no f64. The low-pass lp, added to xx and
// yy, adds lp (xx + yy) + lp^2, a sum of positive terms.
#import finite
#import index
#import generated/parameters
#import quaternion
#import tiles

const WG_SIZE = 256u;

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> model: Layout;
@group(0) @binding(2) var<storage, read> params: array<f32>;
@group(0) @binding(3) var<storage, read_write> splats: array<Splat>;
@group(0) @binding(4) var<storage, read_write> depth_keys: array<u32>;
@group(0) @binding(5) var<storage, read_write> gaussians: array<u32>;
// Number of visible Gaussians; number of tile instances, low and high word.
@group(0) @binding(6) var<storage, read_write> counts: array<atomic<u32>, 3>;

var<workgroup> sh_n_visible: atomic<u32>;
var<workgroup> sh_n_instances: atomic<u32>;

fn vec3_at(at: u32) -> vec3f {
    return vec3f(params[at], params[at + 1u], params[at + 2u]);
}

fn all_finite(v: vec3f) -> bool {
    return is_finite(v.x) && is_finite(v.y) && is_finite(v.z);
}

fn invisible() -> Splat {
    var s: Splat;
    s.n_tiles = 0u;
    s.flags = 0u;
    return s;
}

fn project(gaussian_ix: u32) -> Splat {
    let mean = vec3_at(model.mean + 3u * gaussian_ix);
    let log_scale = vec3_at(model.log_scale + 3u * gaussian_ix);
    let at = model.quaternion + 4u * gaussian_ix;
    let quaternion = vec4f(params[at], vec3_at(at + 1u));
    let logit = params[model.opacity + gaussian_ix];
    let sampling_rate = params[model.sampling_rate + gaussian_ix];
    // No photograph shows it.
    if sampling_rate < 0.0 {
        return invisible();
    }
    let numbers = !(is_nan(log_scale.x) || is_nan(log_scale.y) || is_nan(log_scale.z) || is_nan(logit));
    if !(numbers && all_finite(mean) && is_finite(quaternion.x) && all_finite(quaternion.yzw)) {
        return invisible();
    }
    let at_camera = to_camera(camera, mean);
    if !(at_camera.z > NEAR && at_camera.z < FAR) {
        return invisible();
    }
    let inverse = 1.0 / at_camera.z;
    let ratio = clamp(at_camera.xy * inverse, camera.ratio_limits.xz, camera.ratio_limits.yw);
    let derivative = camera.focal * inverse;
    let to_x = derivative.x * camera.rotation[0].xyz - derivative.x * ratio.x * camera.rotation[2].xyz;
    let to_y = derivative.y * camera.rotation[1].xyz - derivative.y * ratio.y * camera.rotation[2].xyz;
    let scale = exp(clamp(log_scale, vec3f(-LOG_SCALE_LIMIT), vec3f(LOG_SCALE_LIMIT)));
    let axes = rotation_of(quaternion);
    // The three scaled axes on screen. Sums of their squares cannot become negative.
    let x = scale * vec3f(dot(to_x, axes[0]), dot(to_x, axes[1]), dot(to_x, axes[2]));
    let y = scale * vec3f(dot(to_y, axes[0]), dot(to_y, axes[1]), dot(to_y, axes[2]));
    let raw = vec3f(dot(x, x), dot(x, y), dot(y, y));
    if !(raw.x < MAX_SCREEN_VARIANCE && raw.z < MAX_SCREEN_VARIANCE) {
        return invisible();
    }
    let area = cross(x, y);
    let raw_determinant = dot(area, area);
    let lp = low_pass_of(camera, at_camera.z, sampling_rate);
    let determinant = raw_determinant + lp * (raw.x + raw.z) + lp * lp;
    if !(determinant > MIN_DETERMINANT) {
        return invisible();
    }
    var s: Splat;
    s.covariance = raw + vec3f(lp, 0.0, lp);
    s.conic = vec3f(s.covariance.z, -s.covariance.y, s.covariance.x) / determinant;
    s.compensation = 1.0;
    if camera.low_pass_compensation != 0u {
        s.compensation = sqrt(raw_determinant / determinant);
    }
    // Beyond 80 the sigmoid is 0 or 1 in f32.
    s.opacity = s.compensation / (1.0 + exp(-clamp(logit, -80.0, 80.0)));
    if !(s.opacity >= ALPHA_MIN) {
        return invisible();
    }
    s.mean = camera.focal * (at_camera.xy / at_camera.z) + camera.centre_px;
    // A mean beyond this distance reaches no pixel, and the backward pass would overflow.
    if !(abs(s.mean.x) < MAX_PIXEL_DISTANCE && abs(s.mean.y) < MAX_PIXEL_DISTANCE) {
        return invisible();
    }
    s.reach = log(255.0 * s.opacity);
    s.depth = at_camera.z;
    s.flags = SPLAT_VISIBLE;
    s.pad_a = 0u;
    s.pad_b = 0u;
    let rows = tile_rows(s, camera);
    var n_tiles = 0u;
    for (var row = rows.x; row < rows.y; row++) {
        let columns = tile_columns(s, camera, row);
        n_tiles += columns.y - columns.x;
    }
    s.n_tiles = n_tiles;
    return s;
}

// Key that orders Gaussians by depth: the bits of r_3 . x, the part of depth that differs between Gaussians. For a far-away
// camera the depths of a model differ in their last digits only; this part keeps all digits.
fn depth_key(mean: vec3f) -> u32 {
    // Positive floats have the order of their bits, negative ones the reverse order; -0 equals 0.
    let bits = bitcast<u32>(dot(camera.rotation[2].xyz, mean));
    let positive = bits < 0x80000000u || bits == 0x80000000u;
    return select(~bits, (bits & 0x7fffffffu) | 0x80000000u, positive);
}

@compute @workgroup_size(256)
fn main(
    @builtin(global_invocation_id) gid: vec3u,
    @builtin(num_workgroups) n_wg: vec3u,
    @builtin(local_invocation_index) local_ix: u32,
) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    if local_ix == 0u {
        atomicStore(&sh_n_visible, 0u);
        atomicStore(&sh_n_instances, 0u);
    }
    workgroupBarrier();
    if gaussian_ix < model.n {
        let s = project(gaussian_ix);
        splats[gaussian_ix] = s;
        gaussians[gaussian_ix] = gaussian_ix;
        let visible = s.flags == SPLAT_VISIBLE;
        depth_keys[gaussian_ix] = select(0xffffffffu, depth_key(vec3_at(model.mean + 3u * gaussian_ix)), visible);
        if visible {
            atomicAdd(&sh_n_visible, 1u);
            atomicAdd(&sh_n_instances, s.n_tiles);
        }
    }
    workgroupBarrier();
    if local_ix == 0u {
        atomicAdd(&counts[0], atomicLoad(&sh_n_visible));
        let more = atomicLoad(&sh_n_instances);
        let before = atomicAdd(&counts[1], more);
        // The sum wrapped around: carry.
        if before + more < before {
            atomicAdd(&counts[2], 1u);
        }
    }
}
