// Light from the blocked directions of each Gaussian: irradiance, and mean radiance over the blocked directions of its upper
// hemisphere. A thread owns one Gaussian and iterates over the directions: neighbouring threads read neighbouring
// transmittances and hits, and links need no lists. No workgroup memory.
#import gather
#import generated/occlusion
#import index

@group(0) @binding(0) var<uniform> transport: GatherSize;
@group(0) @binding(1) var<storage, read> directions: array<vec4f>;
@group(0) @binding(2) var<storage, read> normals: array<vec4f>;
// [direction][Gaussian].
@group(0) @binding(3) var<storage, read> transmittances: array<f32>;
@group(0) @binding(4) var<storage, read> hits: array<u32>;
@group(0) @binding(5) var<storage, read> emitted: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> gathered: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let gaussian_ix = invocation_ix(gid, n_wg);
    if gaussian_ix >= transport.n {
        return;
    }
    let normal = normals[gaussian_ix].xyz;
    var irradiance = vec3f(0.0);
    var radiance = vec3f(0.0);
    var shares = 0.0;
    for (var direction_ix = 0u; direction_ix < transport.n_directions; direction_ix++) {
        let d = directions[direction_ix].xyz;
        let facing = dot(normal, d);
        let at = direction_ix * transport.n + gaussian_ix;
        let from_ix = hits[at];
        let share = 1.0 - transmittances[at];
        if !(facing > 0.0) || from_ix >= transport.n || share < MIN_BLOCKED_SHARE {
            continue;
        }
        shares += share;
        // Only a face turned to the receiver emits towards it.
        if dot(normals[from_ix].xyz, d) < 0.0 {
            let light = share * emitted[from_ix].xyz;
            irradiance += facing * transport.weight * light;
            radiance += light;
        }
    }
    if shares > 0.0 {
        radiance /= shares;
    }
    let row = 6u * gaussian_ix;
#repeat k 3
    gathered[row + $ku] = irradiance[$k];
    gathered[row + 3u + $ku] = radiance[$k];
#end
}
