//! The texels of an environment, filled from pictures of the surroundings.

use glam::DVec3;

use relume_engine::linear_from_srgb;
use relume_scene::{DisplayRange, direction_to_uv, texel_directions};

/// Least coverage of a pixel that shows surroundings.
const MIN_COVERAGE: f32 = 0.5;
/// Display value over the white of the range from which a channel is clipped, and with it the pixel. Trained radiance is blurred, so a clipped region of
/// the photographs is a little darker than white.
const CLIPPED: f32 = 0.9;
/// Least share of a texel that surroundings must fill for their radiance to count.
const MIN_KNOWN_SHARE: f32 = 0.25;
/// Least share of a texel that clipped surroundings must fill for a source of light.
const MIN_CLIPPED_SHARE: f32 = 0.15;
/// Concentration of the weights by which texels that no photograph shows are filled: 1/e at 30 degrees.
const FILL_SHARPNESS: f64 = 7.5;

/// Sums over the pixels of each texel.
#[derive(Debug)]
pub(super) struct Texels {
    /// Columns and rows.
    pub(super) size: (usize, usize),
    range: DisplayRange,
    sums: Vec<TexelSum>,
}

/// What the pixels in a texel show, weighted by their solid angles.
#[derive(Debug, Clone, Copy, Default)]
struct TexelSum {
    radiance: [f32; 3],
    /// Solid angles of all pixels, of those with unclipped surroundings, and of those with clipped ones.
    all: f32,
    known: f32,
    clipped: f32,
    /// Sum of the directions of the clipped pixels.
    clipped_towards: DVec3,
}

impl Texels {
    /// Texels without pixels.
    pub(super) fn new(size: (usize, usize), range: DisplayRange) -> Self {
        Self { size, range, sums: vec![TexelSum::default(); size.0 * size.1] }
    }

    /// Adds a pixel in direction `ray`: its display colour over black, its coverage and its solid angle.
    pub(super) fn add(&mut self, ray: DVec3, colour: [f32; 3], coverage: f32, solid_angle: f32) {
        let (width, height) = self.size;
        let [u, v] = direction_to_uv(ray);
        let x = ((u * width as f64) as usize).min(width - 1);
        let y = ((v * height as f64) as usize).min(height - 1);
        let sum = &mut self.sums[y * width + x];
        sum.all += solid_angle;
        if !(coverage >= MIN_COVERAGE) {
            return;
        }
        let display = colour.map(|v| v / coverage);
        if display.iter().any(|v| *v > CLIPPED * self.range.white()) {
            sum.clipped += solid_angle;
            sum.clipped_towards += f64::from(solid_angle) * ray;
        } else {
            sum.known += solid_angle;
            (0..3).for_each(|c| sum.radiance[c] += solid_angle * linear_from_srgb(display[c].max(0.0)));
        }
    }

    /// Whether a texel is a source of light.
    pub(super) fn is_source(&self, texel: usize) -> bool {
        let sum = &self.sums[texel];
        sum.clipped > MIN_CLIPPED_SHARE * sum.all
    }

    /// Mean direction of the clipped pixels of a texel.
    pub(super) fn clipped_direction(&self, texel: usize) -> DVec3 {
        self.sums[texel].clipped_towards.normalize_or_zero()
    }

    /// Share of the sphere that the surroundings fill, clipped or not.
    pub(super) fn shown_share(&self) -> f32 {
        let sum = |of: fn(&TexelSum) -> f32| self.sums.iter().map(of).sum::<f32>();
        sum(|s| s.known + s.clipped) / sum(|s| s.all).max(f32::MIN_POSITIVE)
    }

    /// Linear radiance of each texel, `None` for a source. A texel that the surroundings do not fill has the mean of those that they
    /// fill, by nearness.
    pub(super) fn radiance(&self) -> Vec<Option<[f32; 3]>> {
        let (width, height) = self.size;
        let directions: Vec<DVec3> = texel_directions(width, height).into_iter().map(|(d, _)| d).collect();
        let known: Vec<(DVec3, [f32; 3])> =
            directions.iter().enumerate().filter_map(|(t, d)| Some((*d, self.known(t)?))).collect();
        let texel = |t: usize| match self.is_source(t) {
            true => None,
            false => self.known(t).or_else(|| filled(&known, directions[t])),
        };
        (0..self.sums.len()).map(texel).collect()
    }

    /// Mean radiance of a texel that unclipped surroundings fill.
    fn known(&self, texel: usize) -> Option<[f32; 3]> {
        let sum = &self.sums[texel];
        let is_known = sum.known > MIN_KNOWN_SHARE * sum.all && !self.is_source(texel);
        is_known.then(|| sum.radiance.map(|v| v / sum.known))
    }
}

/// Mean of `known` radiances, weighted by their nearness to `direction`; `None` if there are none.
fn filled(known: &[(DVec3, [f32; 3])], direction: DVec3) -> Option<[f32; 3]> {
    let (mut sum, mut weights) = ([0.0f64; 3], 0.0);
    for (at, radiance) in known {
        let weight = (FILL_SHARPNESS * (at.dot(direction) - 1.0)).exp();
        weights += weight;
        (0..3).for_each(|c| sum[c] += weight * f64::from(radiance[c]));
    }
    (weights > 0.0).then(|| sum.map(|v| (v / weights) as f32))
}
