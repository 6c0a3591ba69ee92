//! The ground below a model: its shadow, the light that it gets from the model, and its ambient occlusion (docs/MODEL.md, section 9).

use glam::DVec3;

use crate::render::{Frame, PreparedLight, Renderer};
use relume_engine::{GroundView, RasterCamera};
use relume_scene::light::light_cells;
use relume_scene::{Output, opaque_bottom};

/// Cells of the light, besides its strong small lights.
const CELLS: usize = 256;
/// Directions in which the ground sees the model.
const DIRECTIONS: usize = 256;
/// Greatest number of points of the ground. Larger frames interpolate between points.
const MAX_POINTS: usize = 1 << 19;
/// Least and greatest number of texels along a side of the pictures of a model that cast its shadow.
const SIDES: [usize; 2] = [128, 1024];
/// Texels along a side of the pictures that the ground sees. They are coarse, because their directions are far apart.
const SEEN_SIDE: usize = 64;
/// Radius of the ball in which the lowest point of a model is searched, normalised world.
const REACH: f64 = 4.0;

/// The planes of the ground, ready to be added to frames.
pub(super) struct GroundPlanes<'a> {
    pub(super) renderer: &'a Renderer,
    pub(super) light: &'a PreparedLight,
    pub(super) view: RasterCamera,
    /// Height of the ground, normalised world.
    pub(super) height: f32,
}

/// Values of a point of the ground.
#[derive(Clone, Copy)]
struct GroundPoint {
    shadow: [f32; 3],
    bounce: [f32; 3],
    contact: f32,
}

impl GroundPoint {
    /// A pixel without ground.
    const NONE: Self = Self { shadow: [1.0; 3], bounce: [0.0; 3], contact: 1.0 };

    fn mix(self, other: Self, share: f32) -> Self {
        let mix = |a: f32, b: f32| a + share * (b - a);
        Self {
            shadow: std::array::from_fn(|c| mix(self.shadow[c], other.shadow[c])),
            bounce: std::array::from_fn(|c| mix(self.bounce[c], other.bounce[c])),
            contact: mix(self.contact, other.contact),
        }
    }

    fn values(&self, output: Output) -> &[f32] {
        match output {
            Output::Shadow => &self.shadow,
            Output::Bounce => &self.bounce,
            _ => std::slice::from_ref(&self.contact),
        }
    }
}

impl Renderer {
    /// Height of the ground, capture units: the lowest point of the opaque Gaussians, without outliers.
    pub fn ground_height(&self) -> f64 {
        let model = self.model();
        let bottom = opaque_bottom(&model.gaussians, DVec3::ZERO, REACH).unwrap_or(-1.0);
        bottom / model.world_scale - model.world_offset.z
    }

    /// `height` in the normalised world; `None`: [`Self::ground_height`].
    pub(super) fn normalised_height(&self, height: Option<f64>) -> f32 {
        let model = self.model();
        ((height.unwrap_or_else(|| self.ground_height()) + model.world_offset.z) * model.world_scale) as f32
    }
}

