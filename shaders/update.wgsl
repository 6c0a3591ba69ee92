// Updates the parameters of the Gaussians from the summed gradients of the splats: chain rules of projection and attributes,
// terms of the objective on the parameters themselves, and Adam (under GRADIENTS, writes the gradients instead).
//
// A thread owns a Gaussian, on screen or not, and computes its gradients. A workgroup updates its own Gaussians' parameters
// in place. The values of a field that a gradient needs are read before that field is emitted.
// Workgroup memory, 24 KiB: (1) Gradients of the wide fields (scores, indirect, radiance), N_STAGED values per Gaussian at a
// time. The Gaussian's thread writes them; then neighbouring threads emit neighbouring elements, so that parameters and
// moments are read and written in whole cache lines. Rows are one longer than the workgroup, against bank conflicts.
// (2) Gradients of shared parameters (prototypes, basis of the learned indirect light) are outer products factor x derivative
// summed over Gaussians. The memory holds factors and derivatives; 32 threads sum a row, with three atomics per workgroup.
// (3) The sums of the losses reuse the memory.
#import attributes
#import index
#import camera
#import splat
#import sh_walk
#import generated/slots
#import generated/channels
#import generated/parameters
#import emit
#import project_backward
#import score_mixture
#import view_label

const WG_SIZE = 256u;
// Rows of an outer product summed at a time; the workgroup's threads are divided among them.
const BLOCK = 8u;
const LANES = 32u;
// Number of values that a Gaussian can stage (BLOCK factors, then BLOCK gradients; or harmonics), and the distance between
// their rows.
const N_STAGED = 16u;
const STRIDE = 257u;

struct Update {
    // Per field: rate over the correction of the first moment, root of the correction of the second.
    rates: array<vec4f, N_FIELDS>,
    // Number of groups of 4 channels in a row of splat gradients.
    groups: u32,
    // Half the longer side of the image, pixels.
    half_width: f32,
    // Weights of the terms, divided by the number of Gaussians; 0: off.
    aggregation: f32,
    residual: f32,
    flatness: f32,
    probe_labels: f32,
    // Weight, not divided: only the device knows the number of Gaussians with a label.
    view_labels: f32,
    pad: u32,
}

@group(0) @binding(0) var<uniform> model: Layout;
@group(0) @binding(1) var<uniform> camera: Camera;
@group(0) @binding(2) var<uniform> update: Update;
@group(0) @binding(3) var<storage, read> splats: array<Splat>;
// Rows of HEADER_GROUPS + groups: mean and conic xx, xy; conic yy, opacity, absgrad, 0; channels.
@group(0) @binding(4) var<storage, read> splat_gradients: array<vec4f>;
@group(0) @binding(5) var<storage, read> globals: array<f32>;
@group(0) @binding(6) var<storage, read_write> globals_gradient: array<accumulator>;
// E_j (docs/MODEL.md section 3) and its gradient.
@group(0) @binding(7) var<storage, read> indirect_basis: array<f32>;
@group(0) @binding(8) var<storage, read_write> basis_gradient: array<accumulator>;
@group(0) @binding(9) var<storage, read> probe_labels: array<f32>;
// Per Gaussian: sum w That, sum w.
@group(0) @binding(10) var<storage, read> view_labels: array<vec2f>;
@group(0) @binding(11) var<storage, read> label_count: array<u32>;
@group(0) @binding(12) var<storage, read_write> losses: array<accumulator>;
// Per Gaussian: sum of absgrad (blend_backward) in half image widths, and number of steps on screen: the signal of density
// control.
@group(0) @binding(13) var<storage, read_write> density: array<vec2f>;
@group(0) @binding(14) var<storage, read_write> status: array<atomic<u32>>;
// Status of the tile lists (tile_capacity.wgsl): if they were too short, nothing is updated.
@group(0) @binding(15) var<storage, read> list_status: array<u32>;
#ifdef GRADIENTS
@group(0) @binding(16) var<storage, read> params: array<f32>;
@group(0) @binding(17) var<storage, read_write> gradients: array<f32>;
#else
@group(0) @binding(16) var<storage, read_write> params: array<f32>;
@group(0) @binding(17) var<storage, read_write> first: array<f32>;
@group(0) @binding(18) var<storage, read_write> second: array<f32>;
#endif

// [value][Gaussian].
var<workgroup> sh_staged: array<f32, 4112>;
var<workgroup> sh_derivative: array<vec4f, 256>;
var<workgroup> sh_partial: array<vec4f, 256>;

// Derivative of the sigmoid.
fn sigmoid_derivative(x: f32) -> f32 {
    // Not s (1 - s): where s is nearly 1, 1 - s loses its digits.
    return sigmoid(x) * sigmoid(-x);
}

