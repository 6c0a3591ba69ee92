//! A Gaussian as an occluder: its orthographic footprint on the plane perpendicular to a direction.

use rayon::prelude::*;

use crate::cpu::attributes::AttributeSource;
use crate::cpu::lanes::exp_negative;
use crate::cpu::project::rotation;
use crate::sigmoid;
use relume_layout::constants::{ALPHA_MAX, ALPHA_MIN, LOG_SCALE_LIMIT, MAX_OCCLUDER_VARIANCE};

pub(super) type Vec3 = [f32; 3];

pub(super) fn dot(a: Vec3, b: Vec3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A Gaussian as an occluder.
#[derive(Debug, Clone, Copy)]
pub(super) struct Occluder {
    pub(super) mean: Vec3,
    /// Axes times standard deviations, as rows.
    pub(super) axes: [Vec3; 3],
    pub(super) opacity: f32,
    /// `ln(255 opacity)`: at a larger exponent alpha is below 1/255.
    pub(super) reach: f32,
}

/// An [`Occluder`] seen along one direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Footprint {
    pub(super) conic: [f32; 3],
    /// Variances along the two axes of the plane.
    pub(super) spread: [f32; 2],
    /// Standard deviation along the direction.
    pub(super) thickness: f32,
    pub(super) opacity: f32,
    pub(super) reach: f32,
}

/// Every Gaussian of `source`; those with unusable parameters have an opacity of 0.
pub(super) fn occluders(source: &AttributeSource<'_>) -> Vec<Occluder> {
    (0..source.gaussians.len()).into_par_iter().with_min_len(256).map(|i| Occluder::new(source, i)).collect()
}

impl Occluder {
    fn new(source: &AttributeSource<'_>, i: usize) -> Self {
        let g = source.geometry(i);
        let q = rotation(g.quaternion);
        let scale = g.log_scale.map(|s| s.clamp(-LOG_SCALE_LIMIT, LOG_SCALE_LIMIT).exp());
        let axes = std::array::from_fn(|k| std::array::from_fn(|r| q[r][k] * scale[k]));
        let opacity = if g.is_usable() { sigmoid(g.opacity_logit) } else { 0.0 };
        Self { mean: g.mean, axes, opacity, reach: (opacity / ALPHA_MIN).ln() }
    }

    pub(super) fn occludes(&self) -> bool {
        self.opacity >= ALPHA_MIN
    }

    /// The footprint along `d` on the plane of `u` and `v`, an orthonormal basis; `None` where it is degenerate or too wide.
    #[inline]
    pub(super) fn along(&self, d: Vec3, u: Vec3, v: Vec3) -> Option<Footprint> {
        let (mut uu, mut uv, mut vv, mut dd) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
        for axis in &self.axes {
            let (a, b, c) = (dot(*axis, u), dot(*axis, v), dot(*axis, d));
            uu += a * a;
            uv += a * b;
            vv += b * b;
            dd += c * c;
        }
        let floor = widening(uu + vv);
        let (uu, vv) = (uu + floor, vv + floor);
        let det = uu * vv - uv * uv;
        (det > 0.0 && uu < MAX_OCCLUDER_VARIANCE && vv < MAX_OCCLUDER_VARIANCE).then(|| Footprint {
            conic: [vv / det, -uv / det, uu / det],
            spread: [uu, vv],
            thickness: dd.sqrt(),
            opacity: self.opacity,
            reach: self.reach,
        })
    }
}

impl Footprint {
    /// Alpha `offset` from its centre; `None` below 1/255.
    #[inline]
    pub(super) fn alpha(&self, [dx, dy]: [f32; 2]) -> Option<f32> {
        let power = 0.5 * (self.conic[0] * dx * dx + self.conic[2] * dy * dy) + self.conic[1] * dx * dy;
        (power <= self.reach).then(|| (self.opacity * exp_negative(-power.max(0.0))).min(ALPHA_MAX))
    }

    /// Least and greatest first offset at the second offset `dy` with alpha >= 1/255; `None` where there is none.
    pub(super) fn chord(&self, dy: f32) -> Option<[f32; 2]> {
        let [a, b, c] = self.conic;
        let square = b * b * dy * dy - a * (c * dy * dy - 2.0 * self.reach);
        (square >= 0.0).then(|| [-1.0, 1.0].map(|sign: f32| (sign * square.sqrt() - b * dy) / a))
    }

    /// Half the sides of the bounding box of alpha >= 1/255.
    pub(super) fn extent(&self) -> [f32; 2] {
        self.spread.map(|s| (2.0 * self.reach * s).sqrt())
    }
}

/// Addend to both variances of a footprint, whose sum is `trace`: without it a disc seen edge-on would have width 0.
pub(super) fn widening(trace: f32) -> f32 {
    1e-4 * trace + 1e-14
}

/// Two unit vectors that complete `d` to an orthonormal basis.
pub(super) fn plane_basis(d: Vec3) -> (Vec3, Vec3) {
    let (u, v) = glam::Vec3::from_array(d).any_orthonormal_pair();
    (u.to_array(), v.to_array())
}