impl GroundPlanes<'_> {
    /// Adds those of `outputs` that the ground has.
    pub(super) fn add_to(&self, frame: &mut Frame, outputs: &[Output]) {
        let outputs: Vec<Output> = outputs.iter().copied().filter(|output| output.is_of_ground()).collect();
        let points = self.points(&outputs);
        for output in outputs {
            frame
                .planes
                .insert(output, points.iter().flat_map(|point| point.values(output)).copied().collect());
        }
    }

    /// The values of each pixel, row-major.
    fn points(&self, outputs: &[Output]) -> Vec<GroundPoint> {
        let (width, height) = (self.view.width, self.view.height);
        let step =
            (1..).find(|step| width.div_ceil(*step) * height.div_ceil(*step) <= MAX_POINTS).unwrap_or(1);
        if step == 1 {
            let places: Vec<[f32; 2]> =
                (0..width * height).map(|i| [(i % width) as f32 + 0.5, (i / width) as f32 + 0.5]).collect();
            return self.values(&places, outputs);
        }
        // Nodes of a grid that covers the centres of all pixels.
        let (columns, rows) = ((width - 1) / step + 2, (height - 1) / step + 2);
        let place = |i: usize| [((i % columns) * step) as f32 + 0.5, ((i / columns) * step) as f32 + 0.5];
        let nodes = self.values(&(0..columns * rows).map(place).collect::<Vec<_>>(), outputs);
        let pixel = |i: usize| {
            let [(x, fx), (y, fy)] =
                [i % width, i / width].map(|k| (k / step, (k % step) as f32 / step as f32));
            let at = y * columns + x;
            nodes[at].mix(nodes[at + 1], fx).mix(nodes[at + columns].mix(nodes[at + columns + 1], fx), fy)
        };
        (0..width * height).map(pixel).collect()
    }

    /// The values at places of the image.
    fn values(&self, places: &[[f32; 2]], outputs: &[Output]) -> Vec<GroundPoint> {
        let hits: Vec<Option<[f32; 3]>> = places.iter().map(|place| self.hit(*place)).collect();
        let points: Vec<[f32; 3]> = hits.iter().flatten().copied().collect();
        let side = (self.view.width.max(self.view.height) / 2).clamp(SIDES[0], SIDES[1]);
        let found = self.of_ground(&points, outputs, side);
        let mut found = found.into_iter();
        hits.iter().map(|hit| hit.and_then(|_| found.next()).unwrap_or(GroundPoint::NONE)).collect()
    }

    /// The point of the ground at a place of the image; `None` above the horizon, and where the camera is below the ground.
    fn hit(&self, place: [f32; 2]) -> Option<[f32; 3]> {
        let (centre, ray) = (self.view.centre, self.view.ray_through(place));
        let along = (self.height - centre[2]) / ray[2];
        let is_hit = centre[2] > self.height && ray[2] < 0.0 && along.is_finite();
        is_hit.then(|| [centre[0] + along * ray[0], centre[1] + along * ray[1], self.height])
    }

    fn of_ground(&self, points: &[[f32; 3]], outputs: &[Output], side: usize) -> Vec<GroundPoint> {
        let host = self.renderer.host();
        let ground = host.ground(self.height);
        let cells = light_cells(&self.light.source, CELLS);
        let mut open = [0.0f32; 3];
        for cell in &cells {
            (0..3).for_each(|c| open[c] += cell.irradiance[c]);
        }
        // A channel without light has no shadow.
        let share = |value: f32, c: usize| if open[c] > 0.0 { value / open[c] } else { 1.0 };
        let mut values = vec![GroundPoint::NONE; points.len()];
        if outputs.contains(&Output::Shadow) {
            let received = ground.irradiance(points, &cells, side);
            for (value, received) in values.iter_mut().zip(received) {
                value.shadow = std::array::from_fn(|c| share(received[c], c));
            }
        }
        let with_bounce = outputs.contains(&Output::Bounce);
        if with_bounce || outputs.contains(&Output::Contact) {
            let light = with_bounce.then(|| self.renderer.light_on_host(self.light));
            let views = ground.views(points, &cosine_directions(DIRECTIONS), light, SEEN_SIDE);
            for (value, GroundView { open: contact, radiance }) in values.iter_mut().zip(views) {
                value.contact = contact;
                let irradiance = radiance.map(|v| v * std::f32::consts::PI);
                value.bounce =
                    std::array::from_fn(|c| if open[c] > 0.0 { irradiance[c] / open[c] } else { 0.0 });
            }
        }
        values
    }
}

/// `n` directions of the upper hemisphere with a density that is proportional to the cosine to +Z.
fn cosine_directions(n: usize) -> Vec<[f32; 3]> {
    let golden = std::f64::consts::PI * (3.0 - 5.0f64.sqrt());
    let direction = |i: usize| {
        let square = (i as f64 + 0.5) / n as f64;
        let (sin, cos) = (golden * i as f64).sin_cos();
        [square.sqrt() * cos, square.sqrt() * sin, (1.0 - square).sqrt()].map(|v| v as f32)
    };
    (0..n).map(direction).collect()
}

/// The points of the surface, capture units, row-major, from the depths of a frame.
pub(super) fn positions(view: &RasterCamera, depths: &[f32], (scale, offset): (f64, DVec3)) -> Vec<f32> {
    let point = |(i, depth): (usize, &f32)| {
        if !depth.is_finite() {
            return [0.0; 3];
        }
        let ray = view.ray(i % view.width, i / view.width);
        let centre = DVec3::from_array(view.centre.map(f64::from)) / scale - offset;
        let point = centre + DVec3::from_array(ray.map(f64::from)) * f64::from(*depth);
        point.to_array().map(|v| v as f32)
    };
    depths.iter().enumerate().flat_map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_have_the_density_of_the_cosine() {
        let directions = cosine_directions(512);
        let mean = |f: &dyn Fn(&[f32; 3]) -> f32| directions.iter().map(f).sum::<f32>() / 512.0;
        assert!((mean(&|d| d[2]) - 2.0 / 3.0).abs() < 0.01);
        assert!(mean(&|d| d[0]).abs() < 0.01 && mean(&|d| d[1]).abs() < 0.01);
        assert!(
            directions
                .iter()
                .all(|d| (d.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5 && d[2] > 0.0)
        );
    }
}