// The gradient of a Gaussian from the image.
struct Upstream {
    // True when projected; otherwise all gradients are zero and the row is not read.
    visible: bool,
    // Start of its row.
    row: u32,
}

fn upstream_of(gaussian_ix: u32) -> Upstream {
    return Upstream((splats[gaussian_ix].flags & SPLAT_VISIBLE) != 0u, gaussian_ix * (HEADER_GROUPS + update.groups));
}

// Four channels' gradient.
fn channels(up: Upstream, group: u32) -> vec4f {
    if !up.visible || group >= update.groups {
        return vec4f(0.0);
    }
    return splat_gradients[up.row + HEADER_GROUPS + group];
}

// Chain rule of the normal and the plane's distance; returns the gradient of the field `Normal`.
fn normal_backward(gaussian_ix: u32, up: Upstream, to_mean: vec3f, geometry: ptr<function, Geometry>) -> vec3f {
    if !up.visible || update.groups < GROUPS_GEOMETRY {
        return vec3f(0.0);
    }
    let by = channels(up, NORMAL_GROUP);
    let normal = normal_of(gaussian_ix, to_mean);
    (*geometry).mean += by.w * normal.unit;
    let by_sum = normalised3_backward(normal.unit, normal.length, by.xyz + by.w * to_mean);
    let by_axis = normal.sign * by_sum;
    (*geometry).rotation[0] += select(vec3f(0.0), by_axis, normal.axis == 0u);
    (*geometry).rotation[1] += select(vec3f(0.0), by_axis, normal.axis == 1u);
    (*geometry).rotation[2] += select(vec3f(0.0), by_axis, normal.axis == 2u);
    return by_sum;
}

// Factors of the radiance coefficients' gradient.
struct Radiance {
    // Gradient by the colour where its clamp passes it.
    by_colour: vec3f,
    direction: vec3f,
    // False without a gradient; the direction may then be infinite or NaN.
    is_active: bool,
}

// Returns the gradient of the centre through the direction.
fn radiance_backward(gaussian_ix: u32, up: Upstream, to_mean: vec3f, out: ptr<function, Radiance>) -> vec3f {
    let base = model.radiance + gaussian_ix * 3u * model.n_radiance;
    let sh_degree = sh_degree_of(model.n_radiance);
    let by_colour = channel_radiance(channels(up, COVERAGE_GROUP));
    if all(by_colour == vec3f(0.0)) {
        return vec3f(0.0);
    }
    let direction = normalised3(to_mean);
    var raw = vec3f(0.5);
    for (var term = sh_first(sh_degree, direction); sh_is_term(term); sh_next(&term)) {
        let ix = sh_indices(term);
        let y = sh_values(term);
        raw += y.x * params_vec3(base + 3u * ix.x);
        if term.m > 0u {
            raw += y.y * params_vec3(base + 3u * ix.y);
        }
    }
    let g = select(vec3f(0.0), by_colour, raw > vec3f(0.0));
    var by_direction = vec3f(0.0);
    for (var term = sh_first(sh_degree, direction); sh_is_term(term); sh_next(&term)) {
        let ix = sh_indices(term);
        let derivatives = sh_gradients(term);
        by_direction += dot(g, params_vec3(base + 3u * ix.x)) * derivatives[0];
        if term.m > 0u {
            by_direction += dot(g, params_vec3(base + 3u * ix.y)) * derivatives[1];
        }
    }
    *out = Radiance(g, direction, true);
    return normalised3_backward(direction, length3(to_mean), by_direction);
}

// Emits the radiance coefficients of the workgroup that starts at `first_ix`. Uniform control flow.
fn emit_radiance(first_ix: u32, local_ix: u32, own: Radiance) {
    if !trains(FIELD_RADIANCE) {
        return;
    }
    sh_derivative[local_ix] = vec4f(own.by_colour, 0.0);
    for (var coefficient = 0u; coefficient < model.n_radiance; coefficient += N_STAGED) {
        for (var term = sh_first(sh_degree_of(model.n_radiance), own.direction); sh_is_term(term); sh_next(&term)) {
            // Below `coefficient` the difference wraps around to a large number.
            let ix = sh_indices(term) - coefficient;
            let y = select(vec2f(0.0), sh_values(term), own.is_active);
            if ix.x < N_STAGED {
                sh_staged[ix.x * STRIDE + local_ix] = y.x;
            }
            if term.m > 0u && ix.y < N_STAGED {
                sh_staged[ix.y * STRIDE + local_ix] = y.y;
            }
        }
        workgroupBarrier();
        // The owners read the coefficients before the neighbours write them.
        storageBarrier();
        let width = 3u * min(model.n_radiance - coefficient, N_STAGED);
        for (var at = local_ix; at < WG_SIZE * width; at += WG_SIZE) {
            let owner_ix = at / width;
            let k = at % width;
            let gaussian_ix = first_ix + owner_ix;
            if gaussian_ix < model.n {
                let gradient = sh_derivative[owner_ix][k % 3u] * sh_staged[k / 3u * STRIDE + owner_ix];
                let field = select(FIELD_RADIANCE_REST, FIELD_RADIANCE, coefficient == 0u && k < 3u);
                emit(model.radiance + 3u * (gaussian_ix * model.n_radiance + coefficient) + k, gradient, field);
            }
        }
        workgroupBarrier();
    }
}

