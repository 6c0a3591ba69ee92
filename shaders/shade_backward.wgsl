// Gradients of the G-buffer and of the light tables from those of both images and of the buffers. A thread owns a pixel of
// a 16 x 16 square: it writes BY_GROUPS groups of its G-buffer gradient (4: Material; all with VISIBILITY).
//
// A pixel adds to four nodes of the diffuse table, 12 x S sums, and to four of each of two specular levels, and
// neighbouring pixels share their nodes. So for each of the three in turn the square's pixels are sorted by cell in
// workgroup memory (cell, weights, gradient and place a pixel: 10 KiB), then each thread owns one (tap, colour, four
// coefficients), walks the sorted pixels, and adds to memory only where the cell changes. Visibility is read again from the
// G-buffer, which the square has just brought into the cache: it would not fit beside the rest.
const WG_SIZE = 256u;
#import shading_backward
#import pixel_surface

@group(0) @binding(6) var<storage, read> gbuffer: array<vec4f>;
@group(0) @binding(7) var<storage, read> by_physical: array<vec4f>;
@group(0) @binding(8) var<storage, read> by_radiance: array<vec4f>;
// See surface_terms.wgsl.
@group(0) @binding(9) var<storage, read> by_buffers: array<vec4f>;
@group(0) @binding(10) var<storage, read_write> by_gbuffer: array<vec4f>;
@group(0) @binding(11) var<storage, read_write> by_tables: array<accumulator>;

const NO_CELL = 0xffffffffu;
// A cell is its level in the upper 8 bits and its first node below; the grid of normals counts as a level.
const DIFFUSE_LEVEL = 7u;
const NODE_BITS = 24u;

// What a pixel adds to the diffuse table and to the two specular levels.
struct Shares {
    // NO_CELL where it adds nothing.
    cell: vec3u,
    // Bilinear weights of the cell's nodes.
    weight: array<vec4f, 3>,
    // Gradient by what was looked up, rgb.
    by: array<vec3f, 3>,
    // 1 / coverage.
    inverse: f32,
}

var<workgroup> sh_cell: array<u32, WG_SIZE>;
var<workgroup> sh_weight: array<vec4f, WG_SIZE>;
// Gradient by what was looked up; 1 / coverage.
var<workgroup> sh_by: array<vec4f, WG_SIZE>;
var<workgroup> sh_pixel_of_place: array<u32, WG_SIZE>;

fn cell_of(level: u32, taps: Taps, by: vec3f) -> u32 {
    return select(NO_CELL, (level << NODE_BITS) | taps.node.x, any(by != vec3f(0.0)));
}

// First float of the row of one colour of one node of a cell.
fn row_of(cell: u32, tap: u32, colour: u32) -> u32 {
    let level = cell >> NODE_BITS;
    let is_diffuse = level == DIFFUSE_LEVEL;
    let edge = select(specular_nodes(level), tables.diffuse_n, is_diffuse);
    let node = (cell & ((1u << NODE_BITS) - 1u)) + (tap & 1u) + (tap >> 1u) * edge;
    let row = 3u * node + colour;
    return select(specular_start(level) + row, row * tables.coefficients, is_diffuse);
}

fn add_quad(at: u32, value: vec4f) {
    for (var k = 0u; k < 4u; k++) {
        if value[k] != 0.0 {
            accumulate!(by_tables[at + k], value[k]);
        }
    }
}

// What a pixel's share is multiplied by: its visibility, or one number for it.
fn shared_quad(part: u32, pixel_ix: u32, quad: u32, inverse: f32) -> vec4f {
    if part > 0u || is_scalar() {
        return vec4f(select(1.0, FULLY_OPEN, part == 0u), 0.0, 0.0, 0.0);
    }
    return pixel_visibility(pixel_ix, quad, inverse);
}

// Adds the sorted shares of one part: 0 diffuse, 1 and 2 specular.
fn add_part(part: u32, local_ix: u32, origin: vec2u) {
    let n_quads = select(N_QUADS, 1u, part > 0u || is_scalar());
    // Threads that share one output each take a strip of the pixels.
    let n_outputs = 12u * n_quads;
    let n_strips = WG_SIZE / n_outputs;
    let strip = local_ix / n_outputs;
    if strip >= n_strips {
        return;
    }
    let output = local_ix % n_outputs;
    let tap = output / (3u * n_quads);
    let colour = (output / n_quads) % 3u;
    let quad = output % n_quads;
    let end = (strip + 1u) * WG_SIZE / n_strips;
    var cell = NO_CELL;
    var sum = vec4f(0.0);
    for (var place = strip * WG_SIZE / n_strips; place <= end; place++) {
        // One step beyond the end adds what is left.
        let other_ix = sh_pixel_of_place[min(place, WG_SIZE - 1u)];
        let next = select(NO_CELL, sh_cell[other_ix], place < end);
        if next != cell {
            if cell != NO_CELL {
                add_quad(row_of(cell, tap, colour) + 4u * quad, sum);
            }
            cell = next;
            sum = vec4f(0.0);
        }
        // Pixels that add nothing come last.
        if next == NO_CELL {
            break;
        }
        let by = sh_by[other_ix];
        let pixel = origin + vec2u(other_ix % 16u, other_ix / 16u);
        let value = shared_quad(part, pixel.y * view.size.x + pixel.x, quad, by.w);
        sum += (sh_weight[other_ix][tap] * by[colour]) * value;
    }
}

