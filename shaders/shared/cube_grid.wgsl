// Bilinear look-up in a cube grid over directions, with nodes on the cube's edges: the port of crates/scene/src/light/grid.rs.

// The four nodes around a direction, their weights, and the weights' gradients by the (not necessarily unit) direction.
struct Taps {
    node: vec4u,
    weight: vec4f,
    gradient: array<vec3f, 4>,
}

struct GridCell {
    first: u32,
    fraction: f32,
}

fn grid_cell(n: u32, half: f32, v: f32) -> GridCell {
    let x = (v + 1.0) * half;
    // NaN maps to cell 0.
    let inside = select(0.0, min(x, f32(n)), x > 0.0);
    let first = min(u32(inside), n - 2u);
    return GridCell(first, min(inside - f32(first), 1.0));
}

// Nodes around `d` in a grid of `n` >= 2 nodes along an edge.
fn cube_taps(n: u32, d: vec3f) -> Taps {
    let size = abs(d);
    let x_major = size.x >= size.y && size.x >= size.z;
    let y_major = !x_major && size.y >= size.z;
    let axis = select(select(2u, 1u, y_major), 0u, x_major);
    // (major, next, next but one), the cyclic order of the faces.
    let turned = select(select(d.zxy, d.yzx, y_major), d, x_major);
    let length = abs(turned.x);
    // A zero direction has zero derivatives.
    let inverse = select(0.0, 1.0 / length, length > 1.17549435e-38);
    let s = turned.y * inverse;
    let t = turned.z * inverse;
    let negative = turned.x < 0.0;
    let face = 2u * axis + select(0u, 1u, negative);
    let half = 0.5 * f32(n - 1u);
    let across = grid_cell(n, half, s);
    let down = grid_cell(n, half, t);
    let fs = across.fraction;
    let ft = down.fraction;
    let gs = 1.0 - fs;
    let gt = 1.0 - ft;
    let base = (face * n + down.first) * n + across.first;
    // Derivatives of the two face coordinates by the permuted direction, then permuted back.
    let derivative = half * inverse;
    let sign = select(1.0, -1.0, negative);
    let ds = turn_back(axis, vec3f(-s * derivative * sign, derivative, 0.0));
    let dt = turn_back(axis, vec3f(-t * derivative * sign, 0.0, derivative));
    return Taps(
        vec4u(base, base + 1u, base + n, base + n + 1u),
        vec4f(gs * gt, fs * gt, gs * ft, fs * ft),
        array<vec3f, 4>(-gt * ds - gs * dt, gt * ds - fs * dt, gs * dt - ft * ds, ft * ds + fs * dt),
    );
}

fn turn_back(axis: u32, v: vec3f) -> vec3f {
    return select(select(v.yzx, v.zxy, axis == 1u), v, axis == 0u);
}
