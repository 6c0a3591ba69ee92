//! A light to render under.

use glam::DVec3;

use crate::column_shift::ColumnShift;
use crate::light::luminance;
use crate::{EnvMap, LightSplit, MAX_LIGHTS, SplitLight};

/// An environment map and, where a training found them, its dominant lights. The lights rotate with the map, so a recovered
/// light keeps its split at every rotation and exposure.
#[derive(Debug, Clone, PartialEq)]
pub struct Illumination {
    /// The map.
    pub environment: EnvMap,
    /// Shares of the texels per light. `None` where they are not known: a renderer then finds the lights itself where it needs
    /// them.
    pub split: Option<LightSplit>,
}

impl Illumination {
    /// The light rotated about world +Z by `degrees` (counter-clockwise seen from above) and scaled by `gain`, 0 or more.
    #[must_use]
    pub fn rotated_and_scaled(&self, degrees: f64, gain: f32) -> Self {
        let split = self.split.as_ref().map(|split| rotated(split, &self.environment, degrees));
        Self { environment: self.environment.rotated_and_scaled(degrees, gain), split }
    }

    /// The light with its map reduced to at most `rows` rows. A split is defined per texel, so a light with a split keeps the
    /// size of its map.
    #[must_use]
    pub fn with_at_most_rows(self, rows: usize) -> Self {
        match self.split {
            Some(_) => self,
            None => self.environment.at_most_rows(rows).into(),
        }
    }
}

impl From<EnvMap> for Illumination {
    fn from(environment: EnvMap) -> Self {
        Self { environment, split: None }
    }
}

impl From<&EnvMap> for Illumination {
    fn from(environment: &EnvMap) -> Self {
        environment.clone().into()
    }
}

impl From<&Self> for Illumination {
    fn from(light: &Self) -> Self {
        light.clone()
    }
}

/// The split of the rotated `map`: each light's radiance shifts along the columns as the map's does.
fn rotated(split: &LightSplit, map: &EnvMap, degrees: f64) -> LightSplit {
    let turn = ColumnShift::new(degrees.to_radians(), map.width());
    if split.is_empty() || turn.is_none() {
        return split.clone();
    }
    let whole = turn.apply(map.texels()).into_owned();
    let mut shares = vec![[0.0; MAX_LIGHTS]; whole.len()];
    for k in 0..split.lights.len() {
        let texels = map.texels().iter().zip(&split.shares);
        let of_light: Vec<[f32; 3]> = texels.map(|(l, shares)| l.map(|v| v * shares[k])).collect();
        for ((share, part), all) in shares.iter_mut().zip(&*turn.apply(&of_light)).zip(&whole) {
            let total = luminance(*all);
            share[k] = if total > 0.0 { (luminance(*part) / total).clamp(0.0, 1.0) } else { 0.0 };
        }
    }
    let lights = split.lights.iter().map(|light| {
        let d = DVec3::from(light.direction.map(f64::from));
        let d = glam::DQuat::from_rotation_z(degrees.to_radians()) * d;
        SplitLight { direction: d.to_array().map(|v| v as f32), radius: light.radius }
    });
    LightSplit { lights: lights.collect(), shares }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::tables_of_split;

    const SIZE: (usize, usize) = (32, 16);

    /// A dim sky with a lamp over four texels, all of whose radiance belongs to the light.
    fn lamp() -> Illumination {
        let at = 5 * SIZE.0 + 8;
        let bright = |t: usize| [at, at + 1, at + SIZE.0, at + SIZE.0 + 1].contains(&t);
        let texels = (0..SIZE.0 * SIZE.1).map(|t| if bright(t) { [90.0, 80.0, 60.0] } else { [0.5; 3] });
        let (environment, _) = EnvMap::new(SIZE.0, SIZE.1, texels.collect()).unwrap();
        let share = |t| if bright(t) { [1.0, 0.0, 0.0, 0.0] } else { [0.0; MAX_LIGHTS] };
        let direction = crate::uv_to_direction(9.0 / SIZE.0 as f64, 6.0 / SIZE.1 as f64);
        let light = SplitLight { direction: direction.to_array().map(|v| v as f32), radius: 0.1 };
        let split = LightSplit { lights: vec![light], shares: (0..SIZE.0 * SIZE.1).map(share).collect() };
        Illumination { environment, split: Some(split) }
    }

    fn tables(light: &Illumination) -> crate::light::LightTables {
        tables_of_split(&light.environment, light.split.as_ref().unwrap(), 2)
    }

    #[test]
    fn rotation_moves_the_separate_lights_with_the_map() {
        let light = lamp();
        for degrees in [11.25, 90.0, 33.0, -70.0] {
            let turned = light.rotated_and_scaled(degrees, 2.0);
            let split = turned.split.as_ref().unwrap();
            assert_eq!(split.fault(SIZE.0 * SIZE.1), None, "{degrees}");
            let (before, after) = (tables(&light).lights[0], tables(&turned).lights[0]);
            let ratio = after.irradiance[0] / before.irradiance[0];
            assert!((ratio - 2.0).abs() < 0.02, "{degrees}: {ratio}");
            let angle = |d: [f32; 3]| f64::from(d[1].atan2(d[0])).to_degrees();
            let moved = (angle(after.direction) - angle(before.direction) - degrees).rem_euclid(360.0);
            assert!(moved.min(360.0 - moved) < 0.01, "{degrees}: {moved}");
        }
    }

    #[test]
    fn a_small_rotation_changes_the_tables_little() {
        let light = lamp();
        let most = |a: &Illumination, b: &Illumination| {
            relume_compare::relative_error(&tables(a).diffuse, &tables(b).diffuse)
        };
        let (none, small, large) = (
            light.rotated_and_scaled(0.0, 1.0),
            light.rotated_and_scaled(0.1, 1.0),
            light.rotated_and_scaled(40.0, 1.0),
        );
        assert_eq!(none, light);
        assert!(most(&none, &small) < 0.01, "{}", most(&none, &small));
        assert_eq!(small.split.as_ref().unwrap().lights.len(), 1);
        let lost = Illumination { split: Some(LightSplit::default()), ..small.clone() };
        let without = most(&none, &lost);
        assert!(without.is_finite() && without > 0.05, "the control: without its split {without}");
        let moved = most(&none, &large);
        assert!(moved.is_finite() && moved > 0.05, "the control: a large rotation changes them by {moved}");
    }
}
