//! Projection and blending in f64, without tiles: the reference where f32 does not have enough digits.

use crate::RasterCamera;
use relume_scene::{Field, Gaussians};

/// A splat in f64.
#[derive(Debug, Clone, Copy)]
pub struct ExactSplat {
    pub gaussian: usize,
    pub mean: [f64; 2],
    pub conic: [f64; 3],
    pub opacity: f64,
    order: u32,
}

/// Visible splats, nearest first. Quaternions must not be zero.
pub fn project(view: &RasterCamera, g: &Gaussians) -> Vec<ExactSplat> {
    let mut out: Vec<ExactSplat> = (0..g.len()).filter_map(|i| project_one(view, g, i)).collect();
    out.sort_by(|a, b| a.order.cmp(&b.order).then(a.gaussian.cmp(&b.gaussian)));
    out
}

fn project_one(view: &RasterCamera, g: &Gaussians, i: usize) -> Option<ExactSplat> {
    let wide = |v: &[f32]| -> [f64; 3] { std::array::from_fn(|k| f64::from(v[k])) };
    let rows = view.rotation.map(|r| wide(&r));
    let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| a[k] * b[k]).sum::<f64>();
    let (mean, translation) = (wide(g.row(Field::Mean, i)), wide(&view.translation));
    let camera: [f64; 3] = std::array::from_fn(|k| dot(rows[k], mean) + translation[k]);
    let rate = f64::from(g.row(Field::SamplingRate, i)[0]);
    if camera[2] <= 0.05 || rate < 0.0 {
        return None;
    }
    let focal = view.focal.map(f64::from);
    let to: [[f64; 3]; 2] = std::array::from_fn(|k| {
        let [lo, hi] = view.ratio_limits[k].map(f64::from);
        let ratio = (camera[k] / camera[2]).clamp(lo, hi);
        std::array::from_fn(|c| focal[k] / camera[2] * (rows[k][c] - ratio * rows[2][c]))
    });
    let q: [f64; 4] = g.get::<4>(Field::Quaternion, i).map(f64::from);
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    let [w, x, y, z] = q.map(|v| v / length);
    let rotation = glam::DMat3::from_quat(glam::DQuat::from_xyzw(x, y, z, w));
    let scale = wide(g.row(Field::LogScale, i)).map(f64::exp);
    let screen = to.map(|t| std::array::from_fn(|c| scale[c] * dot(t, rotation.col(c).to_array())));
    let low_pass = low_pass_of(view, camera[2], rate);
    let [xx, xy, yy] = [dot(screen[0], screen[0]), dot(screen[0], screen[1]), dot(screen[1], screen[1])];
    let raw_determinant = xx * yy - xy * xy;
    let (xx, yy) = (xx + low_pass, yy + low_pass);
    let determinant = xx * yy - xy * xy;
    let compensation = if view.low_pass_compensation { (raw_determinant / determinant).sqrt() } else { 1.0 };
    let opacity = compensation / (1.0 + (-f64::from(g.row(Field::OpacityLogit, i)[0])).exp());
    (opacity >= 1.0 / 255.0).then(|| ExactSplat {
        gaussian: i,
        mean: std::array::from_fn(|k| focal[k] * camera[k] / camera[2] + f64::from(view.centre_px[k])),
        conic: [yy / determinant, -xy / determinant, xx / determinant],
        opacity,
        order: view.depth_key(g.get(Field::Mean, i)),
    })
}

/// The low-pass of a Gaussian at `depth` that the photographs sample `rate` times per unit of length (docs/MODEL.md, section 2).
fn low_pass_of(view: &RasterCamera, depth: f64, rate: f64) -> f64 {
    let own = f64::from(view.low_pass);
    let [fx, fy] = view.focal.map(f64::from);
    if rate > 0.0 { own * (0.7 * fx * fy / (depth * rate).powi(2)).max(1.0) } else { own }
}

/// Values of a splat in one pixel.
struct Entry {
    index: usize,
    offset: [f64; 2],
    free: f64,
    alpha: f64,
    transmittance: f64,
}

fn entries(splats: &[ExactSplat], x: usize, y: usize) -> Vec<Entry> {
    let mut transmittance = 1.0;
    let mut out = Vec::new();
    for (index, s) in splats.iter().enumerate() {
        let [dx, dy] = [x as f64 + 0.5 - s.mean[0], y as f64 + 0.5 - s.mean[1]];
        let power = 0.5 * (s.conic[0] * dx * dx + s.conic[2] * dy * dy) + s.conic[1] * dx * dy;
        let free = s.opacity * (-power).exp();
        if free >= 1.0 / 255.0 {
            let alpha = free.min(0.99);
            out.push(Entry { index, offset: [dx, dy], free, alpha, transmittance });
            transmittance *= 1.0 - alpha;
        }
    }
    out
}

/// `[pixel][channel]` of the blended attributes (`[gaussian][stored]`).
pub fn blend(view: &RasterCamera, splats: &[ExactSplat], attributes: &[f32], stored: usize) -> Vec<Vec<f32>> {
    (0..view.width * view.height)
        .map(|pixel| {
            let mut sums = vec![0.0f64; stored];
            for e in entries(splats, pixel % view.width, pixel / view.width) {
                let row = &attributes[splats[e.index].gaussian * stored..][..stored];
                sums.iter_mut().zip(row).for_each(|(s, a)| *s += e.transmittance * e.alpha * f64::from(*a));
            }
            sums.into_iter().map(|s| s as f32).collect()
        })
        .collect()
}

/// Rows of 7 + `stored` floats per Gaussian: mean, conic, opacity, absgrad, channels. `by` is `[pixel][stored]`.
pub fn backward(
    view: &RasterCamera,
    splats: &[ExactSplat],
    attributes: &[f32],
    by: &[Vec<f32>],
    n: usize,
) -> Vec<Vec<f64>> {
    let stored = by[0].len();
    let mut out = vec![vec![0.0f64; 7 + stored]; n];
    for (pixel, by) in by.iter().enumerate() {
        let mut behind = 0.0;
        for e in entries(splats, pixel % view.width, pixel / view.width).iter().rev() {
            let splat = &splats[e.index];
            let row = &attributes[splat.gaussian * stored..][..stored];
            let target = &mut out[splat.gaussian];
            let weight = e.transmittance * e.alpha;
            let s: f64 = row.iter().zip(by).map(|(a, g)| f64::from(*a) * f64::from(*g)).sum();
            target[7..].iter_mut().zip(by).for_each(|(t, g)| *t += weight * f64::from(*g));
            let by_alpha = e.transmittance * s - behind / (1.0 - e.alpha);
            behind += weight * s;
            if e.free < 0.99 {
                let flow = by_alpha * e.alpha;
                let ([dx, dy], [a, b, c]) = (e.offset, splat.conic);
                let by_mean = [flow * (a * dx + b * dy), flow * (b * dx + c * dy)];
                let header = [
                    by_mean[0],
                    by_mean[1],
                    -0.5 * flow * dx * dx,
                    -flow * dx * dy,
                    -0.5 * flow * dy * dy,
                    flow / splat.opacity,
                    by_mean[0].hypot(by_mean[1]),
                ];
                target.iter_mut().zip(header).for_each(|(t, h)| *t += h);
            }
        }
    }
    out
}
