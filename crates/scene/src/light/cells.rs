//! A light as the sum of lights from single directions, for surfaces that face up.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::light::{dominant_lights, luminance};
use crate::{EnvMap, Illumination, texel_directions};

/// Least number of rows of the map that is divided. Smaller maps are interpolated to this size.
const ROWS: usize = 128;
/// Directions of a strong small light.
const OF_LIGHT: usize = 48;

/// Light from a part of the upper hemisphere, as light from one direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightCell {
    /// Unit direction towards the light, above the horizon.
    pub direction: [f32; 3],
    /// Irradiance of a surface that faces +Z, W/m^2.
    pub irradiance: [f32; 3],
    /// Solid angle of the part, steradian.
    pub solid_angle: f32,
    /// Whether the part belongs to a strong small light.
    pub is_of_light: bool,
}

/// Divides the upper hemisphere of `light` into about `count` cells of nearly equal irradiance (median cut, after P. Debevec, "A Median Cut
/// Algorithm for Light Probe Sampling", 2006), and each strong small light into directions of its disc. The irradiances add up to that of a
/// surface which faces up. The cells of lights come first. Empty where no light comes from above.
pub fn light_cells(light: &Illumination, count: usize) -> Vec<LightCell> {
    let (rest, lights) = dominant_lights(light);
    let mut cells = Vec::new();
    for light in &lights {
        let towards = DVec3::from(light.direction.map(f64::from));
        cells.extend(disc(towards, f64::from(light.radius)).into_iter().filter(|d| d.z > 0.0).map(|d| {
            let share = d.z / OF_LIGHT as f64;
            LightCell {
                direction: d.to_array().map(|v| v as f32),
                irradiance: light.irradiance.map(|e| (f64::from(e) * share) as f32),
                solid_angle: PI as f32 * light.radius * light.radius / OF_LIGHT as f32,
                is_of_light: true,
            }
        }));
    }
    cells.extend(median_cut(&rest, count));
    cells
}

/// Directions spread evenly over a disc of angular radius `radius`, radians.
fn disc(towards: DVec3, radius: f64) -> Vec<DVec3> {
    let (u, v) = towards.any_orthonormal_pair();
    let at = |[x, y]: [f64; 2]| {
        let scale = radius.tan();
        (towards + scale * (x * u + y * v)).normalize()
    };
    disc_points(OF_LIGHT).map(at).collect()
}

/// `n` points spread evenly over the unit disc (golden angle).
pub fn disc_points(n: usize) -> impl Iterator<Item = [f64; 2]> {
    let golden = PI * (3.0 - 5.0f64.sqrt());
    (0..n).map(move |i| {
        let (sin, cos) = (golden * i as f64).sin_cos();
        let r = ((i as f64 + 0.5) / n as f64).sqrt();
        [r * cos, r * sin]
    })
}

/// Texels of a rectangle of the map.
#[derive(Debug, Clone, Copy)]
struct Region {
    columns: [usize; 2],
    rows: [usize; 2],
    /// Luminance of the irradiance.
    power: f64,
}

/// The upper half of a map: directions, and irradiance of a surface that faces up.
struct UpperHalf {
    width: usize,
    height: usize,
    /// Direction, solid angle and irradiance of each texel.
    texels: Vec<(DVec3, f64, [f64; 3])>,
}

impl UpperHalf {
    fn new(map: &EnvMap) -> Self {
        let fine = (map.height() < ROWS).then(|| EnvMap::from_fn(2 * ROWS, ROWS, |d| map.sample(d)));
        let map = fine.as_ref().unwrap_or(map);
        let (width, height) = (map.width(), map.height().div_ceil(2));
        let texels = texel_directions(width, map.height()).into_iter().zip(map.texels());
        let received = |((d, w), l): ((DVec3, f64), &[f32; 3])| {
            (d, w, l.map(|radiance| f64::from(radiance) * w * d.z.max(0.0)))
        };
        Self { width, height, texels: texels.map(received).take(width * height).collect() }
    }

    /// The sums over the rows or columns of a region along `axis` (0: one sum per column).
    fn marginal(&self, region: &Region, axis: usize) -> Vec<f64> {
        let [x0, x1] = region.columns;
        let first = [x0, region.rows[0]][axis];
        let mut sums = vec![0.0; [x1, region.rows[1]][axis] - first];
        for y in region.rows[0]..region.rows[1] {
            for x in x0..x1 {
                let power = self.texels[y * self.width + x].2;
                sums[[x, y][axis] - first] += luminance(power.map(|v| v as f32)) as f64;
            }
        }
        sums
    }

    /// Divides a region across its longer side so that both parts have about the same power. `None` for a single texel.
    fn halves(&self, region: &Region) -> Option<[Region; 2]> {
        let [columns, rows] = [region.columns, region.rows].map(|[a, b]| b - a);
        let middle = (region.rows[0] + region.rows[1]) as f64 / (4 * self.height) as f64 * PI;
        let sides = [
            columns as f64 * TAU / self.width as f64 * middle.sin(),
            rows as f64 * 0.5 * PI / self.height as f64,
        ];
        let axis = match (columns, rows) {
            (0 | 1, 0 | 1) => return None,
            (0 | 1, _) => 1,
            (_, 0 | 1) => 0,
            _ => usize::from(sides[1] > sides[0]),
        };
        let sums = self.marginal(region, axis);
        let mut reached = 0.0;
        let mut before = |sum: &f64| {
            reached += sum;
            reached < 0.5 * region.power
        };
        let cut = sums.iter().take_while(|sum| before(sum)).count().clamp(1, sums.len() - 1);
        let of_first: f64 = sums[..cut].iter().sum();
        let of_second: f64 = sums[cut..].iter().sum();
        let (mut first, mut second) = (*region, *region);
        (first.power, second.power) = (of_first, of_second);
        match axis {
            0 => (first.columns[1], second.columns[0]) = (region.columns[0] + cut, region.columns[0] + cut),
            _ => (first.rows[1], second.rows[0]) = (region.rows[0] + cut, region.rows[0] + cut),
        }
        Some([first, second])
    }

