// Look-up in a seamless cube-shaped grid over directions, as `light::CubeGrid`: nodes sit on the cube's edges.

struct Taps {
    node: vec4u,
    // Bilinear, summing to 1.
    weight: vec4f,
}

// The nodes and weights around direction `d`, of any positive length, in a grid with `n` nodes along an edge, n >= 2.
fn cube_taps(n: u32, d: vec3f) -> Taps {
    let magnitude = abs(d);
    // Major coordinate, then the other two in cyclic order.
    var turned = d.zxy;
    var axis = 2u;
    if magnitude.x >= magnitude.y && magnitude.x >= magnitude.z {
        turned = d;
        axis = 0u;
    } else if magnitude.y >= magnitude.z {
        turned = d.yzx;
        axis = 1u;
    }
    let largest = abs(turned.x);
    var st = vec2f(0.0);
    // A null direction has no neighbours to move to.
    if largest > 1.1754944e-38 {
        st = turned.yz / largest;
    }
    let face = 2u * axis + select(0u, 1u, turned.x < 0.0);
    let place = max((st + 1.0) * (0.5 * f32(n - 1u)), vec2f(0.0));
    let cell = min(vec2u(place), vec2u(n - 2u));
    let f = min(place - vec2f(cell), vec2f(1.0));
    let g = 1.0 - f;
    let base = (face * n + cell.y) * n + cell.x;
    return Taps(
        vec4u(base, base + 1u, base + n, base + n + 1u),
        vec4f(g.x * g.y, f.x * g.y, g.x * f.y, f.x * f.y),
    );
}
