// Real spherical harmonics up to degree 6 without angles, so values and gradients stay finite at the poles. The basis, its
// order and signs are those of crates/scene/src/light/sh.rs. The index of (l, m) is l * l + l + m.
#import generated/light

// Values of all harmonics up to `sh_degree` along the unit direction `d`.
fn sh_basis(sh_degree: u32, d: vec3f, out: ptr<function, array<f32, 49>>) {
    var norms = SH_NORM;
    var diagonal = 1.0;
    // (x + i y)^m.
    var turn = vec2f(1.0, 0.0);
    for (var m = 0u; m <= sh_degree; m++) {
        var before = 0.0;
        var q = diagonal;
        for (var l = m; l <= sh_degree; l++) {
            if l == m + 1u {
                before = q;
                q = d.z * f32(2u * m + 1u) * q;
            } else if l > m + 1u {
                let next = (d.z * f32(2u * l - 1u) * q - f32(l + m - 1u) * before) / f32(l - m);
                before = q;
                q = next;
            }
            let scaled = norms[l * (l + 1u) / 2u + m] * q;
            let centre = l * l + l;
            (*out)[centre + m] = scaled * turn.x;
            if m > 0u {
                (*out)[centre - m] = scaled * turn.y;
            }
        }
        diagonal = -diagonal * f32(2u * m + 1u);
        turn = vec2f(d.x * turn.x - d.y * turn.y, d.x * turn.y + d.y * turn.x);
    }
}

// As `sh_basis`, with the gradient of each harmonic as a polynomial in (x, y, z): callers that normalise `d` must
// project the radial part out.
fn sh_basis_with_gradient(
    sh_degree: u32,
    d: vec3f,
    out: ptr<function, array<f32, 49>>,
    gradient: ptr<function, array<vec3f, 49>>,
) {
    var norms = SH_NORM;
    var diagonal = 1.0;
    var turn = vec2f(1.0, 0.0);
    // m (x + i y)^(m - 1).
    var derivative = vec2f(0.0, 0.0);
    for (var m = 0u; m <= sh_degree; m++) {
        // Q and dQ/dz at l and l - 1.
        var before = vec2f(0.0, 0.0);
        var q = vec2f(diagonal, 0.0);
        for (var l = m; l <= sh_degree; l++) {
            if l == m + 1u {
                before = q;
                q = vec2f(d.z, 1.0) * f32(2u * m + 1u) * diagonal;
            } else if l > m + 1u {
                let a = f32(2u * l - 1u);
                let b = f32(l + m - 1u);
                let next = (a * vec2f(d.z * q.x, q.x + d.z * q.y) - b * before) / f32(l - m);
                before = q;
                q = next;
            }
            let scaled = norms[l * (l + 1u) / 2u + m] * q;
            let centre = l * l + l;
            (*out)[centre + m] = scaled.x * turn.x;
            (*gradient)[centre + m] = vec3f(scaled.x * derivative.x, -scaled.x * derivative.y, scaled.y * turn.x);
            if m > 0u {
                (*out)[centre - m] = scaled.x * turn.y;
                (*gradient)[centre - m] = vec3f(scaled.x * derivative.y, scaled.x * derivative.x, scaled.y * turn.y);
            }
        }
        diagonal = -diagonal * f32(2u * m + 1u);
        derivative = f32(m + 1u) * turn;
        turn = vec2f(d.x * turn.x - d.y * turn.y, d.x * turn.y + d.y * turn.x);
    }
}

// Degree of a field of `n` coefficients: sqrt(n) - 1.
fn sh_degree_of(n: u32) -> u32 {
    return u32(sqrt(f32(n)) + 0.5) - 1u;
}
