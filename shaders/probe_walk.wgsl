// Transmittance from each Gaussian along one direction, and the Gaussian that blocks most of the rest. A thread owns one query
// and visits the footprints of its cell in order of depth, from its own depth on. No workgroup memory: neighbouring Gaussians
// may lie in different cells.
#import index
#import probe

@group(0) @binding(0) var<uniform> sweep: Sweep;
@group(0) @binding(1) var<storage, read> frames: array<Frame>;
@group(0) @binding(2) var<storage, read> bounds: array<vec4f, 2>;
@group(0) @binding(3) var<storage, read> queries: array<vec4f>;
@group(0) @binding(4) var<storage, read> flats: array<Flat>;
@group(0) @binding(5) var<storage, read> first_slot: array<u32>;
@group(0) @binding(6) var<storage, read> gaussian_of_slot: array<u32>;
// [direction][Gaussian].
@group(0) @binding(7) var<storage, read_write> transmittances: array<f32>;
@group(0) @binding(8) var<storage, read_write> hits: array<u32>;

struct Seen {
    transmittance: f32,
    hit: u32,
}

fn measure(gaussian_ix: u32, query: vec4f) -> Seen {
    let frame = frames[sweep.direction_ix];
    let grid = plane_grid(frame, bounds[0].xyz, bounds[1].xyz, sweep.side);
    let p = vec2f(dot(query.xyz, frame.u.xyz), dot(query.xyz, frame.v.xyz));
    let depth = dot(query.xyz, frame.d.xyz);
    let cell = cell_at(grid, p);
    let cell_ix = cell.y * sweep.side + cell.x;
    let end = first_slot[cell_ix + 1u];
    var slot_ix = first_slot[cell_ix];
    var deeper = end;
    while slot_ix < deeper {
        let middle = slot_ix + (deeper - slot_ix) / 2u;
        if flats[gaussian_of_slot[middle]].depth <= depth {
            slot_ix = middle + 1u;
        } else {
            deeper = middle;
        }
    }
    var seen = Seen(1.0, NO_HIT);
    var strongest = 0.0;
    for (; slot_ix < end; slot_ix++) {
        let other_ix = gaussian_of_slot[slot_ix];
        let ahead = flats[other_ix].depth - depth;
        if ahead > sweep.reach {
            break;
        }
        if other_ix == gaussian_ix || ahead < sweep.clearance * flats[other_ix].thickness + query.w {
            continue;
        }
        let form = flats[other_ix].form;
        let offset = p - flats[other_ix].centre;
        let across = form.x * offset.x + form.y * offset.y;
        let rest = form.z * offset.y;
        let power = across * across + rest * rest;
        if !(power <= flats[other_ix].reach) {
            continue;
        }
        let alpha = min(flats[other_ix].opacity * exp(-power), ALPHA_MAX);
        let weight = seen.transmittance * alpha;
        if weight > strongest {
            strongest = weight;
            seen.hit = other_ix;
        }
        seen.transmittance *= 1.0 - alpha;
        if seen.transmittance < MIN_TRANSMITTANCE {
            seen.transmittance = 0.0;
            break;
        }
    }
    return seen;
}

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    if gaussian_ix >= sweep.n {
        return;
    }
    let query = queries[gaussian_ix];
    var seen = Seen(1.0, NO_HIT);
    // An invalid query meets no occluder.
    if within_reason(query.xyz) && is_finite(query.w) {
        seen = measure(gaussian_ix, query);
    }
    let at = sweep.direction_ix * sweep.n + gaussian_ix;
    transmittances[at] = seen.transmittance;
    hits[at] = seen.hit;
}
