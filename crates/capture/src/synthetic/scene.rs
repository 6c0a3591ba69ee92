//! The analytic scene: primitives with exact ray intersections, each of one material.

use glam::{DVec2, DVec3};

/// The material at a surface point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Material {
    /// Base colour, linear.
    pub albedo: DVec3,
    /// 0 dielectric, 1 metal.
    pub metallic: f64,
    /// Perceptual roughness; GGX alpha is its square.
    pub roughness: f64,
}

/// The point where a ray meets the scene.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hit {
    /// Distance along the ray.
    pub distance: f64,
    /// The point.
    pub point: DVec3,
    /// Outward unit normal.
    pub normal: DVec3,
    /// The material there.
    pub material: Material,
}

enum Solid {
    Sphere {
        centre: DVec3,
        radius: f64,
    },
    /// Upright box rotated about +Z by the angle of the unit vector `turn`.
    Cuboid {
        centre: DVec3,
        half: DVec3,
        turn: DVec2,
    },
    /// Upright closed cylinder.
    Cylinder {
        centre: DVec3,
        radius: f64,
        half_height: f64,
    },
}

struct Primitive {
    shape: Solid,
    material: Material,
    /// The second albedo of a checkerboard in x and y, if there is one.
    checker: Option<DVec3>,
}

/// The available scenes. All lie inside the ball of radius 1.2 around the origin, +Z up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SyntheticScene {
    /// Five objects of different materials on a chequered round table.
    #[default]
    Table,
    /// One matte ball: convex, dielectric, one colour.
    MatteBall,
    /// One polished metal ball.
    MirrorBall,
    /// The objects and the table of [`SyntheticScene::Table`], all of one rough dielectric material.
    OneMaterial,
}

/// The primitives of one scene.
pub(super) struct AnalyticScene {
    primitives: Vec<Primitive>,
}

/// Height of the table's top.
const TABLE: f64 = -0.42;
/// Side of a square of the table's checkerboard.
const FIELD: f64 = 0.25;
/// Radius of the ball in the scenes with one ball.
const BALL: f64 = 0.85;

impl AnalyticScene {
    /// The primitives of scene `which`.
    pub(super) fn new(which: SyntheticScene) -> Self {
        let ball = |metallic, roughness| {
            let albedo = DVec3::new(0.7, 0.62, 0.5);
            let shape = Solid::Sphere { centre: DVec3::ZERO, radius: BALL };
            vec![Primitive { shape, material: Material { albedo, metallic, roughness }, checker: None }]
        };
        let primitives = match which {
            SyntheticScene::Table => Self::table(),
            SyntheticScene::MatteBall => ball(0.0, 0.9),
            SyntheticScene::MirrorBall => ball(1.0, 0.15),
            SyntheticScene::OneMaterial => {
                let clay = Material { albedo: DVec3::new(0.66, 0.45, 0.33), metallic: 0.0, roughness: 0.8 };
                let all = Self::table().into_iter();
                all.map(|p| Primitive { material: clay, checker: None, ..p }).collect()
            }
        };
        Self { primitives }
    }

    fn table() -> Vec<Primitive> {
        let material =
            |r, g, b, metallic, roughness| Material { albedo: DVec3::new(r, g, b), metallic, roughness };
        let plain = |shape, material| Primitive { shape, material, checker: None };
        let ball = |x, y, radius| Solid::Sphere { centre: DVec3::new(x, y, TABLE + radius), radius };
        let table =
            Solid::Cylinder { centre: DVec3::new(0.0, 0.0, TABLE - 0.05), radius: 1.05, half_height: 0.05 };
        let cuboid = Solid::Cuboid {
            centre: DVec3::new(-0.42, 0.36, TABLE + 0.28),
            half: DVec3::new(0.2, 0.2, 0.28),
            turn: DVec2::from_angle(0.5),
        };
        let cylinder =
            Solid::Cylinder { centre: DVec3::new(0.48, 0.42, TABLE + 0.2), radius: 0.2, half_height: 0.2 };
        vec![
            Primitive {
                shape: table,
                material: material(0.62, 0.58, 0.52, 0.0, 0.8),
                checker: Some(DVec3::new(0.30, 0.31, 0.34)),
            },
            plain(ball(0.1, -0.12, 0.34), material(0.62, 0.07, 0.05, 0.0, 0.25)),
            plain(ball(-0.52, -0.42, 0.24), material(0.91, 0.72, 0.36, 1.0, 0.4)),
            plain(ball(0.62, -0.4, 0.16), material(0.75, 0.75, 0.72, 0.0, 0.9)),
            plain(cuboid, material(0.08, 0.22, 0.55, 0.0, 0.7)),
            plain(cylinder, material(0.12, 0.42, 0.12, 0.0, 0.55)),
        ]
    }

    /// The nearest hit of the ray at a distance above [`NEAR`].
    pub(super) fn intersect(&self, origin: DVec3, direction: DVec3) -> Option<Hit> {
        let mut nearest: Option<(f64, DVec3, &Primitive)> = None;
        for primitive in &self.primitives {
            if let Some((t, normal)) = primitive.shape.intersect(origin, direction)
                && nearest.is_none_or(|(best, ..)| t < best)
            {
                nearest = Some((t, normal, primitive));
            }
        }
        nearest.map(|(distance, normal, primitive)| {
            let point = origin + direction * distance;
            Hit { distance, point, normal, material: primitive.material_at(point) }
        })
    }
}

impl Primitive {
    fn material_at(&self, p: DVec3) -> Material {
        let field = |v: f64| (v / FIELD).floor() as i64;
        match self.checker {
            Some(other) if (field(p.x) + field(p.y)) % 2 != 0 => Material { albedo: other, ..self.material },
            _ => self.material,
        }
    }
}

