//! Light tables for rendering, with dominant lights split off.

use crate::light::{DominantLight, LightTables, SplitEnvironment, TableLight, rendering_tables};
use crate::{EnvMap, Illumination, LightSplit, MAX_LIGHTS, SplitLight, texel_directions};

/// The tables of `map` for visibility fields of degree `sh_degree`, and at most [`MAX_LIGHTS`] dominant lights. Tables and
/// lights together have the power of the map.
pub fn split_tables(map: &EnvMap, sh_degree: usize) -> LightTables {
    let (rest, lights) = found_lights(map);
    LightTables { lights, ..rendering_tables(rest.as_ref().unwrap_or(map), sh_degree) }
}

/// The tables of `map` with the given split, which must fit the map's texels.
pub fn tables_of_split(map: &EnvMap, split: &LightSplit, sh_degree: usize) -> LightTables {
    let (rest, lights) = known_lights(map, split);
    LightTables { lights, ..rendering_tables(rest.as_ref().unwrap_or(map), sh_degree) }
}

/// The dominant lights of `light`, at most [`MAX_LIGHTS`], and the map of the rest: by the split of the light if it has one, otherwise
/// as they are found in its map.
pub fn dominant_lights(light: &Illumination) -> (EnvMap, Vec<TableLight>) {
    let map = &light.environment;
    let (rest, lights) = match &light.split {
        Some(split) => known_lights(map, split),
        None => found_lights(map),
    };
    (rest.unwrap_or_else(|| map.clone()), lights)
}

/// The lights that stand out of `map`, and the rest; `None` for the map itself.
fn found_lights(map: &EnvMap) -> (Option<EnvMap>, Vec<TableLight>) {
    let SplitEnvironment { lights, rest } = SplitEnvironment::new(map, MAX_LIGHTS);
    let lights: Vec<TableLight> = lights.iter().map(TableLight::from).collect();
    ((!lights.is_empty()).then_some(rest), lights)
}

/// The lights of `split`, and the rest; `None` for the map itself.
fn known_lights(map: &EnvMap, split: &LightSplit) -> (Option<EnvMap>, Vec<TableLight>) {
    let texels = map.texels().iter().enumerate();
    let rest = texels.map(|(t, l)| l.map(|v| v * split.rest(t))).collect();
    let Ok((rest, _)) = EnvMap::new(map.width(), map.height(), rest) else {
        // Unreachable: the split only reduces the texels of a checked map.
        return (None, Vec::new());
    };
    let mut lights: Vec<TableLight> = split
        .lights
        .iter()
        .map(|l| TableLight { direction: l.direction, radius: l.radius, irradiance: [0.0; 3] })
        .collect();
    let directions = texel_directions(map.width(), map.height());
    for ((l, (_, w)), shares) in map.texels().iter().zip(directions).zip(&split.shares) {
        for (light, share) in lights.iter_mut().zip(shares) {
            (0..3).for_each(|c| light.irradiance[c] += share * w as f32 * l[c]);
        }
    }
    (Some(rest), lights)
}

impl From<&DominantLight> for SplitLight {
    fn from(light: &DominantLight) -> Self {
        Self { direction: light.direction.to_array().map(|v| v as f32), radius: light.radius as f32 }
    }
}

impl From<&DominantLight> for TableLight {
    fn from(light: &DominantLight) -> Self {
        Self {
            direction: light.direction.to_array().map(|v| v as f32),
            radius: light.radius as f32,
            irradiance: light.irradiance.map(|v| v as f32),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sun_becomes_a_separate_light_and_leaves_the_tables() {
        let sky = EnvMap::from_fn(128, 64, |d| [1.0 + if d.z > 0.998 { 900.0 } else { 0.0 }; 3]);
        let (split, whole) = (split_tables(&sky, 1), rendering_tables(&sky, 1));
        assert_eq!(split.lights.len(), 1);
        assert!(split.specular[0].iter().all(|v| v[0] < 1.1));
        assert!(whole.specular[0].iter().any(|v| v[0] > 10.0));
        let plain = EnvMap::constant(128, 64, [1.0; 3]);
        assert_eq!(split_tables(&plain, 1), rendering_tables(&plain, 1), "the control: nothing stands out");
    }

    #[test]
    fn known_split_preserves_the_total_power() {
        let sky = EnvMap::from_fn(16, 8, |d| [1.0 + d.x as f32, 2.0, 1.0 - d.y as f32]);
        let mut shares = vec![[0.0; MAX_LIGHTS]; 128];
        (40..44).for_each(|t| shares[t] = [0.5, 0.25, 0.0, 0.0]);
        let light = SplitLight { direction: [0.0, 0.0, 1.0], radius: 0.1 };
        let split = LightSplit { lights: vec![light; 2], shares };
        let tables = tables_of_split(&sky, &split, 0);
        let whole = rendering_tables(&sky, 0);
        let sum = |t: &LightTables| -> f32 { t.diffuse.iter().step_by(t.coefficients * 3).sum() };
        assert!(sum(&tables) < sum(&whole) * 0.999);
        let taken = texel_directions(16, 8)[40..44].to_vec();
        let all: f64 = taken.iter().zip(40..).map(|((_, w), t)| w * f64::from(sky.texels()[t][1])).sum();
        assert!((f64::from(tables.lights[0].irradiance[1]) - 0.5 * all).abs() < 1e-6);
        assert!((f64::from(tables.lights[1].irradiance[1]) - 0.25 * all).abs() < 1e-6);
        assert_eq!(tables_of_split(&sky, &LightSplit::default(), 0), whole);
    }
}
