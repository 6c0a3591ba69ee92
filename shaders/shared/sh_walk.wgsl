// The harmonics of sh.wgsl, one pair (l, +-m) after another, for kernels that use each value once. No private arrays, which
// would spill. Column by column: m = 0, l = 0..degree; m = 1, l = 1..degree; ...
//
//   for (var term = sh_first(degree, d); sh_is_term(term); sh_next(&term)) { ... }
#import sh

struct ShTerm {
    d: vec3f,
    sh_degree: u32,
    l: u32,
    m: u32,
    // Q_l^m and its derivative by z, at l and at l - 1.
    q: vec2f,
    before: vec2f,
    // Q_m^m.
    diagonal: f32,
    // (l - m)! / (l + m)!; at the start of the column 1 / (2m)!.
    ratio: f32,
    first_ratio: f32,
    // (x + i y)^m and m (x + i y)^(m - 1).
    turn: vec2f,
    derivative: vec2f,
}

const FOUR_PI = 12.566370614;

// The term l = m = 0 along the unit direction `d`.
fn sh_first(sh_degree: u32, d: vec3f) -> ShTerm {
    return ShTerm(d, sh_degree, 0u, 0u, vec2f(1.0, 0.0), vec2f(0.0), 1.0, 1.0, 1.0, vec2f(1.0, 0.0), vec2f(0.0));
}

fn sh_is_term(w: ShTerm) -> bool {
    return w.m <= w.sh_degree;
}

// Indices of the coefficients +m and -m. They are equal where m = 0; then only the first counts.
fn sh_indices(w: ShTerm) -> vec2u {
    let centre = w.l * w.l + w.l;
    return vec2u(centre + w.m, centre - w.m);
}

fn sh_norm(w: ShTerm) -> f32 {
    return sqrt(f32(2u * w.l + 1u) * w.ratio * select(2.0, 1.0, w.m == 0u) / FOUR_PI);
}

// Y of +m and -m; the second is 0 where m = 0.
fn sh_values(w: ShTerm) -> vec2f {
    return sh_norm(w) * w.q.x * w.turn;
}

// Their gradients as polynomials in (x, y, z), in the columns.
fn sh_gradients(w: ShTerm) -> mat2x3f {
    let q = sh_norm(w) * w.q;
    return mat2x3f(
        vec3f(q.x * w.derivative.x, -q.x * w.derivative.y, q.y * w.turn.x),
        vec3f(q.x * w.derivative.y, q.x * w.derivative.x, q.y * w.turn.y),
    );
}

fn sh_next(w: ptr<function, ShTerm>) {
    let m = (*w).m;
    if (*w).l < (*w).sh_degree {
        let l = (*w).l + 1u;
        let a = f32(2u * l - 1u);
        let b = f32(l + m - 1u);
        let q = (*w).q;
        let next = (a * vec2f((*w).d.z * q.x, q.x + (*w).d.z * q.y) - b * (*w).before) / f32(l - m);
        (*w).before = q;
        (*w).q = next;
        (*w).ratio *= f32(l - m) / f32(l + m);
        (*w).l = l;
        return;
    }
    let turn = (*w).turn;
    let d = (*w).d;
    (*w).diagonal *= -f32(2u * m + 1u);
    (*w).first_ratio /= f32((2u * m + 1u) * (2u * m + 2u));
    (*w).ratio = (*w).first_ratio;
    (*w).derivative = f32(m + 1u) * turn;
    (*w).turn = vec2f(d.x * turn.x - d.y * turn.y, d.x * turn.y + d.y * turn.x);
    (*w).q = vec2f((*w).diagonal, 0.0);
    (*w).before = vec2f(0.0);
    (*w).m = m + 1u;
    (*w).l = m + 1u;
}
