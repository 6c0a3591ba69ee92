// Backward transmittance as a pseudo label (docs/MODEL.md Eq. 14-15): per Gaussian the sums over pixels of w That and of
// w, where That is the product of 1 - alpha over the splats behind.
//
// A workgroup owns a tile, a thread one pixel. A first sweep front to back finds the final transmittance of the pixel. A
// second sweep back to front recovers each weight by division and extends the product behind, eight splats at a time. The
// two outputs of a splat are summed over pixels through workgroup memory (16 KiB for the pairs, 2 KiB for the sums of each
// share of pixels), then added atomically once per tile. There is no early stop: splats behind a saturated pixel still count
// in That. Weights at a transmittance below MIN_LABEL_TRANSMITTANCE are negligible and count as zero, since division cannot
// recover the transmittance there.
#import alpha
#import camera

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> gaussian_of_slot: array<u32>;
@group(0) @binding(3) var<storage, read> first_slot: array<u32>;
@group(0) @binding(4) var<storage, read_write> labels: array<accumulator>;

const WG_SIZE = 256u;
// Splats per batch.
const BATCH = 8u;
const N_SHARES = 32u;
const MIN_LABEL_TRANSMITTANCE = 1e-30;

var<workgroup> sh_pair: array<vec2f, 2048>;
var<workgroup> sh_sum: array<vec2f, 256>;
var<workgroup> sh_footprint: array<Footprint, WG_SIZE>;

// Pairs are stored splat by splat; a share of pixels is every 32nd pixel.
fn sum_batch(local_ix: u32, first: u32, n: u32) {
    let splat = local_ix / N_SHARES;
    var sum = vec2f(0.0);
    for (var p = local_ix % N_SHARES; p < WG_SIZE; p += N_SHARES) {
        sum += sh_pair[splat * WG_SIZE + p];
    }
    sh_sum[local_ix] = sum;
    workgroupBarrier();
    if local_ix < 2u * n {
        let at = (local_ix / 2u) * N_SHARES;
        var total = 0.0;
        for (var k = 0u; k < N_SHARES; k++) {
            total += sh_sum[at + k][local_ix & 1u];
        }
        if total != 0.0 {
            let gaussian_ix = gaussian_of_slot[first + local_ix / 2u];
            accumulate!(labels[2u * gaussian_ix + (local_ix & 1u)], total);
        }
    }
}

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) wid: vec3u, @builtin(local_invocation_index) local_ix: u32) {
    let tile_ix = wid.y * camera.tiles.x + wid.x;
    let tile_first = first_slot[tile_ix];
    let tile_end = first_slot[tile_ix + 1u];
    let pixel = wid.xy * TILE + vec2u(local_ix % TILE, local_ix / TILE);
    let centre = vec2f(pixel) + 0.5;
    let inside = pixel.x < camera.size.x && pixel.y < camera.size.y;
    var transmittance = 1.0;
    var own_end = tile_first;
    for (var first = tile_first; first < tile_end; first += WG_SIZE) {
        let n = min(WG_SIZE, tile_end - first);
        workgroupBarrier();
        if local_ix < n {
            sh_footprint[local_ix] = footprint_of(splats[gaussian_of_slot[first + local_ix]]);
        }
        workgroupBarrier();
        for (var k = 0u; k < n && transmittance >= MIN_LABEL_TRANSMITTANCE; k++) {
            transmittance *= 1.0 - capped(alpha_at(sh_footprint[k], centre));
            own_end = first + k + 1u;
        }
    }
    // That, as a running product.
    var behind = 1.0;
    let n_batches = (tile_end - tile_first + BATCH - 1u) / BATCH;
    for (var batch = n_batches; batch > 0u; batch--) {
        let first = tile_first + (batch - 1u) * BATCH;
        let n = min(BATCH, tile_end - first);
        workgroupBarrier();
        if local_ix < n {
            sh_footprint[local_ix] = footprint_of(splats[gaussian_of_slot[first + local_ix]]);
        }
        workgroupBarrier();
        for (var j = 0u; j < BATCH; j++) {
            let k = BATCH - 1u - j;
            var pair = vec2f(0.0);
            if k < n && inside {
                let alpha = capped(alpha_at(sh_footprint[k], centre));
                if first + k < own_end {
                    transmittance /= 1.0 - alpha;
                    let weight = transmittance * alpha;
                    pair = vec2f(weight * behind, weight);
                }
                behind *= 1.0 - alpha;
            }
            sh_pair[k * WG_SIZE + local_ix] = pair;
        }
        workgroupBarrier();
        sum_batch(local_ix, first, n);
    }
}
