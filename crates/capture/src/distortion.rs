//! The lens distortion models of OpenCV and COLMAP: distortion and its inverse.

use glam::{DMat2, DVec2};

/// Lens distortion. Coefficients are named as in COLMAP's camera models.
///
/// Perspective models bend the point `(x / z, y / z)`. Fisheye models bend the point of the same direction at the distance
/// `theta` from the centre, where `theta` is the angle to the optical axis, radians. Equations: COLMAP, `sensor/models.h`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Distortion {
    /// No distortion: a pinhole.
    None,
    /// Brown-Conrady: radial `k1 k2 k3 k4`, tangential `p1 p2` (SIMPLE_RADIAL, RADIAL, OPENCV).
    RadialTangential {
        /// Radial coefficients of r^2, r^4, r^6, r^8.
        k: [f64; 4],
        /// Tangential coefficients.
        p: [f64; 2],
    },
    /// `(1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)` and tangential `p1 p2` (FULL_OPENCV).
    Rational {
        /// Radial coefficients `k1` to `k6`.
        k: [f64; 6],
        /// Tangential coefficients.
        p: [f64; 2],
    },
    /// Radius `atan(2 r tan(omega / 2)) / omega` (FOV; Devernay and Faugeras, "Straight lines have to be straight", 2001).
    FieldOfView {
        /// The model's angle, radians; not 0.
        omega: f64,
    },
    /// `theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)` (SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE, OPENCV_FISHEYE).
    Fisheye {
        /// Coefficients of theta^2, theta^4, theta^6, theta^8.
        k: [f64; 4],
    },
    /// A fisheye lens with tangential and thin-prism terms (THIN_PRISM_FISHEYE).
    ThinPrismFisheye {
        /// Coefficients of theta^2, theta^4, theta^6, theta^8.
        k: [f64; 4],
        /// Tangential coefficients.
        p: [f64; 2],
        /// Thin-prism coefficients of theta^2 along x and y.
        s: [f64; 2],
    },
    /// A fisheye lens whose tangential and thin-prism terms follow its radial ones (RAD_TAN_THIN_PRISM_FISHEYE).
    RadTanThinPrismFisheye {
        /// Coefficients of theta^2 to theta^12.
        k: [f64; 6],
        /// Tangential coefficients.
        p: [f64; 2],
        /// Thin-prism coefficients of r^2 and r^4 along x, then along y.
        s: [f64; 4],
    },
}

impl Distortion {
    /// The same lens; [`Distortion::None`] if a perspective model bends nothing.
    #[must_use]
    pub fn simplified(self) -> Self {
        let is_zero = |values: &[f64]| values.iter().all(|v| *v == 0.0);
        match self {
            Self::RadialTangential { k, p } if is_zero(&k) && is_zero(&p) => Self::None,
            Self::Rational { k, p } if is_zero(&k) && is_zero(&p) => Self::None,
            Self::FieldOfView { omega: 0.0 } => Self::None,
            other => other,
        }
    }

    /// Whether the model is one for fisheye lenses, which may see more than a pinhole can.
    pub fn is_fisheye(&self) -> bool {
        match self {
            Self::None | Self::RadialTangential { .. } | Self::Rational { .. } | Self::FieldOfView { .. } => {
                false
            }
            Self::Fisheye { .. } | Self::ThinPrismFisheye { .. } | Self::RadTanThinPrismFisheye { .. } => {
                true
            }
        }
    }

    /// The point at which the lens images a ray that a pinhole would image at `p` (both on the plane of depth 1).
    pub fn distort(&self, p: DVec2) -> DVec2 {
        if !self.is_fisheye() {
            return self.bend(p);
        }
        let r = p.length();
        if r < 1e-9 { p } else { self.bend(p * (r.atan() / r)) }
    }

    /// The inverse of [`Distortion::distort`]; `None` where none is found.
    pub fn undistort(&self, distorted: DVec2) -> Option<DVec2> {
        match self {
            Self::None => Some(distorted),
            Self::Fisheye { k } => undistort_fisheye(k, distorted),
            Self::FieldOfView { omega } => {
                let (r, tangent) = (distorted.length(), 2.0 * (0.5 * omega).tan());
                let is_inside = (r * omega).abs() < std::f64::consts::FRAC_PI_2;
                is_inside.then(|| {
                    if r < 1e-9 { distorted } else { distorted * ((r * omega).tan() / (r * tangent)) }
                })
            }
            Self::RadialTangential { .. } | Self::Rational { .. } => self.unbend(distorted),
            Self::ThinPrismFisheye { .. } | Self::RadTanThinPrismFisheye { .. } => {
                let bent = self.unbend(distorted)?;
                let theta = bent.length();
                Some(if theta < 1e-9 { bent } else { bent * (reach(theta) / theta) })
            }
        }
    }

