// Backward pass of the blending: gradients of each splat from the pixels of its tiles, GROUPS vec4 of channels.
//
// A workgroup owns a tile, a thread one pixel. Splats are processed 16 at a time, from the last that counted to the first. A
// pixel recovers each transmittance by division, starting from the end of its blending. With s = <attributes, gradient> of a
// splat in a pixel, the gradient by alpha is T s - (sum of w s behind) / (1 - alpha).
//
// The sums over pixels are small matrix products. All threads write the 256 x 16 weights to `sh_matrix`. The gradients of
// attributes are the product of this matrix with the 256 x 4 GROUPS gradients: a thread sums 4 splats x 4 channels over a
// share of the pixels (16 products for each pair of loads), the shares are added up in `sh_matrix` again, and each output
// needs one atomic addition per tile. The same memory then holds the alpha gradients, which are multiplied with the moments
// 1, dx, dy, dx^2, dx dy, dy^2 of the pixels about the splat's mean; mean, conic and opacity follow from those. A seventh
// sum is absgrad: the length of each pixel's gradient by the mean, the signal of density control (AbsGS, Ye et al. 2024).
// Separate workgroup sums of each of the 8 + 4 GROUPS outputs would need some barriers per output; this needs a few barriers
// per 16 splats and no subgroup operations.
//
// Workgroup memory: `sh_matrix` 16 KiB, moments 7 KiB, attributes 256 B per group, footprints 0.5 KiB: at most 28 KiB.
// Rows of `sh_matrix` are rotated by half the pixel index, so that neither adjacent pixels (writing) nor adjacent groups of
// four splats (reading) conflict in a memory bank. A pixel's own gradient stays in registers. The matrix product reads the
// gradients of other pixels from memory, where the tile's share (4 KiB per group) stays in the cache.
#import alpha
#import generated/channels
#import camera

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> size: BackwardSize;
@group(0) @binding(2) var<storage, read> splats: array<Splat>;
@group(0) @binding(3) var<storage, read> attributes: array<vec4f>;
@group(0) @binding(4) var<storage, read> gaussian_of_slot: array<u32>;
@group(0) @binding(5) var<storage, read> first_slot: array<u32>;
@group(0) @binding(6) var<storage, read> ends: array<BlendEnd>;
@group(0) @binding(7) var<storage, read> by_gbuffer: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> splat_gradients: array<accumulator>;

struct BackwardSize {
    // Groups per attribute row; the first GROUPS of them are differentiated.
    n_attribute_groups: u32,
    pad_a: u32,
    pad_b: u32,
    pad_c: u32,
}

const WG_SIZE = 256u;
// Splats per batch; also 4 vectors of 4.
const BATCH = 16u;
const ROW = GRADIENT_HEADER + 4u * GROUPS;
// Number of (4 splats, 4 channels) blocks; the next constant is the number of threads that share the pixels of a block.
const N_BLOCKS = 4u * GROUPS;
const N_SHARES = WG_SIZE / N_BLOCKS;
const N_MOMENTS = 7u;

var<workgroup> sh_matrix: array<vec4f, 1024>;
var<workgroup> sh_moments: array<f32, 1792>;
var<workgroup> sh_attributes: array<vec4f, BATCH * GROUPS>;
var<workgroup> sh_footprint: array<Footprint, BATCH>;
var<workgroup> sh_end: atomic<u32>;

// Index of the weights of splats 4 quad .. 4 quad + 3 in a pixel.
fn matrix_ix(pixel_local: u32, quad: u32) -> u32 {
    return pixel_local * 4u + ((quad + (pixel_local >> 1u)) & 3u);
}

fn pixel_of(tile: vec2u, pixel_local: u32) -> vec2u {
    return tile * TILE + vec2u(pixel_local % TILE, pixel_local / TILE);
}

// Gradient of group `group` in a pixel of the tile; zero outside the image.
fn gradient_at(tile: vec2u, pixel_local: u32, group: u32) -> vec4f {
    let pixel = pixel_of(tile, pixel_local);
    if pixel.x >= camera.size.x || pixel.y >= camera.size.y {
        return vec4f(0.0);
    }
    return by_gbuffer[group * camera.n_pixels + pixel.y * camera.size.x + pixel.x];
}