// Emits the visibility coefficients; returns the value of the label terms.
fn visibility_backward(gaussian_ix: u32, up: Upstream, to_mean: vec3f) -> f32 {
    if !(trains(FIELD_VISIBILITY) || update.probe_labels != 0.0 || update.view_labels != 0.0) {
        return 0.0;
    }
    let first_ix = gaussian_ix * model.n_visibility;
    let sh_degree = sh_degree_of(model.n_visibility);
    let direction = normalised3(to_mean);
    var label = vec2f(0.0);
    if update.view_labels != 0.0 {
        label = view_label(gaussian_ix, up, sh_degree, direction);
    }
    var value = label.x;
    for (var term = sh_first(sh_degree, direction); sh_is_term(term); sh_next(&term)) {
        let ix = sh_indices(term);
        let by_y = select(vec2f(0.0), label.y * sh_values(term), label.y != 0.0);
        for (var side = 0u; side < select(2u, 1u, term.m == 0u); side++) {
            let k = select(ix.y, ix.x, side == 0u);
            let element_ix = model.visibility + first_ix + k;
            var gradient = select(by_y.y, by_y.x, side == 0u);
            if up.visible && update.groups >= GROUPS_FULL {
                let channel = FIRST_VISIBILITY + k;
                gradient += splat_gradients[up.row + HEADER_GROUPS + channel / 4u][channel % 4u];
            }
            if update.probe_labels != 0.0 {
                let error = params[element_ix] - probe_labels[first_ix + k];
                value += update.probe_labels * error * error;
                gradient += 2.0 * update.probe_labels * error;
            }
            emit(element_ix, gradient, FIELD_VISIBILITY);
        }
    }
    return value;
}

// Gradient of score `k`, and the share of prototype `k` in the Gaussian's albedo.
fn score_backward(m: Mixture, gaussian_ix: u32, up: Upstream, k: u32) -> vec2f {
    let p = share(m, gaussian_ix, k);
    var gradient = 0.0;
    if up.visible && update.groups >= GROUPS_MATERIAL {
        gradient = p * (dot(m.by_albedo, albedo_of_prototype(k)) - m.by_mixture);
    }
    if update.aggregation != 0.0 {
        gradient += p * (aggregation_derivative(m, p) - m.by_aggregation);
    }
    // Without a gradient by the albedo the share may be any value, NaN included: it must not enter the sum.
    return vec2f(gradient, select(0.0, p, any(m.by_albedo != vec3f(0.0))));
}

// Sum over the workgroup of factor x derivative for this thread's row and channel, from factors and derivatives in workgroup
// memory. Threads below 3 * BLOCK get the result: row `local_ix / 3`, channel `local_ix % 3`. The caller puts barriers before
// and after.
fn reduce_products(local_ix: u32) -> f32 {
    let row = local_ix / LANES;
    let lane = local_ix % LANES;
    var sum = vec3f(0.0);
    for (var i = lane; i < WG_SIZE; i += LANES) {
        sum += sh_staged[row * STRIDE + i] * sh_derivative[i].xyz;
    }
    sh_partial[local_ix] = vec4f(sum, 0.0);
    workgroupBarrier();
    var total = 0.0;
    if local_ix < 3u * BLOCK {
        for (var i = 0u; i < LANES; i++) {
            total += sh_partial[local_ix / 3u * LANES + i][local_ix % 3u];
        }
    }
    return total;
}

