//! Extraction of dominant lights (strong and small) from an environment, so that each light can cast its own shadow.

use std::f64::consts::PI;
use std::ops::Range;

use glam::DVec3;

use crate::light::map_rows::{LIGHT_SEARCH_ROWS, MIN_LIGHT_SEARCH_ROWS};
use crate::{EnvMap, texel_directions};

/// Angular radius of the disc from which a light is extracted, radians.
const RADIUS: f64 = 4.0 * PI / 180.0;
/// Smallest ratio of the mean brightness of a light's disc to that of the ring around it.
const CONTRAST: f64 = 4.0;
/// Smallest share of all power of a light's excess over the ring.
const MIN_POWER_SHARE: f64 = 0.01;
/// Number of rejected bright spots at which the search ends.
const MAX_REJECTED_SPOTS: usize = 8;

/// A distant small light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DominantLight {
    /// Unit direction towards it.
    pub direction: DVec3,
    /// Irradiance of a surface that faces it, W/m^2: radiance times solid angle.
    pub irradiance: [f64; 3],
    /// Angular radius of a disc with the same angular spread, radians.
    pub radius: f64,
}

/// Dominant lights and the rest. Their powers add up to the power of the map.
#[derive(Debug, Clone, PartialEq)]
pub struct SplitEnvironment {
    /// Strongest texel first.
    pub lights: Vec<DominantLight>,
    /// The remaining map, of at most 512 rows.
    pub rest: EnvMap,
}

impl SplitEnvironment {
    /// Extracts at most `most` lights from `map`: spots of a few degrees that are much brighter than their surroundings and
    /// hold 1 % of the power or more. Maps below 32 rows are not split.
    pub fn new(map: &EnvMap, most: usize) -> Self {
        let map = match map.height() > LIGHT_SEARCH_ROWS {
            true => map.resampled((map.width() * LIGHT_SEARCH_ROWS / map.height()).max(1), LIGHT_SEARCH_ROWS),
            false => map.clone(),
        };
        if map.height() < MIN_LIGHT_SEARCH_ROWS {
            return Self { lights: Vec::new(), rest: map };
        }
        let mut search = LightExtraction::new(&map);
        let (mut lights, mut refused) = (Vec::new(), 0);
        while lights.len() < most && refused < MAX_REJECTED_SPOTS {
            let Some(brightest) = search.brightest() else { break };
            match search.take(brightest) {
                Some(light) => lights.push(light),
                None => refused += 1,
            }
        }
        Self { lights, rest: search.rest() }
    }
}

/// The map during the extraction of lights.
struct LightExtraction {
    width: usize,
    height: usize,
    directions: Vec<(DVec3, f64)>,
    texels: Vec<[f32; 3]>,
    /// True for texels that belong to no light and to no rejected spot.
    open: Vec<bool>,
    /// Power of the whole map, mean of the channels.
    power: f64,
    radius: f64,
}

fn brightness(texel: [f32; 3]) -> f64 {
    texel.iter().map(|v| f64::from(*v)).sum::<f64>() / 3.0
}

impl LightExtraction {
    fn new(map: &EnvMap) -> Self {
        let directions = texel_directions(map.width(), map.height());
        let power = directions.iter().zip(map.texels()).map(|((_, w), t)| w * brightness(*t)).sum();
        Self {
            width: map.width(),
            height: map.height(),
            texels: map.texels().to_vec(),
            open: vec![true; directions.len()],
            power,
            radius: RADIUS.max(0.75 * PI / map.height() as f64),
            directions,
        }
    }

    /// The brightest open texel, the first of equals; `None` when all are dark.
    fn brightest(&self) -> Option<usize> {
        let mut best = (None, 0.0);
        for (i, texel) in self.texels.iter().enumerate() {
            let b = brightness(*texel);
            if self.open[i] && b > best.1 {
                best = (Some(i), b);
            }
        }
        best.0
    }

    /// Extracts the excess over the ring around texel `centre` as a light, or rejects the spot.
    fn take(&mut self, centre: usize) -> Option<DominantLight> {
        let towards = self.directions[centre].0;
        let (inner, outer) = (self.radius.cos(), (2.0 * self.radius).cos());
        let (mut disc, mut disc_area) = (Vec::new(), 0.0);
        let (mut ring, mut ring_area) = ([0.0f64; 3], 0.0);
        for i in self.rows_around(centre, 2.0 * self.radius) {
            let (d, w) = self.directions[i];
            let cos = towards.dot(d);
            if cos >= inner {
                disc.push(i);
                disc_area += w;
            } else if cos >= outer {
                (0..3).for_each(|c| ring[c] += w * f64::from(self.texels[i][c]));
                ring_area += w;
            }
        }
        disc.iter().for_each(|&i| self.open[i] = false);
        let level = ring.map(|sum| (sum / ring_area.max(1e-12)) as f32);
        let excess = |t: [f32; 3], c: usize| (f64::from(t[c]) - f64::from(level[c])).max(0.0);
        let mut light = [0.0f64; 3];
        let (mut moment, mut spread) = (DVec3::ZERO, 0.0);
        for &i in &disc {
            let (d, w) = self.directions[i];
            let part: [f64; 3] = std::array::from_fn(|c| w * excess(self.texels[i], c));
            (0..3).for_each(|c| light[c] += part[c]);
            moment += d * part.iter().sum::<f64>();
        }
        let sum: f64 = light.iter().sum();
        let stands_out = sum / 3.0 >= (CONTRAST - 1.0) * brightness(level) * disc_area;
        if !(sum / 3.0 >= MIN_POWER_SHARE * self.power && sum > 0.0 && stands_out) {
            return None;
        }
        let direction = moment.normalize_or(towards);
        for &i in &disc {
            let (d, w) = self.directions[i];
            // A texel adds the spread of a disc of its area.
            let square = d.angle_between(direction).powi(2) + w / (2.0 * PI);
            spread += square * w * (0..3).map(|c| excess(self.texels[i], c)).sum::<f64>();
            self.texels[i] = std::array::from_fn(|c| self.texels[i][c].min(level[c]));
        }
        // A disc's mean square distance from its centre is half its radius squared.
        Some(DominantLight { direction, irradiance: light, radius: (2.0 * spread / sum).sqrt() })
    }