// Adds to the gradient rows of the batch: `sh_matrix` holds the weights.
fn attribute_gradients(tile: vec2u, local_ix: u32, first: u32, n: u32) {
    let block = local_ix % N_BLOCKS;
    let share = local_ix / N_BLOCKS;
    let quad = block & 3u;
    let group = block >> 2u;
#repeat s 4
    var sum_$s = vec4f(0.0);
#end
    if share < N_SHARES {
        for (var p = share; p < WG_SIZE; p += N_SHARES) {
            let w = sh_matrix[matrix_ix(p, quad)];
            let g = gradient_at(tile, p, group);
#repeat s 4
            sum_$s += w[$s] * g;
#end
        }
    }
    workgroupBarrier();
#repeat s 4
    sh_matrix[local_ix * 4u + $su] = sum_$s;
#end
    workgroupBarrier();
    for (var output = local_ix; output < BATCH * 4u * GROUPS; output += WG_SIZE) {
        let splat = output / (4u * GROUPS);
        let channel = output % (4u * GROUPS);
        if splat < n {
            // The lowest bits of a block's index are the quad.
            let column = ((channel >> 2u) * 4u + (splat >> 2u)) * 4u + (splat & 3u);
            var total = 0.0;
            for (var k = 0u; k < N_SHARES; k++) {
                total += sh_matrix[k * N_BLOCKS * 4u + column][channel & 3u];
            }
            if total != 0.0 {
                let row = gaussian_of_slot[first + splat] * ROW;
                accumulate!(splat_gradients[row + GRADIENT_HEADER + channel], total);
            }
        }
    }
    workgroupBarrier();
}

// Adds to the headers of the batch's gradient rows: `sh_matrix` holds dL/d alpha times alpha.
fn geometry_gradients(tile: vec2u, local_ix: u32, first: u32, n: u32) {
    let splat = local_ix % BATCH;
    let share = local_ix / BATCH;
    let mean = sh_footprint[splat].place.xy;
    var one = 0.0;
    var d_one = vec2f(0.0);
    // xx, xy, yy.
    var d_two = vec3f(0.0);
    var absgrad = 0.0;
    if splat < n {
        let conic = splats[gaussian_of_slot[first + splat]].conic;
        // A share is a row of pixels.
        for (var column = 0u; column < TILE; column++) {
            let p = share * TILE + column;
            let flow = sh_matrix[matrix_ix(p, splat >> 2u)][splat & 3u];
            let d = vec2f(pixel_of(tile, p)) + 0.5 - mean;
            let flow_d = flow * d;
            one += flow;
            d_one += flow_d;
            d_two += vec3f(flow_d.x * d.x, flow_d.x * d.y, flow_d.y * d.y);
            absgrad += length(vec2f(dot(conic.xy, d), dot(conic.yz, d))) * abs(flow);
        }
    }
    sh_moments[0u * WG_SIZE + local_ix] = one;
    sh_moments[1u * WG_SIZE + local_ix] = d_one.x;
    sh_moments[2u * WG_SIZE + local_ix] = d_one.y;
    sh_moments[3u * WG_SIZE + local_ix] = d_two.x;
    sh_moments[4u * WG_SIZE + local_ix] = d_two.y;
    sh_moments[5u * WG_SIZE + local_ix] = d_two.z;
    sh_moments[6u * WG_SIZE + local_ix] = absgrad;
    workgroupBarrier();
    // A thread sums one moment of one splat over the rows, into the first row.
    if local_ix < BATCH * N_MOMENTS {
        let at = (local_ix / BATCH) * WG_SIZE + local_ix % BATCH;
        var total = 0.0;
        for (var k = 0u; k < TILE; k++) {
            total += sh_moments[at + k * BATCH];
        }
        sh_moments[at] = total;
    }
    workgroupBarrier();
    if local_ix < BATCH * N_MOMENTS && splat < n {
        let gaussian_ix = gaussian_of_slot[first + splat];
        let output = local_ix / BATCH;
        let total = header_entry(gaussian_ix, splat, output);
        if total != 0.0 {
            accumulate!(splat_gradients[gaussian_ix * ROW + output], total);
        }
    }
}