// Emits all scores and sums the gradient of the prototypes; returns the aggregation's value. Uniform control flow.
fn scores_backward(gaussian_ix: u32, is_owner: bool, up: Upstream, local_ix: u32, by_albedo: ptr<function, vec3f>) -> f32 {
    let reduces = update.groups >= GROUPS_MATERIAL;
    if !(reduces || update.aggregation != 0.0 || trains(FIELD_SCORES)) {
        return 0.0;
    }
    var m: Mixture;
    var value = 0.0;
    if is_owner {
        m = mixture_of(gaussian_ix, up);
        *by_albedo = m.by_albedo;
        if update.aggregation != 0.0 {
            value = -update.aggregation * log(select(m.q, AGGREGATION_EPSILON, m.q <= AGGREGATION_EPSILON));
        }
    }
    sh_derivative[local_ix] = vec4f(*by_albedo, 0.0);
    for (var k = 0u; k < model.n_scores; k += BLOCK) {
        for (var row = 0u; row < BLOCK; row++) {
            var by = vec2f(0.0);
            if is_owner && k + row < model.n_scores {
                by = score_backward(m, gaussian_ix, up, k + row);
            }
            sh_staged[row * STRIDE + local_ix] = by.y;
            sh_staged[(BLOCK + row) * STRIDE + local_ix] = by.x;
        }
        workgroupBarrier();
        let first_ix = gaussian_ix - local_ix;
        emit_block(first_ix, local_ix, model.scores + k, model.n_scores, model.n_scores - k, FIELD_SCORES);
        if reduces {
            let total = reduce_products(local_ix);
            let element_ix = 3u * k + local_ix;
            if local_ix < 3u * BLOCK && element_ix < 3u * model.n_scores && total != 0.0 {
                let a = globals[element_ix];
                if a > 0.0 && a < 1.0 {
                    accumulate!(globals_gradient[element_ix], total);
                }
            }
        }
        workgroupBarrier();
    }
    return value;
}

// Emits the weights of the learned indirect light and sums the gradient of its basis. Uniform control flow.
fn indirect_backward(gaussian_ix: u32, is_owner: bool, up: Upstream, local_ix: u32) {
    let reduces = model.indirect_form == INDIRECT_LEARNED && update.groups >= GROUPS_FULL;
    if !(reduces || trains(FIELD_INDIRECT)) {
        return;
    }
    var by_light = vec3f(0.0);
    if reduces && is_owner {
        by_light = channel_blocked(channels(up, DEPTH_GROUP));
    }
    let is_active = any(by_light != vec3f(0.0));
    sh_derivative[local_ix] = vec4f(by_light, 0.0);
    for (var j = 0u; j < 16u; j += BLOCK) {
        for (var row = 0u; row < BLOCK; row++) {
            var factor = 0.0;
            var gradient = 0.0;
            if is_active {
                let e = 3u * (j + row);
                factor = params[model.indirect + 16u * gaussian_ix + j + row];
                gradient = dot(by_light, vec3f(indirect_basis[e], indirect_basis[e + 1u], indirect_basis[e + 2u]));
            }
            sh_staged[row * STRIDE + local_ix] = factor;
            sh_staged[(BLOCK + row) * STRIDE + local_ix] = gradient;
        }
        workgroupBarrier();
        emit_block(gaussian_ix - local_ix, local_ix, model.indirect + j, 16u, BLOCK, FIELD_INDIRECT);
        if reduces {
            let total = reduce_products(local_ix);
            if local_ix < 3u * BLOCK && total != 0.0 {
                accumulate!(basis_gradient[3u * j + local_ix], total);
            }
        }
        workgroupBarrier();
    }
}

// Metalness, roughness, sheen and residual; returns the residual term's value.
fn material_backward(gaussian_ix: u32, up: Upstream, by_albedo: vec3f) -> f32 {
    let by_metal = channel_metal(channels(up, ALBEDO_GROUP));
    let by_rough_group = channels(up, ROUGH_GROUP);
    var derivatives = vec3f(0.0);
    if up.visible && update.groups >= GROUPS_MATERIAL {
        derivatives.x = by_metal * sigmoid_derivative(params[model.metal + gaussian_ix]);
        derivatives.y = channel_rough(by_rough_group) * sigmoid_derivative(params[model.rough + gaussian_ix]);
        derivatives.z = select(0.0, channel_by_sheen(by_rough_group), model.shade_at == SHADE_AT_GAUSSIAN);
    }
    emit(model.metal + gaussian_ix, derivatives.x, FIELD_METAL);
    emit(model.rough + gaussian_ix, derivatives.y, FIELD_ROUGH);
    emit(model.sheen + gaussian_ix, derivatives.z, FIELD_SHEEN);
    var gradient = by_albedo;
    var value = 0.0;
    let residual_ix = model.residual + 3u * gaussian_ix;
    if update.residual != 0.0 {
        let residual = params_vec3(residual_ix);
        gradient += update.residual * sign(residual);
        value = update.residual * dot(abs(residual), vec3f(1.0));
    }
    emit3(residual_ix, gradient, FIELD_RESIDUAL);
    return value;
}

