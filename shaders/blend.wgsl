// Blends splats front to back into the G-buffer (docs/MODEL.md Eq. 4-5), GROUPS vec4 of channels at once.
//
// A workgroup owns a tile of 16 x 16 pixels, a thread one pixel and its 4 GROUPS sums, which stay in registers (one
// variable per group, unrolled). Workgroup memory holds a batch of the tile's splats: footprints and attribute rows, which
// all threads read at the same address. BATCH limits it to 20 KiB: enough loads in flight, several workgroups per core.
// Threads whose pixel is saturated leave the batch; the workgroup stops when all have left.
// The kernel also writes the last slot and the transmittance of each pixel: the backward pass recovers the rest by division.
#import alpha
#import camera

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> blending: Blending;
@group(0) @binding(2) var<storage, read> splats: array<Splat>;
@group(0) @binding(3) var<storage, read> attributes: array<vec4f>;
@group(0) @binding(4) var<storage, read> gaussian_of_slot: array<u32>;
@group(0) @binding(5) var<storage, read> first_slot: array<u32>;
@group(0) @binding(6) var<storage, read_write> gbuffer: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> ends: array<BlendEnd>;

const WG_SIZE = 256u;

struct Blending {
    // Blending stops at a pixel whose transmittance is below this.
    least_transmittance: f32,
    pad_a: u32,
    pad_b: u32,
    pad_c: u32,
}

var<workgroup> sh_footprint: array<Footprint, BATCH>;
var<workgroup> sh_attributes: array<vec4f, BATCH * GROUPS>;
var<workgroup> sh_n_live: atomic<u32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) wid: vec3u, @builtin(local_invocation_index) local_ix: u32) {
    let tile_ix = wid.y * camera.tiles.x + wid.x;
    let first = first_slot[tile_ix];
    let end = first_slot[tile_ix + 1u];
    let pixel = wid.xy * TILE + vec2u(local_ix % TILE, local_ix / TILE);
    let centre = vec2f(pixel) + 0.5;
    let inside = pixel.x < camera.size.x && pixel.y < camera.size.y;
    if local_ix == 0u {
        atomicStore(&sh_n_live, 0u);
    }
    workgroupBarrier();
    if inside {
        atomicAdd(&sh_n_live, 1u);
    }
    var live = inside;
    var transmittance = 1.0;
    var end_slot = first;
#repeat g GROUPS
    var sum_$g = vec4f(0.0);
#end
    for (var batch = first; batch < end; batch += BATCH) {
        // The barriers of the load also ensure that the last batch has been read.
        if workgroupUniformLoad(&sh_n_live) == 0u {
            break;
        }
        let n = min(BATCH, end - batch);
        if local_ix < n {
            sh_footprint[local_ix] = footprint_of(splats[gaussian_of_slot[batch + local_ix]]);
        }
        for (var at = local_ix; at < n * GROUPS; at += WG_SIZE) {
            sh_attributes[at] = attributes[gaussian_of_slot[batch + at / GROUPS] * GROUPS + at % GROUPS];
        }
        workgroupBarrier();
        for (var k = 0u; k < n && live; k++) {
            let alpha = capped(alpha_at(sh_footprint[k], centre));
            if alpha > 0.0 {
                let weight = transmittance * alpha;
#repeat g GROUPS
                sum_$g += weight * sh_attributes[k * GROUPS + $gu];
#end
                transmittance *= 1.0 - alpha;
                end_slot = batch + k + 1u;
                if !(transmittance >= blending.least_transmittance) {
                    live = false;
                    atomicSub(&sh_n_live, 1u);
                }
            }
        }
    }
    if inside {
        let pixel_ix = pixel.y * camera.size.x + pixel.x;
#repeat g GROUPS
        gbuffer[$gu * camera.n_pixels + pixel_ix] = sum_$g;
#end
        ends[pixel_ix] = BlendEnd(transmittance, end_slot);
    }
}
