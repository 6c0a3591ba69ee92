// The window of structural similarity: 11 Gaussian taps, sigma 1.5, applied across and then down a square of TILE
// pixels with a border of HALF on all sides; what lies outside the image counts as zero.
#import generated/objective
#import generated/projection

const HALF = SSIM_TAPS / 2u;
// Side of the square with its border, and its pixels; its pixels once blurred across.
const WIDE = TILE + 2u * HALF;
const N_WIDE = WIDE * WIDE;
const N_ACROSS = WIDE * TILE;

// Weights and sums of an image term. Kept in step with `ImageTermUniform` of src/engine/gpu/losses.rs.
struct ImageTerm {
    size: vec2u,
    // First of the branch's three slots among the losses.
    first_slot: u32,
    // 1 / (3 pixels).
    scale: f32,
    // Weights of the absolute error and of 1 - SSIM.
    l1: f32,
    ssim: f32,
    pad_a: u32,
    pad_b: u32,
}

// Row-major place of element `ix` of the square with its border around `origin`, or `n_pixels` when outside.
fn wide_pixel(ix: u32, origin: vec2u, size: vec2u) -> u32 {
    // Unsigned wrap-around makes what lies left or above large.
    let pixel = origin + vec2u(ix % WIDE, ix / WIDE) - HALF;
    return select(size.x * size.y, pixel.y * size.x + pixel.x, pixel.x < size.x && pixel.y < size.y);
}