    /// The texels of all rows that contain a texel within `radius` radians of texel `centre`.
    fn rows_around(&self, centre: usize, radius: f64) -> Range<usize> {
        let (row, reach) = (centre / self.width, (radius / PI * self.height as f64).ceil() as usize);
        let (first, last) = (row.saturating_sub(reach), (row + reach).min(self.height - 1));
        first * self.width..(last + 1) * self.width
    }

    fn rest(self) -> EnvMap {
        let map = EnvMap::new(self.width, self.height, self.texels);
        // Unreachable: extraction only reduces the texels of a checked map.
        map.map_or_else(|_| EnvMap::constant(self.width, self.height, [0.0; 3]), |(map, _)| map)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn power(map: &EnvMap) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for (t, (_, w)) in map.texels().iter().zip(texel_directions(map.width(), map.height())) {
            (0..3).for_each(|k| sum[k] += f64::from(t[k]) * w);
        }
        sum
    }

    fn towards(x: f64, y: f64, z: f64) -> DVec3 {
        DVec3::new(x, y, z).normalize()
    }

    /// A sky with a sun, a lamp and a broad window.
    fn sky(rows: usize) -> EnvMap {
        let (sun, lamp, window) = (towards(1.0, 0.2, 0.8), towards(-1.0, 1.0, 0.1), towards(0.0, -1.0, 0.5));
        let spot = |d: DVec3, at: DVec3, degrees: f64| {
            f64::from(d.dot(at) > (degrees.max(120.0 / rows as f64)).to_radians().cos()) as f32
        };
        EnvMap::from_fn(2 * rows, rows, |d| {
            let [s, l, w] = [spot(d, sun, 1.0), spot(d, lamp, 2.0), spot(d, window, 25.0)];
            [
                0.5 + 3e3 * s + 200.0 * l + 6.0 * w,
                0.6 + 28e2 * s + 99.0 * l + 6.0 * w,
                0.9 + 2e3 * s + 5.0 * w,
            ]
        })
    }

    #[test]
    fn separate_lights_and_remainder_have_the_total_power() {
        for rows in [32, 128, 700] {
            let map = sky(rows);
            let split = SplitEnvironment::new(&map, 8);
            assert!(!split.lights.is_empty(), "{rows} rows");
            let (all, rest) = (power(&map), power(&split.rest));
            for c in 0..3 {
                let sum = rest[c] + split.lights.iter().map(|l| l.irradiance[c]).sum::<f64>();
                assert!((sum / all[c] - 1.0).abs() < 1e-5, "{rows} rows: {sum} of {}", all[c]);
                assert!(rest[c] < 0.9 * all[c], "the control: the rest alone has less");
            }
        }
    }

    #[test]
    fn sun_and_lamp_are_separated_and_window_and_sky_are_not() {
        let split = SplitEnvironment::new(&sky(256), 8);
        let found: Vec<DVec3> = split.lights.iter().map(|l| l.direction).collect();
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found[0].angle_between(towards(1.0, 0.2, 0.8)) < 0.01);
        assert!(found[1].angle_between(towards(-1.0, 1.0, 0.1)) < 0.01);
        let degrees = split.lights[1].radius.to_degrees();
        assert!((degrees - 2.0).abs() < 0.3, "a disc of 2 degrees, not {degrees}");
        assert_eq!(SplitEnvironment::new(&sky(256), 1).lights.len(), 1);
        assert!(SplitEnvironment::new(&EnvMap::constant(128, 64, [1.0; 3]), 8).lights.is_empty());
        assert!(SplitEnvironment::new(&EnvMap::constant(128, 64, [0.0; 3]), 8).lights.is_empty());
        assert!(SplitEnvironment::new(&sky(16), 8).lights.is_empty(), "too coarse to tell");
    }

    #[test]
    fn extreme_texel_gives_a_finite_light() {
        let mut texels = vec![[0.0f32; 3]; 64 * 32];
        texels[500] = [1e30; 3];
        let split = SplitEnvironment::new(&EnvMap::new(64, 32, texels).unwrap().0, 8);
        assert_eq!(split.lights.len(), 1);
        assert!(split.lights[0].irradiance.iter().all(|v| v.is_finite() && *v > 1e26));
    }
}