    /// The model's polynomial. Its argument is the point of a perspective model, the point at distance `theta` of a fisheye model.
    fn bend(&self, q: DVec2) -> DVec2 {
        let r2 = q.length_squared();
        match self {
            Self::None => q,
            Self::RadialTangential { k, p } => q * (1.0 + power_series(k, r2)) + tangential(q, *p),
            Self::Rational { k: [k1, k2, k3, k4, k5, k6], p } => {
                let radial =
                    (1.0 + power_series(&[*k1, *k2, *k3], r2)) / (1.0 + power_series(&[*k4, *k5, *k6], r2));
                q * radial + tangential(q, *p)
            }
            Self::FieldOfView { omega } => {
                let (r, tangent) = (r2.sqrt(), 2.0 * (0.5 * omega).tan());
                let factor = if r < 1e-9 { tangent / omega } else { (r * tangent).atan() / (r * omega) };
                q * factor
            }
            Self::Fisheye { k } => q * (1.0 + power_series(k, r2)),
            Self::ThinPrismFisheye { k, p, s } => {
                q * (1.0 + power_series(k, r2)) + tangential(q, *p) + DVec2::from(*s) * r2
            }
            Self::RadTanThinPrismFisheye { k, p: [p0, p1], s } => {
                let radial = q * (1.0 + power_series(k, r2));
                let r2 = radial.length_squared();
                let prism = DVec2::new(s[0] + s[1] * r2, s[2] + s[3] * r2) * r2;
                radial + tangential(radial, [*p1, *p0]) + prism
            }
        }
    }

    /// The inverse of [`Self::bend`], by Newton's method; `None` where it does not converge.
    fn unbend(&self, bent: DVec2) -> Option<DVec2> {
        let mut q = bent;
        for _ in 0..50 {
            let residual = self.bend(q) - bent;
            if residual.length() < 1e-12 {
                break;
            }
            q -= derivative(|q| self.bend(q), q).inverse() * residual;
        }
        let converged = q.is_finite() && (self.bend(q) - bent).length() < 1e-8;
        converged.then_some(q)
    }

    /// Derivative of [`Distortion::distort`], by central differences.
    pub(super) fn jacobian(&self, p: DVec2) -> DMat2 {
        derivative(|p| self.distort(p), p)
    }
}

/// `c0 t + c1 t^2 + ...`.
fn power_series(coefficients: &[f64], t: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| t * (c + sum))
}

/// Tangential distortion with OpenCV's `p1` and `p2`.
fn tangential(q: DVec2, [p1, p2]: [f64; 2]) -> DVec2 {
    let (r2, xy) = (q.length_squared(), 2.0 * q.x * q.y);
    DVec2::new(p1 * xy + p2 * (r2 + 2.0 * q.x * q.x), p2 * xy + p1 * (r2 + 2.0 * q.y * q.y))
}

fn derivative(f: impl Fn(DVec2) -> DVec2, p: DVec2) -> DMat2 {
    const H: f64 = 1e-6;
    let along = |d: DVec2| (f(p + d) - f(p - d)) / (2.0 * H);
    DMat2::from_cols(along(DVec2::new(H, 0.0)), along(DVec2::new(0.0, H)))
}

/// Distance from the centre, on the plane of depth 1, of a ray at `theta` radians from the axis. Directions at 90 degrees and more
/// do not meet that plane; any point far outside the window serves.
fn reach(theta: f64) -> f64 {
    if theta < 1.56 { theta.tan() } else { 1e2 }
}