// Entry of a gradient row's header (mean x, y, conic xx, xy, yy, opacity, absgrad) from the sums.
fn header_entry(gaussian_ix: u32, splat: u32, output: u32) -> f32 {
    if output < 2u {
        let conic = splats[gaussian_ix].conic;
        let row = select(conic.yz, conic.xy, output == 0u);
        return row.x * sh_moments[WG_SIZE + splat] + row.y * sh_moments[2u * WG_SIZE + splat];
    }
    if output == 5u {
        return sh_moments[splat] / splats[gaussian_ix].opacity;
    }
    if output == 6u {
        return sh_moments[6u * WG_SIZE + splat];
    }
    let factor = select(-0.5, -1.0, output == 3u);
    return factor * sh_moments[(output + 1u) * WG_SIZE + splat];
}

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) wid: vec3u, @builtin(local_invocation_index) local_ix: u32) {
    let tile = wid.xy;
    let tile_ix = tile.y * camera.tiles.x + tile.x;
    let tile_first = first_slot[tile_ix];
    let pixel = pixel_of(tile, local_ix);
    let centre = vec2f(pixel) + 0.5;
    if local_ix == 0u {
        atomicStore(&sh_end, tile_first);
    }
    workgroupBarrier();
    var own_end = tile_first;
    var transmittance = 1.0;
    var is_active = false;
#repeat g GROUPS
    let gradient_$g = gradient_at(tile, local_ix, $gu);
    is_active = is_active || any(gradient_$g != vec4f(0.0));
#end
    if is_active {
        let end = ends[pixel.y * camera.size.x + pixel.x];
        // Clamped, so that a stale buffer cannot lead out of the tile.
        own_end = clamp(end.slot, tile_first, first_slot[tile_ix + 1u]);
        transmittance = end.transmittance;
        atomicMax(&sh_end, own_end);
    }
    let tile_end = workgroupUniformLoad(&sh_end);
    // Sum of w s over the splats behind.
    var behind = 0.0;
    let n_batches = (tile_end - tile_first + BATCH - 1u) / BATCH;
    for (var batch = n_batches; batch > 0u; batch--) {
        let first = tile_first + (batch - 1u) * BATCH;
        let n = min(BATCH, tile_end - first);
        if local_ix < n {
            sh_footprint[local_ix] = footprint_of(splats[gaussian_of_slot[first + local_ix]]);
        }
        for (var at = local_ix; at < n * GROUPS; at += WG_SIZE) {
            let row = gaussian_of_slot[first + at / GROUPS] * size.n_attribute_groups;
            sh_attributes[at] = attributes[row + at % GROUPS];
        }
        workgroupBarrier();
#repeat a 4
        var weight_$a = vec4f(0.0);
        var flow_$a = vec4f(0.0);
#end
        // Back to front: `weight_0` and `flow_0` belong to the batch's last quad. Values are shifted in, so that no vector is
        // indexed at run time and the loop over a quad need not be unrolled.
#repeat a 4
        for (var b = 0u; b < 4u; b++) {
            let k = 15u - 4u * $au - b;
            var weight = 0.0;
            var flow = 0.0;
            if first + k < own_end {
                let free = alpha_at(sh_footprint[k], centre);
                if free > 0.0 {
                    let alpha = capped(free);
                    let inverse = 1.0 / (1.0 - alpha);
                    transmittance *= inverse;
                    var s = 0.0;
#repeat g GROUPS
                    s += dot(sh_attributes[k * GROUPS + $gu], gradient_$g);
#end
                    weight = transmittance * alpha;
                    // The gradient by a capped alpha is zero.
                    flow = select(0.0, (transmittance * s - behind * inverse) * alpha, free < ALPHA_MAX);
                    behind += weight * s;
                }
            }
            weight_$a = vec4f(weight, weight_$a.xyz);
            flow_$a = vec4f(flow, flow_$a.xyz);
        }
#end
#repeat a 4
        sh_matrix[matrix_ix(local_ix, 3u - $au)] = weight_$a;
#end
        workgroupBarrier();
        attribute_gradients(tile, local_ix, first, n);
#repeat a 4
        sh_matrix[matrix_ix(local_ix, 3u - $au)] = flow_$a;
#end
        workgroupBarrier();
        geometry_gradients(tile, local_ix, first, n);
        workgroupBarrier();
    }
}