// Emits centre, scales, rotation, opacity, normal and visibility; returns the values of flatness and of the labels.
fn geometry_backward(gaussian_ix: u32, up: Upstream, radiance: ptr<function, Radiance>) -> vec2f {
    let mean = params_vec3(model.mean + 3u * gaussian_ix);
    let log_scale = params_vec3(model.log_scale + 3u * gaussian_ix);
    let quaternion_ix = model.quaternion + 4u * gaussian_ix;
    let quaternion = quaternion_at(gaussian_ix);
    let to_mean = mean - camera.centre.xyz;
    var by = Geometry(vec3f(0.0), vec3f(0.0), mat3x3f(), 0.0);
    var by_quaternion = vec4f(0.0);
    var by_normal = vec3f(0.0);
    if up.visible {
        let axes = rotation_of(quaternion);
        by = project_backward(gaussian_ix, up, axes, log_scale, mean);
        by_normal = normal_backward(gaussian_ix, up, to_mean, &by);
        by_quaternion = rotation_backward(quaternion, by.rotation);
        if update.groups >= GROUPS_FULL {
            by.mean += channel_depth(channels(up, DEPTH_GROUP)) * camera.rotation[2].xyz;
        }
        density[gaussian_ix] += vec2f(splat_gradients[up.row + 1u].z * update.half_width, 1.0);
    }
    by.mean += radiance_backward(gaussian_ix, up, to_mean, radiance);
    let labels = visibility_backward(gaussian_ix, up, to_mean);
    var flatness = 0.0;
    if update.flatness != 0.0 {
        // The lowest axis on a tie, as for the normal.
        let s = log_scale;
        let axis = select(select(2u, 1u, s.y <= s.z), 0u, s.x <= s.y && s.x <= s.z);
        flatness = update.flatness * exp(min(s.x, min(s.y, s.z)));
        by.log_scale += select(vec3f(0.0), vec3f(flatness), vec3u(axis) == vec3u(0u, 1u, 2u));
    }
    emit3(model.mean + 3u * gaussian_ix, by.mean, FIELD_MEAN);
    emit3(model.log_scale + 3u * gaussian_ix, by.log_scale, FIELD_LOG_SCALE);
    emit3(quaternion_ix, by_quaternion.xyz, FIELD_QUATERNION);
    emit(quaternion_ix + 3u, by_quaternion.w, FIELD_QUATERNION);
    emit(model.opacity + gaussian_ix, by.opacity, FIELD_OPACITY);
    emit3(model.normal + 3u * gaussian_ix, by_normal, FIELD_NORMAL);
    return vec2f(flatness, labels);
}

// Adds the workgroup's sums of aggregation, residual, flatness and label terms. Uniform control flow.
fn reduce_losses(local_ix: u32, values: vec4f) {
    sh_partial[local_ix] = values;
    for (var n = WG_SIZE / 2u; n > 0u; n /= 2u) {
        workgroupBarrier();
        if local_ix < n {
            sh_partial[local_ix] += sh_partial[local_ix + n];
        }
    }
    workgroupBarrier();
    // The four slots are consecutive.
    if local_ix < 4u {
        let total = sh_partial[0][local_ix];
        if total != 0.0 {
            accumulate!(losses[LOSS_AGGREGATION + local_ix], total);
        }
    }
}

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u,
    @builtin(local_invocation_index) local_ix: u32) {
    if list_status[1] != 0u {
        return;
    }
    let gaussian_ix = invocation_ix(gid, n_wg);
    let is_owner = gaussian_ix < model.n;
    var up = Upstream(false, 0u);
    if is_owner {
        up = upstream_of(gaussian_ix);
    }
    var by_albedo = vec3f(0.0);
    var radiance = Radiance(vec3f(0.0), vec3f(0.0, 0.0, 1.0), false);
    var values = vec4f(0.0);
    values.x = scores_backward(gaussian_ix, is_owner, up, local_ix, &by_albedo);
    indirect_backward(gaussian_ix, is_owner, up, local_ix);
    if is_owner {
        values.y = material_backward(gaussian_ix, up, by_albedo);
        let terms = geometry_backward(gaussian_ix, up, &radiance);
        values.z = terms.x;
        values.w = terms.y;
        // The sampling rate is measured, so nothing depends on it in training.
        emit(model.sampling_rate + gaussian_ix, 0.0, FIELD_SAMPLING_RATE);
    }
    emit_radiance(gaussian_ix - local_ix, local_ix, radiance);
    reduce_losses(local_ix, values);
}
