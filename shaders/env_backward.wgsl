// Gradient of the raw environment: the transposed map `M^T g`, the terms on the light itself, and the chain through
// softplus (docs/MODEL.md, sections 4 and 5).
// A workgroup owns one texel. Its threads share the (colour, coefficient) pairs of the diffuse rows and the entries of the
// specular rows, then sum up. A texel has up to 20,000 terms. Workgroup memory holds the partial sums.
const WG_SIZE = 128u;
#import environment
#import index
#import reduce
#import tables

@group(0) @binding(0) var<uniform> tables: Tables;
@group(0) @binding(1) var<uniform> environment: Environment;
@group(0) @binding(2) var<storage, read> globals: array<f32>;
@group(0) @binding(3) var<storage, read> radiance: array<f32>;
@group(0) @binding(4) var<storage, read> upward: array<f32>;
@group(0) @binding(5) var<storage, read> light_derivative: array<f32>;
@group(0) @binding(6) var<storage, read> tables_gradient: array<f32>;
// Transposed rows, two per texel: `(diffuse node, weight)`, then `(specular node of all levels, weight)`.
@group(0) @binding(7) var<storage, read> first_entry: array<u32>;
@group(0) @binding(8) var<storage, read> entries: array<vec2u>;
@group(0) @binding(9) var<storage, read> harmonics: array<f32>;
@group(0) @binding(10) var<storage, read_write> globals_gradient: array<f32>;

// Partial sum of thread `local_ix` of the gradient of a texel of the rotated map.
fn share(texel_ix: u32, local_ix: u32) -> vec3f {
    var sums = vec3f(0.0);
    let coefficients = tables.coefficients;
    for (var pair_ix = local_ix; pair_ix < 3u * coefficients; pair_ix += WG_SIZE) {
        var product = 0.0;
        for (var at = first_entry[2u * texel_ix]; at < first_entry[2u * texel_ix + 1u]; at++) {
            product += bitcast<f32>(entries[at].y) * tables_gradient[entries[at].x * 3u * coefficients + pair_ix];
        }
        let channel = pair_ix / coefficients;
        let g = product * harmonics[texel_ix * coefficients + pair_ix % coefficients];
        sums += select(vec3f(0.0), vec3f(g), vec3u(0u, 1u, 2u) == vec3u(channel));
    }
    let first_specular = tables.specular_first[0].x;
    let end = first_entry[2u * texel_ix + 2u];
    for (var at = first_entry[2u * texel_ix + 1u] + local_ix; at < end; at += WG_SIZE) {
        let first = first_specular + 3u * entries[at].x;
        let g = vec3f(tables_gradient[first], tables_gradient[first + 1u], tables_gradient[first + 2u]);
        sums += bitcast<f32>(entries[at].y) * g;
    }
    return sums;
}

@compute @workgroup_size(WG_SIZE)
fn main(
    @builtin(workgroup_id) wid: vec3u,
    @builtin(num_workgroups) n_wg: vec3u,
    @builtin(local_invocation_index) local_ix: u32,
) {
    let texel_ix = workgroup_ix(wid, n_wg);
    if texel_ix >= environment.n_texels {
        return;
    }
    // Where the light is rotated, a texel contributes to two texels of the rotated map, by the column shift back.
    let back = 2u * environment.width - environment.whole;
    var sums = (1.0 - environment.fraction) * share(texel_beside(texel_ix, back, environment.width), local_ix);
    if environment.fraction != 0.0 {
        sums += environment.fraction * share(texel_beside(texel_ix, back - 1u, environment.width), local_ix);
    }
    let total = workgroup_sum(local_ix, vec4f(sums, 0.0)).xyz;
    if local_ix == 0u {
        let light = vec3f(radiance[3u * texel_ix], radiance[3u * texel_ix + 1u], radiance[3u * texel_ix + 2u]);
        let deviation = sign(light - vec3f((light.r + light.g + light.b) / 3.0));
        let shared_sign = (deviation.r + deviation.g + deviation.b) / 3.0;
        let by_neutrality = environment.neutrality * (deviation - shared_sign);
        let by_above = vec3f(light_derivative[0], light_derivative[1], light_derivative[2]);
        let by_light = total + by_neutrality + by_above * upward[texel_ix];
        let first = environment.first_texel + 3u * texel_ix;
        for (var c = 0u; c < 3u; c++) {
            globals_gradient[first + c] = by_light[c] / (1.0 + exp(-globals[first + c]));
        }
    }
}