    /// The light of a region; `None` for a dark one.
    fn cell(&self, region: &Region) -> Option<LightCell> {
        let (mut moment, mut irradiance, mut solid_angle) = (DVec3::ZERO, [0.0; 3], 0.0);
        for y in region.rows[0]..region.rows[1] {
            for (d, w, power) in &self.texels[y * self.width..][region.columns[0]..region.columns[1]] {
                moment += *d * power.iter().sum::<f64>();
                (0..3).for_each(|c| irradiance[c] += power[c]);
                solid_angle += w;
            }
        }
        let direction = moment.try_normalize()?.to_array().map(|v| v as f32);
        Some(LightCell {
            direction,
            irradiance: irradiance.map(|v| v as f32),
            solid_angle: solid_angle as f32,
            is_of_light: false,
        })
    }
}

fn median_cut(map: &EnvMap, count: usize) -> Vec<LightCell> {
    let half = UpperHalf::new(map);
    let whole = Region { columns: [0, half.width], rows: [0, half.height], power: 0.0 };
    let power = half.marginal(&whole, 1).iter().sum();
    let (mut open, mut done) = (vec![Region { power, ..whole }], Vec::new());
    while !open.is_empty() && open.len() + done.len() < count {
        let brighter = |best: usize, i: usize| if open[i].power > open[best].power { i } else { best };
        let at = (1..open.len()).fold(0, brighter);
        let region = open.swap_remove(at);
        match half.halves(&region) {
            Some(parts) => open.extend(parts),
            None => done.push(region),
        }
    }
    done.iter().chain(&open).filter_map(|region| half.cell(region)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Irradiance of a surface that faces up.
    fn irradiance(map: &EnvMap) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for ((d, w), l) in texel_directions(map.width(), map.height()).into_iter().zip(map.texels()) {
            (0..3).for_each(|c| sum[c] += f64::from(l[c]) * w * d.z.max(0.0));
        }
        sum
    }

    fn sky(rows: usize) -> EnvMap {
        let sun = DVec3::new(0.5, -0.4, 0.7).normalize();
        EnvMap::from_fn(2 * rows, rows, |d| {
            let sun = if d.dot(sun) > 2.0f64.to_radians().cos() { 900.0 } else { 0.0 };
            [0.4 + sun, 0.5 + 0.9 * sun, 0.9 + 0.3 * d.x as f32 + 0.7 * sun]
        })
    }

    #[test]
    fn cells_have_the_irradiance_of_the_map() {
        for (rows, tolerance) in [(256, 0.01), (32, 0.05)] {
            let map = sky(rows);
            let cells = light_cells(&Illumination::from(&map), 200);
            assert!((200..=250).contains(&cells.len()), "{}", cells.len());
            let wanted = irradiance(&map);
            for c in 0..3 {
                let found: f64 = cells.iter().map(|cell| f64::from(cell.irradiance[c])).sum();
                assert!((found / wanted[c] - 1.0).abs() < tolerance, "{rows} rows: {found} {}", wanted[c]);
            }
            assert!(cells.iter().all(|cell| cell.direction[2] > 0.0));
        }
    }

    #[test]
    fn cells_of_a_smooth_sky_have_nearly_equal_irradiance() {
        let cells = light_cells(&EnvMap::constant(64, 32, [1.0; 3]).into(), 128);
        let of = |cell: &LightCell| f64::from(cell.irradiance[0]) * 128.0 / PI;
        assert_eq!(cells.len(), 128);
        let sum: f32 = cells.iter().map(|cell| cell.solid_angle).sum();
        assert!((f64::from(sum) / TAU - 1.0).abs() < 1e-4, "{sum}");
        assert!(
            cells.iter().all(|cell| (0.5..2.0).contains(&of(cell))),
            "{:?}",
            cells.iter().map(of).collect::<Vec<_>>()
        );
    }

    #[test]
    fn light_below_the_horizon_has_no_cells() {
        let below = EnvMap::from_fn(256, 128, |d| if d.z < 0.0 { [5.0; 3] } else { [0.0; 3] });
        assert!(light_cells(&below.into(), 64).is_empty());
    }

    #[test]
    fn directions_of_a_disc_stay_in_it() {
        let towards = DVec3::new(0.0, 0.6, 0.8);
        let directions = disc(towards, 0.1);
        let angles: Vec<f64> = directions.iter().map(|d| d.angle_between(towards)).collect();
        assert!(angles.iter().all(|a| *a < 0.1), "{angles:?}");
        let square = angles.iter().map(|a| a * a).sum::<f64>() / angles.len() as f64;
        assert!((square / (0.5 * 0.01) - 1.0).abs() < 0.05, "the spread of a disc: {square}");
    }
}
