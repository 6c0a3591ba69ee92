// Rebuilds parameters and moments after a round of density control, which drops, copies and halves Gaussians. A thread owns
// one element of the new planar buffers, so that writes are coalesced and reads almost so. No workgroup memory. The planar
// layout depends on the number of Gaussians: an element is identified by field, Gaussian and k.
#import generated/density
#import index
#import generated/parameters
#import quaternion

const WG_SIZE = 256u;
// Kinds of a new Gaussian: unchanged; unchanged with zero moments; one half or the other, with zero moments.
const KIND_KEEP = 0u;
const KIND_FRESH = 1u;
const KIND_UPPER_HALF = 2u;
const KIND_LOWER_HALF = 3u;

@group(0) @binding(0) var<uniform> old: Layout;
@group(0) @binding(1) var<uniform> now: Layout;
// Per new Gaussian: its old one, and its kind.
@group(0) @binding(2) var<storage, read> plan: array<vec2u>;
@group(0) @binding(3) var<storage, read> old_params: array<f32>;
@group(0) @binding(4) var<storage, read> old_first: array<f32>;
@group(0) @binding(5) var<storage, read> old_second: array<f32>;
@group(0) @binding(6) var<storage, read_write> new_params: array<f32>;
@group(0) @binding(7) var<storage, read_write> new_first: array<f32>;
@group(0) @binding(8) var<storage, read_write> new_second: array<f32>;

// A field's start in the new and in the old buffer, and its width.
struct Place {
    new_start: u32,
    old_start: u32,
    width: u32,
}

// The field that new element `ix` belongs to.
fn place_of(ix: u32) -> Place {
    var field = N_PARAMETER_FIELDS - 1u;
    while field > 0u && ix < field_start(now, field) {
        field--;
    }
    return Place(field_start(now, field), field_start(old, field), field_width(now, field));
}

fn old_vector(start: u32) -> vec3f {
    return vec3f(old_params[start], old_params[start + 1u], old_params[start + 2u]);
}

// Axis of the largest scale, the lowest on a tie.
fn longest_axis(s: vec3f) -> u32 {
    if s.x >= s.y && s.x >= s.z {
        return 0u;
    }
    return select(2u, 1u, s.y >= s.z);
}

// Element `k` of a half: moved half a sigma along the longest axis, shorter along it, and less opaque, so
// that both halves together hide what the whole hid.
fn halved(place: Place, source_ix: u32, k: u32, value: f32, side: f32) -> f32 {
    let log_scale = old_vector(old.log_scale + 3u * source_ix);
    let axis = longest_axis(log_scale);
    if place.new_start == now.mean {
        let start = old.quaternion + 4u * source_ix;
        let q = rotation_of(vec4f(old_vector(start), old_params[start + 3u]));
        let direction = select(select(q[2], q[1], axis == 1u), q[0], axis == 0u);
        let longest = max(log_scale.x, max(log_scale.y, log_scale.z));
        return value + side * 0.5 * exp(longest) * direction[k];
    }
    if place.new_start == now.log_scale {
        return value + log(select(HALF_SCALE_ACROSS, HALF_SCALE_ALONG, k == axis));
    }
    if place.new_start == now.opacity {
        let opacity = 1.0 / (1.0 + exp(-value));
        let half = clamp(1.0 - pow(1.0 - opacity, HALF_OPACITY_EXPONENT), 0.01, 0.98);
        return log(half / (1.0 - half));
    }
    return value;
}

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let element_ix = invocation_ix(gid, n_wg);
    let last_field = N_PARAMETER_FIELDS - 1u;
    if element_ix >= field_start(now, last_field) + field_width(now, last_field) * now.n {
        return;
    }
    let place = place_of(element_ix);
    let gaussian_ix = (element_ix - place.new_start) / place.width;
    let k = (element_ix - place.new_start) % place.width;
    let source_ix = min(plan[gaussian_ix].x, old.n - 1u);
    let kind = plan[gaussian_ix].y;
    let source = place.old_start + source_ix * place.width + k;
    var value = old_params[source];
    if kind >= KIND_UPPER_HALF {
        value = halved(place, source_ix, k, value, select(-1.0, 1.0, kind == KIND_UPPER_HALF));
    }
    new_params[element_ix] = value;
    new_first[element_ix] = select(0.0, old_first[source], kind == KIND_KEEP);
    new_second[element_ix] = select(0.0, old_second[source], kind == KIND_KEEP);
}
