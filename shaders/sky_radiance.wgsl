// Mean radiance of a light around each direction of a measurement, from a level of its prefiltered radiance. A thread owns one
// direction. No workgroup memory.
#import cube_grid
#import generated/occlusion
#import index
#import tables

const WG_SIZE = 256u;

@group(0) @binding(0) var<uniform> shape: Tables;
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read> directions: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> radiance: array<vec4f>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let direction_ix = invocation_ix(gid, n_wg);
    if direction_ix >= arrayLength(&radiance) {
        return;
    }
    let group = SKY_SHADOW_LEVEL / 4u;
    let lane = SKY_SHADOW_LEVEL % 4u;
    let taps = cube_taps(shape.specular_n[group][lane], directions[direction_ix].xyz);
    var sum = vec3f(0.0);
#repeat k 4
    {
        let at = shape.specular_first[group][lane] + 3u * taps.node[$k];
        sum += taps.weight[$k] * vec3f(values[at], values[at + 1u], values[at + 2u]);
    }
#end
    radiance[direction_ix] = vec4f(sum, 0.0);
}
