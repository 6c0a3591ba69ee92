//! Light of lamps on a horizontal plane below a model (docs/MODEL.md, section 9).

use rayon::prelude::*;

use crate::ProbeSettings;
use crate::cpu::OccluderBvh;
use crate::cpu::ground::Ground;
use crate::cpu::lamps::{Lamp, MIN_DISTANCE, direction};
use crate::cpu::occluder::Vec3;

/// Points of the plane of one parallel task.
const POINTS_AT_ONCE: usize = 64;

/// Irradiance of a point of the plane by lamps, linear RGB.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LampLight {
    /// Without the model.
    pub open: [f32; 3],
    /// Past the model.
    pub received: [f32; 3],
}

/// The Gaussians above a plane, in a tree for rays from the plane to lamps.
pub struct LampGround {
    rays: OccluderBvh,
}

impl Ground {
    /// The same Gaussians for light of lamps.
    pub fn for_lamps(&self) -> LampGround {
        // The plane is not a surface of Gaussians, so its rays need no distance from the first ones.
        let settings = ProbeSettings { bias: 0.0, clearance: 0.0, ..ProbeSettings::default() };
        LampGround { rays: OccluderBvh::of(self.occluders().collect(), settings) }
    }
}

impl LampGround {
    /// Adds to `sums` the irradiance of `points` of the plane by `lamp`.
    pub fn add(&self, sums: &mut [LampLight], points: &[Vec3], lamp: &Lamp) {
        let share = 1.0 / lamp.points.len().max(1) as f32;
        sums.par_iter_mut().zip(points).with_min_len(POINTS_AT_ONCE).for_each(|(sum, point)| {
            let (mut open, mut received) = (0.0f32, 0.0f32);
            for place in &lamp.points {
                let (towards, distance) = direction(*point, *place);
                let emission = lamp.emission(towards.map(|v| -v)) * towards[2];
                if emission > 0.0 {
                    let arriving = share * emission / distance.max(MIN_DISTANCE).powi(2);
                    open += arriving;
                    received += arriving * self.rays.transmittance_up_to(*point, towards, distance);
                }
            }
            for c in 0..3 {
                sum.open[c] += open * lamp.intensity[c];
                sum.received[c] += received * lamp.intensity[c];
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::cpu::HostModel;
    use relume_scene::{Field, Gaussians, Model};

    /// An opaque screen of 1 x 1 at z = 1/2 above the plane z = 0, and a floor below the plane.
    fn screen() -> HostModel {
        let mut g = Gaussians::zeroed(2 * 441, 1, 2, 0);
        for i in 0..882 {
            let at = |k: usize| (k as f32 - 10.0) * 0.05;
            let z = if i < 441 { 0.5 } else { -0.02 };
            g.row_mut(Field::Mean, i).copy_from_slice(&[at(i % 21), at(i / 21 % 21), z]);
            g.row_mut(Field::LogScale, i).copy_from_slice(&[0.04f32.ln(), 0.04f32.ln(), 1e-3f32.ln()]);
            g.row_mut(Field::Quaternion, i)[0] = 1.0;
        }
        g.field_mut(Field::OpacityLogit).fill(6.0);
        HostModel::new(Arc::new(Model::new(g, vec![[0.5; 3]], vec![[0.0; 3]; 8], (4, 2))))
    }

    fn lamp(points: Vec<Vec3>) -> Lamp {
        Lamp { points, normal: None, cone: None, intensity: [1.0, 2.0, 0.5], radius: 0.0 }
    }

    fn lit(points: &[Vec3], lamp: &Lamp) -> Vec<LampLight> {
        let mut sums = vec![LampLight::default(); points.len()];
        screen().ground(0.0).for_lamps().add(&mut sums, points, lamp);
        sums
    }

    #[test]
    fn a_screen_casts_the_shadow_of_a_point_lamp_and_below_it_none() {
        let points: Vec<Vec3> = (0..9).map(|i| [0.25 * i as f32, 0.0, 0.0]).collect();
        let above = lit(&points, &lamp(vec![[0.0, 0.0, 1.0]]));
        for (point, light) in points.iter().zip(&above) {
            let square = point[0] * point[0] + 1.0;
            let expected = 1.0 / square.powf(1.5);
            assert!((light.open[0] - expected).abs() < 1e-4, "{point:?}: {light:?} {expected}");
            assert!((light.open[1] - 2.0 * light.open[0]).abs() < 1e-4);
            // The shadow of the half side 1/2 reaches to 1.
            let left = light.received[0] / light.open[0];
            let is_right = if point[0] < 0.9 { left < 0.1 } else { point[0] < 1.2 || left > 0.9 };
            assert!(is_right, "{point:?}: {left}");
        }
        let below = lit(&points, &lamp(vec![[0.0, 0.0, 0.3]]));
        assert!(below.iter().all(|light| light.open == light.received && light.open[0] > 0.0), "{below:?}");
        let under = lit(&points, &lamp(vec![[0.0, 0.0, -1.0]]));
        assert!(under.iter().all(|light| light.open == [0.0; 3]), "a lamp below the plane does not light it");
    }

    #[test]
    fn a_wide_lamp_has_a_soft_shadow() {
        let edge = [[1.0, 0.0, 0.0]];
        let wide: Vec<Vec3> = (0..24).map(|k| [(k as f32 - 11.5) * 0.04, 0.0, 1.0]).collect();
        let [soft, hard] = [lamp(wide), lamp(vec![[0.3, 0.0, 1.0]])].map(|lamp| {
            let light = lit(&edge, &lamp)[0];
            light.received[1] / light.open[1]
        });
        assert!((0.3..0.7).contains(&soft), "half of the lamp is visible from the edge: {soft}");
        assert!(hard > 0.9, "the control: {hard}");
    }
}
