// SSIM of an image and a photograph (Eq. 30): sums of SSIM, absolute and squared error, and the partial
// derivatives of -ssim * scale * SSIM by the three window statistics that depend on the image.
//
// A thread owns a pixel of a 16 x 16 square. Workgroup memory holds one channel of both images with the window's border
// (5 KiB) and its five statistics blurred along rows (8 KiB), so that both passes of the separable window stay on the chip.
// Channels run one after another, because three at once would halve the number of resident workgroups.
const WG_SIZE = 256u;
#import photo
#import ssim_window
#import generated/slots
#import reduce

@group(0) @binding(0) var<uniform> term: ImageTerm;
@group(0) @binding(1) var<storage, read> image: array<vec4f>;
@group(0) @binding(2) var<storage, read> photo: array<vec2u>;
// `[channel][pixel]`: derivatives by mean, by mean square and by mean product; w unused.
@group(0) @binding(3) var<storage, read_write> partials: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> losses: array<accumulator>;

// Image and photograph.
var<workgroup> sh_pair: array<vec2f, N_WIDE>;
// Blurred along rows: image, photograph; their squares; their product.
var<workgroup> sh_means: array<vec2f, N_ACROSS>;
var<workgroup> sh_squares: array<vec2f, N_ACROSS>;
var<workgroup> sh_products: array<f32, N_ACROSS>;

fn load_channel(local_ix: u32, origin: vec2u, channel: u32) {
    for (var ix = local_ix; ix < N_WIDE; ix += WG_SIZE) {
        let pixel_ix = wide_pixel(ix, origin, term.size);
        var pair = vec2f(0.0);
        if pixel_ix < term.size.x * term.size.y {
            pair = vec2f(image[pixel_ix][channel], photo_pixel(pixel_ix, term.photo_white)[channel]);
        }
        sh_pair[ix] = pair;
    }
}

fn blur_across(local_ix: u32) {
    var window = SSIM_WINDOW;
    for (var ix = local_ix; ix < N_ACROSS; ix += WG_SIZE) {
        let first = ix / TILE * WIDE + ix % TILE;
        var means = vec2f(0.0);
        var squares = vec2f(0.0);
        var product = 0.0;
        for (var t = 0u; t < SSIM_TAPS; t++) {
            let pair = sh_pair[first + t];
            let weighted = window[t] * pair;
            means += weighted;
            squares += weighted * pair;
            product += weighted.x * pair.y;
        }
        sh_means[ix] = means;
        sh_squares[ix] = squares;
        sh_products[ix] = product;
    }
}

// SSIM in x, and its derivatives by mean, mean square and mean product of the image.
fn similarity(local_ix: u32) -> vec4f {
    var window = SSIM_WINDOW;
    var m = vec2f(0.0);
    var squares = vec2f(0.0);
    var product = 0.0;
    for (var t = 0u; t < SSIM_TAPS; t++) {
        let ix = local_ix + TILE * t;
        m += window[t] * sh_means[ix];
        squares += window[t] * sh_squares[ix];
        product += window[t] * sh_products[ix];
    }
    let variance = squares - m * m;
    let covariance = product - m.x * m.y;
    let n1 = 2.0 * m.x * m.y + SSIM_C1;
    let n2 = 2.0 * covariance + SSIM_C2;
    let d1 = dot(m, m) + SSIM_C1;
    let d2 = variance.x + variance.y + SSIM_C2;
    let s = n1 * n2 / (d1 * d2);
    let by_covariance = 2.0 * n1 / (d1 * d2);
    let by_variance = -s / d2;
    let by_mean = 2.0 * m.y * n2 / (d1 * d2) - 2.0 * m.x * s / d1;
    return vec4f(s, by_mean - 2.0 * m.x * by_variance - m.y * by_covariance, by_variance, by_covariance);
}

@compute @workgroup_size(16, 16)
fn main(
    @builtin(global_invocation_id) gid: vec3u,
    @builtin(workgroup_id) wid: vec3u,
    @builtin(local_invocation_index) local_ix: u32,
) {
    let origin = TILE * wid.xy;
    let inside = gid.x < term.size.x && gid.y < term.size.y;
    let n_pixels = term.size.x * term.size.y;
    let pixel_ix = gid.y * term.size.x + gid.x;
    let own = (local_ix / TILE + HALF) * WIDE + local_ix % TILE + HALF;
    // Absolute error, squared error, SSIM.
    var sums = vec4f(0.0);
    for (var channel = 0u; channel < 3u; channel++) {
        load_channel(local_ix, origin, channel);
        workgroupBarrier();
        let difference = sh_pair[own].x - sh_pair[own].y;
        blur_across(local_ix);
        workgroupBarrier();
        if inside {
            let found = similarity(local_ix);
            partials[channel * n_pixels + pixel_ix] = vec4f(-term.ssim * term.scale * found.yzw, 0.0);
            sums += vec4f(abs(difference), difference * difference, found.x, 0.0);
        }
    }
    let total = term.scale * workgroup_sum(local_ix, sums);
    if local_ix == 0u {
        accumulate!(losses[term.first_slot + LOSS_PHYSICAL_L1], total.x);
        accumulate!(losses[term.first_slot + LOSS_PHYSICAL_SQUARED], total.y);
        accumulate!(losses[term.first_slot + LOSS_PHYSICAL_SSIM], total.z);
    }
}
