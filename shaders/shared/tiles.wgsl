// The tiles that a splat reaches. Counting and emission share this code, so that both find the same tiles.
//
// A splat reaches the pixels with `d^T C d <= 2 reach`, an ellipse. Its part between the first and the last pixel row of
// a row of tiles is convex, so it covers an interval of x, and the tiles whose pixel centres lie in that interval are
// exactly those that the ellipse reaches. No tile needs a test of its own.
#import splat
#import camera

// Tolerance for rounding of an ellipse's edge, pixels: an extra tile costs little, a missing tile leaves a hole.
const TILE_SLACK = 1e-3;

// First tile and the one after the last, along one axis, that a pixel centre in `lo..hi` (pixels) lies in.
fn tile_span(lo: f32, hi: f32, n: u32) -> vec2u {
    let side = f32(TILE);
    let slack = TILE_SLACK + 1e-6 * max(abs(lo), abs(hi));
    let first = ceil((lo - slack - (side - 0.5)) / side);
    let end = floor((hi + slack - 0.5) / side) + 1.0;
    let span = vec2u(clamp(vec2f(first, end), vec2f(0.0), vec2f(f32(n))));
    return vec2u(span.x, max(span.x, span.y));
}

// Rows of tiles under the splat: first and end.
fn tile_rows(s: Splat, camera: Camera) -> vec2u {
    let extent = sqrt(2.0 * max(s.reach, 0.0) * s.covariance.z);
    return tile_span(s.mean.y - extent, s.mean.y + extent, camera.tiles.y);
}

// Columns of tiles that the splat reaches in a row of tiles: first and end.
fn tile_columns(s: Splat, camera: Camera, row: u32) -> vec2u {
    let reach = 2.0 * max(s.reach, 0.0);
    let extent = sqrt(reach * s.covariance.z);
    let top = f32(row * TILE) + 0.5 - s.mean.y;
    let lo = clamp(top, -extent, extent);
    let hi = clamp(top + f32(TILE - 1u), -extent, extent);
    // The ellipse is widest to the right at height `turn`, to the left at -turn.
    let turn = s.covariance.y * sqrt(reach / s.covariance.x);
    let y = vec2f(clamp(-turn, lo, hi), clamp(turn, lo, hi));
    // Half its width at height y is sqrt((2 reach - y^2 / yy) / a) with a = yy / determinant = conic.x.
    let half = sqrt(max(vec2f(reach) - y * y / s.covariance.z, vec2f(0.0)) / s.conic.x);
    let middle = s.mean.x + y * (s.covariance.y / s.covariance.z);
    return tile_span(middle.x - half.x, middle.y + half.y, camera.tiles.x);
}