/// Smallest distance of a hit, so that a ray does not hit the surface that it starts on.
const NEAR: f64 = 1e-6;

impl Solid {
    /// Distance and outward normal of the nearest hit.
    fn intersect(&self, origin: DVec3, direction: DVec3) -> Option<(f64, DVec3)> {
        match *self {
            Self::Sphere { centre, radius } => sphere(origin - centre, direction, radius),
            Self::Cuboid { centre, half, turn } => {
                let turned = |v: DVec3, a: DVec2| a.rotate(v.truncate()).extend(v.z);
                let back = DVec2::new(turn.x, -turn.y);
                let (t, normal) = cuboid(turned(origin - centre, back), turned(direction, back), half)?;
                Some((t, turned(normal, turn)))
            }
            Self::Cylinder { centre, radius, half_height } => {
                cylinder(origin - centre, direction, radius, half_height)
            }
        }
    }
}

fn sphere(o: DVec3, d: DVec3, radius: f64) -> Option<(f64, DVec3)> {
    let b = o.dot(d);
    // The squared distance of the ray's line from the centre, without the cancellation of b^2 - o^2.
    let root = (radius * radius - (o - d * b).length_squared()).sqrt();
    // A NaN root, for a miss, fails both comparisons.
    let t = if -b - root > NEAR { -b - root } else { -b + root };
    (t > NEAR).then(|| (t, (o + d * t) / radius))
}

fn cuboid(o: DVec3, d: DVec3, half: DVec3) -> Option<(f64, DVec3)> {
    let inverse = d.recip();
    let a = (-half - o) * inverse;
    let b = (half - o) * inverse;
    let (enter, leave) = (a.min(b), a.max(b));
    let (first, last) = (enter.max_element(), leave.min_element());
    if first > last || last <= NEAR {
        return None;
    }
    let t = if first > NEAR { first } else { last };
    let p = (o + d * t) / half;
    let axis = p.abs().max_position();
    let mut normal = DVec3::ZERO;
    normal[axis] = p[axis].signum();
    Some((t, normal))
}

fn cylinder(o: DVec3, d: DVec3, radius: f64, half_height: f64) -> Option<(f64, DVec3)> {
    let mut nearest: Option<(f64, DVec3)> = None;
    let mut offer = |t: f64, normal: DVec3| {
        if t > NEAR && nearest.is_none_or(|(best, _)| t < best) {
            nearest = Some((t, normal));
        }
    };
    let a = d.truncate().length_squared();
    let b = o.truncate().dot(d.truncate());
    let root = (b * b - a * (o.truncate().length_squared() - radius * radius)).sqrt();
    if a > 1e-18 && root.is_finite() {
        for t in [(-b - root) / a, (-b + root) / a] {
            let p = o + d * t;
            if p.z.abs() <= half_height {
                offer(t, (p.truncate() / radius).extend(0.0));
            }
        }
    }
    for side in [-1.0, 1.0] {
        let t = (side * half_height - o.z) / d.z;
        if t.is_finite() && (o + d * t).truncate().length_squared() <= radius * radius {
            offer(t, DVec3::Z * side);
        }
    }
    nearest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ray_intersections_match_the_analytic_shapes() {
        let d = DVec3::new(1.0, 0.0, 0.0);
        let start = DVec3::new(-5.0, 0.0, 0.1);
        let (t, n) = sphere(start, d, 1.0).unwrap();
        assert!((t - (5.0 - 0.99f64.sqrt())).abs() < 1e-12 && (n.length() - 1.0).abs() < 1e-12);
        let (t, n) = cuboid(start, d, DVec3::new(0.5, 1.0, 1.0)).unwrap();
        assert!((t - 4.5).abs() < 1e-12 && n == -DVec3::X);
        let (t, n) = cylinder(start, d, 0.5, 0.2).unwrap();
        assert!((t - 4.5).abs() < 1e-12 && n == -DVec3::X);
        let (t, n) = cylinder(DVec3::new(0.1, 0.0, 3.0), -DVec3::Z, 0.5, 0.2).unwrap();
        assert!((t - 2.8).abs() < 1e-12 && n == DVec3::Z);
        assert!(
            sphere(start + DVec3::Z, d, 1.0).is_none() && cylinder(start + DVec3::Z, d, 0.5, 0.2).is_none()
        );
        assert!(cuboid(start + DVec3::Z, d, DVec3::splat(1.0)).is_none());
    }

    #[test]
    fn hits_lie_inside_the_bounds_and_normals_face_the_ray() {
        let scene = AnalyticScene::new(SyntheticScene::Table);
        let mut hits = 0;
        for i in 0..4000 {
            let (a, z) = (i as f64 * 2.399_963, 1.0 - 2.0 * (i as f64 + 0.5) / 4000.0);
            let side = (1.0 - z * z).sqrt();
            let eye = 3.0 * DVec3::new(side * a.cos(), side * a.sin(), z);
            let aim = DVec3::new((i % 17) as f64 / 12.0 - 0.7, (i % 13) as f64 / 9.0 - 0.7, -0.2);
            let direction = (aim - eye).normalize();
            if let Some(hit) = scene.intersect(eye, direction) {
                hits += 1;
                assert!(hit.point.length() < 1.2, "{}", hit.point);
                assert!(hit.normal.dot(direction) <= 1e-9 && (hit.normal.length() - 1.0).abs() < 1e-9);
            }
        }
        assert!(hits > 3000, "{hits}");
    }
}
