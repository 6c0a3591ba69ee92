// Gradients of the G-buffer and of the light tables from those of both images and of the buffers. A thread owns a pixel of
// a 16 x 16 square: it writes BY_GROUPS groups of its G-buffer gradient (4: Material; all with VISIBILITY).
//
// The diffuse table takes 12 x S sums a pixel, and neighbouring pixels share their four nodes. So the square's pixels are
// sorted by cell in workgroup memory (weights, gradient and cell a pixel: 10 KiB), then each thread owns one (tap, colour,
// four coefficients), walks the sorted pixels, and adds to memory only where the cell changes. Visibility is read again
// from the G-buffer, which the square has just brought into the cache: it would not fit beside the rest.
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
// Sums a cell takes, in quads, and how many threads share one.
const N_OUTPUTS = 12u * N_QUADS;
const N_STRIPS = WG_SIZE / N_OUTPUTS;

// First node of the pixel's diffuse cell, or NO_CELL when it adds nothing.
var<workgroup> sh_cell: array<u32, WG_SIZE>;
var<workgroup> sh_weight: array<vec4f, WG_SIZE>;
// Gradient by irradiance; 1 / coverage.
var<workgroup> sh_by: array<vec4f, WG_SIZE>;
var<workgroup> sh_pixel_of_place: array<u32, WG_SIZE>;

fn add_quad(at: u32, value: vec4f) {
#repeat k 4
    if value[$k] != 0.0 {
        accumulate!(by_tables[at + $ku], value[$k]);
    }
#end
}

fn add_specular(level: u32, taps: Taps, by_light: vec3f) {
#repeat k 4
    {
        let at = specular_start(level) + 3u * taps.node[$k];
        let value = taps.weight[$k] * by_light;
#repeat c 3
        if value[$c] != 0.0 {
            accumulate!(by_tables[at + $cu], value[$c]);
        }
#end
    }
#end
}

// The sums of one cell by one output of N_OUTPUTS.
fn flush(cell: u32, output: u32, value: vec4f) {
    let tap = output / (3u * N_QUADS);
    let node = cell + select(0u, 1u, (tap & 1u) != 0u) + select(0u, tables.diffuse_n, tap > 1u);
    let row = node * 3u + (output / N_QUADS) % 3u;
    add_quad(row * tables.coefficients + 4u * (output % N_QUADS), value);
}

// What a pixel's share of the diffuse table is multiplied by: its visibility, or one number for it.
fn shared_quad(pixel_ix: u32, quad: u32, inverse: f32) -> vec4f {
    if is_scalar() {
        return vec4f(select(0.0, FULLY_OPEN, quad == 0u), 0.0, 0.0, 0.0);
    }
    return pixel_visibility(pixel_ix, quad, inverse);
}

fn add_diffuse(local_ix: u32, origin: vec2u) {
    let strip = local_ix / N_OUTPUTS;
    if strip >= N_STRIPS {
        return;
    }
    let output = local_ix % N_OUTPUTS;
    let tap = output / (3u * N_QUADS);
    let colour = (output / N_QUADS) % 3u;
    let quad = output % N_QUADS;
    var cell = NO_CELL;
    var sum = vec4f(0.0);
    for (var place = strip * WG_SIZE / N_STRIPS; place < (strip + 1u) * WG_SIZE / N_STRIPS; place++) {
        let other_ix = sh_pixel_of_place[place];
        if sh_cell[other_ix] != cell {
            if cell != NO_CELL {
                flush(cell, output, sum);
            }
            cell = sh_cell[other_ix];
            sum = vec4f(0.0);
            // Pixels that add nothing come last.
            if cell == NO_CELL {
                break;
            }
        }
        let by = sh_by[other_ix];
        let pixel = origin + vec2u(other_ix % 16u, other_ix / 16u);
        let value = shared_quad(pixel.y * view.size.x + pixel.x, quad, by.w);
        sum += (sh_weight[other_ix][tap] * by[colour]) * value;
    }
    if cell != NO_CELL {
        flush(cell, output, sum);
    }
}

// Everything of one pixel but the diffuse table, for which it leaves its share in workgroup memory.
fn pixel_backward(pixel: vec2u, local_ix: u32) {
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
        add_specular(f.position.level, f.level_taps[0], by.level[0]);
        add_specular(f.position.level + 1u, f.level_taps[1], by.level[1]);
        if any(by.irradiance != vec3f(0.0)) {
            sh_cell[local_ix] = f.diffuse_taps.node.x;
            sh_weight[local_ix] = f.diffuse_taps.weight;
            sh_by[local_ix] = vec4f(by.irradiance, inverse);
        }
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
}

@compute @workgroup_size(16, 16)
fn main(
    @builtin(global_invocation_id) gid: vec3u,
    @builtin(workgroup_id) wid: vec3u,
    @builtin(local_invocation_index) local_ix: u32,
) {
    sh_cell[local_ix] = NO_CELL;
    if gid.x < view.size.x && gid.y < view.size.y {
        pixel_backward(gid.xy, local_ix);
    }
    workgroupBarrier();
    // Place of this pixel in the order of cells, ties by index: a count, since 256 keys are few.
    let cell = sh_cell[local_ix];
    var place = 0u;
    for (var other_ix = 0u; other_ix < WG_SIZE; other_ix++) {
        let other = sh_cell[other_ix];
        place += select(0u, 1u, other < cell || (other == cell && other_ix < local_ix));
    }
    sh_pixel_of_place[place] = local_ix;
    workgroupBarrier();
    add_diffuse(local_ix, 16u * wid.xy);
}
