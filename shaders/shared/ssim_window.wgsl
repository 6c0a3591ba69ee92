// The SSIM window: 11 Gaussian taps, sigma 1.5, applied along rows and then along columns of a square of TILE pixels with a
// border of HALF on all sides. Pixels outside the image count as zero.
#import generated/objective
#import generated/projection

const HALF = SSIM_TAPS / 2u;
// Side of the square with its border, and its number of pixels, before and after the blur along rows.
const WIDE = TILE + 2u * HALF;
const N_WIDE = WIDE * WIDE;
const N_ACROSS = WIDE * TILE;

// Weights and sums of an image term. Kept in step with `ImageTermUniform` of crates/engine/src/gpu/objective/mod.rs.
struct ImageTerm {
    size: vec2u,
    // First of the branch's three slots among the losses.
    first_slot: u32,
    // 1 / (3 pixels).
    scale: f32,
    // Weights of the absolute error and of 1 - SSIM.
    l1: f32,
    ssim: f32,
    // Colour of the highest level of the photograph.
    photo_white: f32,
    pad: u32,
}

// Row-major pixel index of element `ix` of the square with border around `origin`, or `n_pixels` outside the image.
fn wide_pixel(ix: u32, origin: vec2u, size: vec2u) -> u32 {
    // Unsigned wrap-around turns coordinates left of or above the image into large ones.
    let pixel = origin + vec2u(ix % WIDE, ix / WIDE) - HALF;
    return select(size.x * size.y, pixel.y * size.x + pixel.x, pixel.x < size.x && pixel.y < size.y);
}