fn undistort_fisheye(k: &[f64; 4], distorted: DVec2) -> Option<DVec2> {
    let radius = distorted.length();
    if radius < 1e-9 {
        return Some(distorted);
    }
    let bent = |theta: f64| theta * (1.0 + power_series(k, theta * theta));
    let mut theta = radius.min(1.5);
    for _ in 0..50 {
        let derivative = (bent(theta + 1e-6) - bent(theta - 1e-6)) / 2e-6;
        theta = (theta - (bent(theta) - radius) / derivative).clamp(0.0, 3.2);
    }
    if !theta.is_finite() || (bent(theta) - radius).abs() > 1e-8 {
        return None;
    }
    Some(distorted * (reach(theta) / radius))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENSES: [Distortion; 7] = [
        Distortion::RadialTangential { k: [0.0578, -0.0805, 0.01, 0.0], p: [-0.00098, 0.00016] },
        Distortion::RadialTangential { k: [-0.28, 0.08, 0.0, 0.0], p: [0.0; 2] },
        Distortion::Rational { k: [0.4, -0.1, 0.02, 0.45, -0.05, 0.01], p: [0.001, -0.002] },
        Distortion::FieldOfView { omega: 0.9 },
        Distortion::Fisheye { k: [0.05, -0.01, 0.002, 0.0] },
        Distortion::ThinPrismFisheye {
            k: [0.05, -0.01, 0.002, 0.001],
            p: [0.001, -0.002],
            s: [0.003, -0.001],
        },
        Distortion::RadTanThinPrismFisheye {
            k: [0.05, -0.01, 0.002, 0.001, 0.0, 0.0001],
            p: [0.001, -0.002],
            s: [0.003, -0.001, 0.002, 0.001],
        },
    ];

    fn grid() -> impl Iterator<Item = DVec2> {
        (0..50).map(|i| DVec2::new((i % 10) as f64 * 0.14 - 0.6, (i / 10) as f64 * 0.2 - 0.4))
    }

    #[test]
    fn undistortion_inverts_distortion() {
        for lens in LENSES {
            for p in grid() {
                let back = lens.undistort(lens.distort(p)).unwrap();
                assert!((back - p).length() < 1e-7, "{lens:?} {p} {back}");
            }
            let bent = grid().map(|p| (lens.distort(p) - p).length()).fold(0.0, f64::max);
            assert!(bent > 1e-3, "the control: {lens:?} bends something");
        }
    }

    #[test]
    fn general_models_equal_simple_ones_with_equal_terms() {
        let p = DVec2::new(0.4, -0.3);
        let near = |a: Distortion, b: Distortion| (a.distort(p) - b.distort(p)).length() < 1e-12;
        let (k, t) = ([0.05, -0.01, 0.002, 0.0], [0.001, -0.002]);
        let rational = |k4| Distortion::Rational { k: [0.05, -0.01, 0.002, k4, 0.0, 0.0], p: t };
        let brown = Distortion::RadialTangential { k, p: t };
        assert!(near(rational(0.0), brown) && !near(rational(0.01), brown));
        let prism = |s| Distortion::ThinPrismFisheye { k, p: [0.0; 2], s: [s, 0.0] };
        let fisheye = Distortion::Fisheye { k };
        assert!(near(prism(0.0), fisheye) && !near(prism(0.01), fisheye));
        let longer =
            |p| Distortion::RadTanThinPrismFisheye { k: [0.05, -0.01, 0.002, 0.0, 0.0, 0.0], p, s: [0.0; 4] };
        assert!(near(longer([0.0; 2]), fisheye) && !near(longer(t), fisheye));
        let bent = Distortion::FieldOfView { omega: 1e-4 }.distort(p);
        assert!((bent - p).length() < 1e-8, "a small angle bends little");
    }

    #[test]
    fn terms_of_the_fisheye_models_have_colmaps_order() {
        // theta = atan(0.5); on the x axis the equations have one term each.
        let theta = 0.5f64.atan();
        let at = |lens: Distortion| lens.distort(DVec2::new(0.5, 0.0));
        let thin = at(Distortion::ThinPrismFisheye { k: [0.0; 4], p: [0.01, 0.02], s: [0.03, 0.04] });
        let t2 = theta * theta;
        assert!(
            (thin - DVec2::new(theta + 3.0 * 0.02 * t2 + 0.03 * t2, 0.01 * t2 + 0.04 * t2)).length() < 1e-12
        );
        let lens =
            Distortion::RadTanThinPrismFisheye { k: [0.0; 6], p: [0.01, 0.02], s: [0.03, 0.5, 0.04, 0.6] };
        let x = theta + 3.0 * 0.01 * t2 + 0.03 * t2 + 0.5 * t2 * t2;
        let y = 0.02 * t2 + 0.04 * t2 + 0.6 * t2 * t2;
        assert!((at(lens) - DVec2::new(x, y)).length() < 1e-12);
    }
}
