// Tables of the environment as a linear map of its radiance, row by row (docs/MODEL.md, section 4, `M L`).
// A thread owns one float of the tables: threads of one node read the same sparse row and the same radiances.
// No workgroup memory.
const WG_SIZE = 256u;
#import index
#import tables

@group(0) @binding(0) var<uniform> tables: Tables;
@group(0) @binding(1) var<storage, read> radiance: array<f32>;
// Sparse rows: cosine rows of the grid of normals, then prefilter rows level by level. `(texel, bits of the weight)`.
@group(0) @binding(2) var<storage, read> first_entry: array<u32>;
@group(0) @binding(3) var<storage, read> entries: array<vec2u>;
// Y_j of each texel, `[texel][coefficients]`.
@group(0) @binding(4) var<storage, read> harmonics: array<f32>;
@group(0) @binding(5) var<storage, read_write> values: array<f32>;

@compute @workgroup_size(WG_SIZE)
fn main(@builtin(global_invocation_id) gid: vec3u, @builtin(num_workgroups) n_wg: vec3u) {
    let float_ix = invocation_ix(gid, n_wg);
    if float_ix >= arrayLength(&values) {
        return;
    }
    let n_diffuse = 6u * tables.diffuse_n * tables.diffuse_n;
    let diffuse_floats = n_diffuse * 3u * tables.coefficients;
    var sum = 0.0;
    if float_ix < diffuse_floats {
        let coefficient_ix = float_ix % tables.coefficients;
        let channel = float_ix / tables.coefficients % 3u;
        let row = float_ix / (3u * tables.coefficients);
        for (var at = first_entry[row]; at < first_entry[row + 1u]; at++) {
            let texel_ix = entries[at].x;
            let product = radiance[3u * texel_ix + channel] * harmonics[texel_ix * tables.coefficients + coefficient_ix];
            sum += bitcast<f32>(entries[at].y) * product;
        }
    } else {
        let rest = float_ix - diffuse_floats;
        let row = n_diffuse + rest / 3u;
        for (var at = first_entry[row]; at < first_entry[row + 1u]; at++) {
            sum += bitcast<f32>(entries[at].y) * radiance[3u * entries[at].x + rest % 3u];
        }
    }
    values[float_ix] = sum;
}
