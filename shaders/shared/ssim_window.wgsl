// The window of structural similarity: 11 Gaussian taps, sigma 1.5, applied across and then down a square of TILE_SIDE
// pixels with a border of HALF on all sides; what lies outside the image counts as zero.
const TILE_SIDE = 16u;
const TAPS = 11u;
const HALF = 5u;
// Side of the square with its border, and its pixels; its pixels once blurred across.
const WIDE = 26u;
const N_WIDE = 676u;
const N_ACROSS = 416u;
// Normalised exp(-(i - 5)^2 / 4.5).
const WINDOW = array<f32, 11>(
    0.00102838008447911,
    0.00759875813523919,
    0.03600077212843083,
    0.10936068950970002,
    0.21300553771125369,
    0.26601172486179436,
    0.21300553771125369,
    0.10936068950970002,
    0.03600077212843083,
    0.00759875813523919,
    0.00102838008447911,
);

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
