//! The article's learned indirect light: low-frequency environment radiance combined by 16 weights (Eq. 19-20).

use crate::probing::fibonacci_sphere;
use relume_scene::light::{LightTables, sh_eval};

/// Number of fixed directions in which the low-frequency environment is sampled (article Eq. 20).
pub(crate) const INDIRECT_DIRECTIONS: usize = 32;

/// `E_j` where indirect light is not learned: zero.
pub const NO_INDIRECT_BASIS: [[f32; 3]; 16] = [[0.0; 3]; 16];

/// `E_j = 1/32 sum_k Y_j(w_k) L_low(w_k)` (Eq. 20) over 32 Fibonacci directions.
pub fn indirect_basis(tables: &LightTables) -> [[f32; 3]; 16] {
    let mut out = [[0.0f32; 3]; 16];
    let last = tables.specular.len() - 1;
    for d in fibonacci_sphere(INDIRECT_DIRECTIONS) {
        let mut y = [0.0f32; 16];
        sh_eval(3, d, &mut y);
        let taps = tables.specular_grids[last].lookup(d);
        for k in 0..4 {
            let light = tables.specular[last][taps.node[k]];
            for (o, y) in out.iter_mut().zip(&y) {
                (0..3).for_each(|c| o[c] += y * taps.weight[k] * light[c] / INDIRECT_DIRECTIONS as f32);
            }
        }
    }
    out
}

/// Adds the gradient of the light through `E_j` to the roughest specular level.
pub fn indirect_basis_backward(by_basis: &[[f32; 3]; 16], by_tables: &mut LightTables) {
    let last = by_tables.specular.len() - 1;
    for d in fibonacci_sphere(INDIRECT_DIRECTIONS) {
        let mut y = [0.0f32; 16];
        sh_eval(3, d, &mut y);
        let taps = by_tables.specular_grids[last].lookup(d);
        for k in 0..4 {
            let node = &mut by_tables.specular[last][taps.node[k]];
            for (g, y) in by_basis.iter().zip(&y) {
                (0..3).for_each(|c| node[c] += y * taps.weight[k] * g[c] / INDIRECT_DIRECTIONS as f32);
            }
        }
    }
}
