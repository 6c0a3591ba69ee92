// Gradient of the image term per pixel: the partial derivatives of ssim.wgsl convolved with the window, which is its own
// transpose, and the sign of the error.
//
// A thread owns a pixel of a 16 x 16 square. Workgroup memory holds one channel of the partial derivatives with the
// window's border (11 KiB) and blurred along rows (7 KiB).
const WG_SIZE = 256u;
#import photo
#import ssim_window

@group(0) @binding(0) var<uniform> term: ImageTerm;
@group(0) @binding(1) var<storage, read> image: array<vec4f>;
@group(0) @binding(2) var<storage, read> photo: array<vec2u>;
@group(0) @binding(3) var<storage, read> partials: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> by_image: array<vec4f>;

var<workgroup> sh_partials: array<vec4f, N_WIDE>;
var<workgroup> sh_across: array<vec4f, N_ACROSS>;

fn blurred(local_ix: u32, origin: vec2u, channel: u32) -> vec4f {
    var window = SSIM_WINDOW;
    let n_pixels = term.size.x * term.size.y;
    for (var ix = local_ix; ix < N_WIDE; ix += WG_SIZE) {
        let pixel_ix = wide_pixel(ix, origin, term.size);
        var value = vec4f(0.0);
        if pixel_ix < n_pixels {
            value = partials[channel * n_pixels + pixel_ix];
        }
        sh_partials[ix] = value;
    }
    workgroupBarrier();
    for (var ix = local_ix; ix < N_ACROSS; ix += WG_SIZE) {
        let first = ix / TILE * WIDE + ix % TILE;
        var sum = vec4f(0.0);
        for (var t = 0u; t < SSIM_TAPS; t++) {
            sum += window[t] * sh_partials[first + t];
        }
        sh_across[ix] = sum;
    }
    workgroupBarrier();
    var sum = vec4f(0.0);
    for (var t = 0u; t < SSIM_TAPS; t++) {
        sum += window[t] * sh_across[local_ix + TILE * t];
    }
    return sum;
}

@compute @workgroup_size(16, 16)
fn main(
    @builtin(global_invocation_id) gid: vec3u,
    @builtin(workgroup_id) wid: vec3u,
    @builtin(local_invocation_index) local_ix: u32,
) {
    let inside = gid.x < term.size.x && gid.y < term.size.y;
    let pixel_ix = select(0u, gid.y * term.size.x + gid.x, inside);
    let a = image[pixel_ix].xyz;
    let b = photo_pixel(pixel_ix, term.photo_white).xyz;
    var g = term.l1 * term.scale * sign(a - b);
    for (var channel = 0u; channel < 3u; channel++) {
        let by = blurred(local_ix, TILE * wid.xy, channel);
        g[channel] += by.x + 2.0 * a[channel] * by.y + b[channel] * by.z;
    }
    if inside {
        by_image[pixel_ix] = vec4f(g, 0.0);
    }
}
