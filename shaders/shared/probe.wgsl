// Shared code of the probe kernels (docs/MODEL.md, section 6): Gaussians as occluders, seen along a direction, and the grid of
// cells, over the plane perpendicular to it, that lists them. All kernels compute cells here, so that counting, emission and
// queries agree. The choice of grid changes no result: a cell lists all footprints that overlap it, and points outside the
// grid belong to its outermost cells.
#import finite
#import generated/occlusion
#import splat

const WG_SIZE = 256u;
// Points with larger coordinates, far outside any scene, are not measured: the squares would not stay finite.
const FAR_OUT = 1e10;

// Kept in step with `Sweep` of crates/engine/src/gpu/probes/sweep.rs.
struct Sweep {
    // Number of Gaussians.
    n: u32,
    n_directions: u32,
    direction_ix: u32,
    // Cells along an edge of the grid, 1..=256.
    side: u32,
    // Number of (Gaussian, cell) pairs of this direction.
    n_instances: u32,
    // Smallest distance of an occluder along the direction, in its own standard deviations.
    clearance: f32,
    // Largest distance of an occluder.
    reach: f32,
    pad: u32,
}

// An orthonormal basis: two vectors perpendicular to the direction, and the direction itself; w is unused.
struct Frame {
    u: vec4f,
    v: vec4f,
    d: vec4f,
}

struct Occluder {
    mean: vec3f,
    // 0: hides nothing.
    opacity: f32,
    // Axes times standard deviations; w is unused.
    axes: array<vec4f, 3>,
}

// A Gaussian seen along a direction, 48 bytes.
struct Flat {
    centre: vec2f,
    depth: f32,
    // Standard deviation along the direction.
    thickness: f32,
    // The exponent at `centre + (x, y)` is `(form.x x + form.y y)^2 + (form.z y)^2`.
    form: vec3f,
    opacity: f32,
    // Largest exponent at which alpha still counts.
    reach: f32,
    // First column, first row, last column, last row: a byte each.
    cells: u32,
    // Number of these cells. 0: hides nothing along this direction, and no other member may be read.
    n_cells: u32,
    pad: u32,
}

struct PlaneGrid {
    origin: vec2f,
    // Cells per unit.
    inverse_size: vec2f,
    // Last column and row.
    last: f32,
}

fn all_finite3(v: vec3f) -> bool {
    return is_finite(v.x) && is_finite(v.y) && is_finite(v.z);
}

fn within_reason(v: vec3f) -> bool {
    return all_finite3(v) && all(abs(v) <= vec3f(FAR_OUT));
}

// The grid on the plane of `frame` over the box `lo..hi`. A side is at least a quarter of the other: where all footprints
// overlap along one side, narrower cells would repeat the same lists.
fn plane_grid(frame: Frame, lo: vec3f, hi: vec3f, side: u32) -> PlaneGrid {
    let middle = 0.5 * (lo + hi);
    let half = 0.5 * (hi - lo);
    var extent = vec2f(dot(half, abs(frame.u.xyz)), dot(half, abs(frame.v.xyz)));
    extent = max(extent, vec2f(max(0.25 * max(extent.x, extent.y), 1e-12)));
    let centre = vec2f(dot(middle, frame.u.xyz), dot(middle, frame.v.xyz));
    return PlaneGrid(centre - extent, f32(side) / (2.0 * extent), f32(side - 1u));
}

// Column and row of a point.
fn cell_at(grid: PlaneGrid, p: vec2f) -> vec2u {
    return vec2u(clamp((p - grid.origin) * grid.inverse_size, vec2f(0.0), vec2f(grid.last)));
}

// Unsigned integers in the order of the floats, for both signs.
fn sortable(x: f32) -> u32 {
    let bits = bitcast<u32>(x);
    return bits ^ select(0x80000000u, 0xffffffffu, (bits >> 31u) != 0u);
}

fn float_of_sortable(key: u32) -> f32 {
    return bitcast<f32>(key ^ select(0xffffffffu, 0x80000000u, (key >> 31u) != 0u));
}

// The determinant is computed as the squared length of a cross product plus the terms of the widening, all positive: for
// needles `uu vv - uv^2` is the difference of two large numbers.
fn flatten(o: Occluder, frame: Frame, grid: PlaneGrid) -> Flat {
    var flat: Flat;
    flat.n_cells = 0u;
    flat.pad = 0u;
    if !(o.opacity >= ALPHA_MIN) {
        return flat;
    }
    let axes = mat3x3f(o.axes[0].xyz, o.axes[1].xyz, o.axes[2].xyz);
    let x = frame.u.xyz * axes;
    let y = frame.v.xyz * axes;
    let along = frame.d.xyz * axes;
    let narrow = vec2f(dot(x, x), dot(y, y));
    if !(narrow.x < MAX_OCCLUDER_VARIANCE && narrow.y < MAX_OCCLUDER_VARIANCE) {
        return flat;
    }
    // Without the widening a disc seen edge-on would have width 0.
    let sum = narrow.x + narrow.y;
    let widening = 1e-4 * sum + 1e-14;
    let area = cross(x, y);
    let determinant = dot(area, area) + widening * sum + widening * widening;
    let variance = narrow + widening;
    let root = sqrt(variance.y / determinant);
    flat.form = 0.70710678 * vec3f(root, -dot(x, y) / determinant / root, inverseSqrt(variance.y));
    flat.opacity = o.opacity;
    flat.reach = log(o.opacity / ALPHA_MIN);
    flat.centre = vec2f(dot(o.mean, frame.u.xyz), dot(o.mean, frame.v.xyz));
    flat.depth = dot(o.mean, frame.d.xyz);
    flat.thickness = length(along);
    // Slightly larger than needed, so that rounding never omits a cell.
    let extent = 1.0001 * sqrt(2.0 * max(flat.reach, 0.0) * variance) + 1e-6 * abs(flat.centre);
    let first = cell_at(grid, flat.centre - extent);
    let last = cell_at(grid, flat.centre + extent);
    flat.cells = first.x | (first.y << 8u) | (last.x << 16u) | (last.y << 24u);
    flat.n_cells = (last.x - first.x + 1u) * (last.y - first.y + 1u);
    return flat;
}