// Writes one pixel's G-buffer gradient; what it adds to the tables.
fn pixel_backward(pixel: vec2u) -> Shares {
    var shares: Shares;
    shares.cell = vec3u(NO_CELL);
    let n = view.n_pixels;
    let pixel_ix = pixel.y * view.size.x + pixel.x;
    let coverage = gbuffer[pixel_ix].x;
    let g = by_physical[pixel_ix].xyz;
    let g_radiance = by_radiance[pixel_ix].xyz;
    let on_geometry = by_buffers[pixel_ix];
    let on_material = by_buffers[n + pixel_ix];
    var by_coverage = on_material.x - dot(g_radiance, shading.background.xyz);
    var inverse = 0.0;
    var by: SurfaceGradient;
    if coverage >= LEAST_COVERAGE {
        inverse = 1.0 / coverage;
        var s = pixel_surface(pixel, pixel_ix, coverage);
        var f = shade(&s);
        let linear = f.diffuse + f.specular;
        by_coverage += dot(g, display(linear) - shading.background.xyz);
        let by_linear = vec3f(
            display_backward(linear.x, g.x * coverage),
            display_backward(linear.y, g.y * coverage),
            display_backward(linear.z, g.z * coverage),
        );
        by = shade_backward(&s, &f, by_linear);
        // Attributes are buffers divided by coverage.
        let along = dot(by.normal, s.normal) + dot(by.albedo, s.albedo) + dot(by.gathered, s.gathered)
            + dot(by.indirect, s.indirect) + by.metal * s.metal + by.rough * s.rough + by.along_visibility;
        by_coverage -= along * inverse;
        shares.cell = vec3u(
            cell_of(DIFFUSE_LEVEL, f.diffuse_taps, by.irradiance),
            cell_of(f.position.level, f.level_taps[0], by.level[0]),
            cell_of(f.position.level + 1u, f.level_taps[1], by.level[1]),
        );
        shares.weight = array<vec4f, 3>(f.diffuse_taps.weight, f.level_taps[0].weight, f.level_taps[1].weight);
        shares.by = array<vec3f, 3>(by.irradiance, by.level[0], by.level[1]);
        shares.inverse = inverse;
    } else {
        by_coverage -= dot(g, shading.background.xyz);
    }
    by_gbuffer[pixel_ix] = vec4f(by_coverage, g_radiance);
    by_gbuffer[n + pixel_ix] = vec4f(by.normal * inverse + on_geometry.xyz, on_geometry.w);
    by_gbuffer[2u * n + pixel_ix] = vec4f(by.albedo, by.metal) * inverse + vec4f(0.0, 0.0, 0.0, on_material.y);
    let by_rough = by.rough * inverse + on_material.z;
#ifdef VISIBILITY
    by_gbuffer[3u * n + pixel_ix] = vec4f(by_rough, 0.0, by.gathered.xy * inverse);
    by_gbuffer[4u * n + pixel_ix] = vec4f(by.gathered.z, by.indirect) * inverse;
    for (var quad = 0u; quad < N_QUADS; quad++) {
        by_gbuffer[(VISIBILITY_GROUP + quad) * n + pixel_ix] = by.visibility[quad] * inverse;
    }
#else
    by_gbuffer[3u * n + pixel_ix] = vec4f(by_rough, 0.0, 0.0, 0.0);
#endif
    return shares;
}

@compute @workgroup_size(16, 16)
fn main(
    @builtin(global_invocation_id) gid: vec3u,
    @builtin(workgroup_id) wid: vec3u,
    @builtin(local_invocation_index) local_ix: u32,
) {
    var shares: Shares;
    shares.cell = vec3u(NO_CELL);
    if gid.x < view.size.x && gid.y < view.size.y {
        shares = pixel_backward(gid.xy);
    }
    for (var part = 0u; part < 3u; part++) {
        let cell = shares.cell[part];
        sh_cell[local_ix] = cell;
        sh_weight[local_ix] = shares.weight[part];
        sh_by[local_ix] = vec4f(shares.by[part], shares.inverse);
        workgroupBarrier();
        // Place of this pixel in the order of cells, ties by index: a count, since 256 keys are few.
        var place = 0u;
        for (var other_ix = 0u; other_ix < WG_SIZE; other_ix++) {
            let other = sh_cell[other_ix];
            place += select(0u, 1u, other < cell || (other == cell && other_ix < local_ix));
        }
        sh_pixel_of_place[place] = local_ix;
        workgroupBarrier();
        add_part(part, local_ix, 16u * wid.xy);
        workgroupBarrier();
    }
}
