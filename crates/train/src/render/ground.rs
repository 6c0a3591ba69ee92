//! The ground below a model: its shadow, the light that it gets from the model, and its ambient occlusion (docs/MODEL.md, section 9).

use glam::DVec3;

use crate::render::lamps_on_ground::LampsOnGround;
use crate::render::{Frame, PreparedLight, Renderer};
use relume_engine::{Ground, GroundRadiance, GroundView, RasterCamera};
use relume_scene::Output;
use relume_scene::light::{LightCell, disc_points, light_cells};
use relume_spec::rendering::Lamp;

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

/// The planes of the ground of a frame, computed in steps of a fraction of a second.
pub(super) struct GroundPlanes<'a> {
    /// Those of the requested outputs that the ground has.
    outputs: Vec<Output>,
    size: (usize, usize),
    /// Pixels between computed places.
    step: usize,
    /// For each place, whether it shows the ground.
    hits: Vec<bool>,
    /// The points of the ground at the places that show it, normalised world.
    points: Vec<[f32; 3]>,
    ground: Ground,
    /// Most texels along a side of the pictures for shadows.
    side: usize,
    cells: Vec<LightCell>,
    directions: Vec<[f32; 3]>,
    radiance: Option<GroundRadiance<'a>>,
    /// Irradiance of the points: of the strong small lights, and of the rest.
    received: [Vec<[f32; 3]>; 2],
    views: Vec<GroundView>,
    lamps: Option<LampsOnGround>,
    /// Cells and directions that are done.
    done: [usize; 2],
}

/// Values of a point of the ground.
#[derive(Clone, Copy)]
struct GroundPoint {
    shadow: [f32; 3],
    /// Its parts: light of the strong small lights and of the rest.
    parts: [[f32; 3]; 2],
    bounce: [f32; 3],
    contact: f32,
    lamp_light: [f32; 3],
    lamp_shadow: [f32; 3],
}

impl GroundPoint {
    fn mix(self, other: Self, share: f32) -> Self {
        let mix = |a: f32, b: f32| a + share * (b - a);
        let mix_colours = |a: [f32; 3], b: [f32; 3]| std::array::from_fn(|c| mix(a[c], b[c]));
        Self {
            shadow: mix_colours(self.shadow, other.shadow),
            parts: std::array::from_fn(|k| mix_colours(self.parts[k], other.parts[k])),
            bounce: mix_colours(self.bounce, other.bounce),
            contact: mix(self.contact, other.contact),
            lamp_light: mix_colours(self.lamp_light, other.lamp_light),
            lamp_shadow: mix_colours(self.lamp_shadow, other.lamp_shadow),
        }
    }

    fn add_to(&self, plane: &mut Vec<f32>, output: Output) {
        let [key, fill] = self.parts;
        match output {
            Output::Shadow => plane.extend(self.shadow),
            Output::ShadowKey => plane.extend(key),
            Output::ShadowFill => plane.extend(fill),
            Output::Bounce => plane.extend(self.bounce),
            Output::LampLight => plane.extend(self.lamp_light),
            Output::LampShadow => plane.extend(self.lamp_shadow),
            _ => plane.push(self.contact),
        }
    }
}

impl<'a> GroundPlanes<'a> {
    /// Prepares the planes among `outputs` for the ground at `height`, normalised world, under a map and lamps.
    pub(super) fn new(
        renderer: &'a Renderer,
        (light, lamps): (&'a PreparedLight, &[Lamp]),
        view: &RasterCamera,
        height: f32,
        outputs: &[Output],
    ) -> Self {
        let outputs: Vec<Output> = outputs.iter().copied().filter(|output| output.is_of_ground()).collect();
        let size @ (width, height_px) = (view.width, view.height);
        let fits = |step: &usize| width.div_ceil(*step) * height_px.div_ceil(*step) <= MAX_POINTS;
        let step = (1..).find(fits).unwrap_or(1);
        let (columns, rows) = nodes(size, step);
        let place = |i: usize| [((i % columns) * step) as f32 + 0.5, ((i / columns) * step) as f32 + 0.5];
        let hits: Vec<_> = (0..columns * rows).map(|i| hit(view, height, place(i))).collect();
        let points: Vec<[f32; 3]> = hits.iter().flatten().copied().collect();
        let is_asked = |asked: &[Output]| asked.iter().any(|output| outputs.contains(output));
        let has_shadow = is_asked(&[Output::Shadow, Output::ShadowKey, Output::ShadowFill]);
        let has_views = is_asked(&[Output::Bounce, Output::Contact]);
        let has_radiance = is_asked(&[Output::Bounce]);
        let has_lamps = !lamps.is_empty() && is_asked(&[Output::LampLight, Output::LampShadow]);
        let ground = renderer.host().ground(height);
        let on_ground = || LampsOnGround::new(lamps, renderer.model(), &ground, points.len());
        Self {
            size,
            step,
            hits: hits.iter().map(Option::is_some).collect(),
            lamps: has_lamps.then(on_ground),
            ground,
            side: (width.max(height_px) / 2).clamp(SIDES[0], SIDES[1]),
            cells: light_cells(&light.source, CELLS),
            directions: if has_views { cosine_directions(DIRECTIONS) } else { Vec::new() },
            radiance: has_radiance.then(|| GroundRadiance::new(renderer.light_on_host(light))),
            received: [0, 1].map(|_| if has_shadow { vec![[0.0; 3]; points.len()] } else { Vec::new() }),
            views: if has_views { vec![GroundView::default(); points.len()] } else { Vec::new() },
            points,
            outputs,
            done: [0; 2],
        }
    }

    /// Computes a group of directions, or a part of the light of a lamp. Returns false when all are done.
    pub(super) fn step(&mut self) -> bool {
        let next = |done: usize, count: usize| done..(done + self.ground.group(self.side)).min(count);
        let cells = if self.received[0].is_empty() { 0 } else { self.cells.len() };
        let directions = if self.views.is_empty() { 0 } else { self.directions.len() };
        if self.done[0] < cells {
            let of_lights = self.cells.iter().take_while(|cell| cell.is_of_light).count();
            let is_key = self.done[0] < of_lights;
            let group = next(self.done[0], if is_key { of_lights } else { cells });
            self.done[0] = group.end;
            let received = &mut self.received[usize::from(!is_key)];
            self.ground.add_irradiance(received, &self.points, &self.cells[group], self.side);
        } else if self.done[1] < directions {
            let group = next(self.done[1], directions);
            self.done[1] = group.end;
            let (directions, light) = (&self.directions[group], self.radiance.as_ref());
            self.ground.add_views(&mut self.views, &self.points, directions, light, SEEN_SIDE);
        } else {
            return self.lamps.as_mut().is_some_and(|lamps| lamps.step(&self.points));
        }
        self.lamps.is_some() || self.done[0] < cells || self.done[1] < directions
    }

    /// Adds the planes to `frame`.
    pub(super) fn add_to(self, frame: &mut Frame) {
        let (open, of_points) = self.of_points();
        let mut of_points = of_points.into_iter();
        let is_hit = |hit: &bool| if *hit { of_points.next() } else { None };
        let places: Vec<GroundPoint> =
            self.hits.iter().map(is_hit).map(|point| point.unwrap_or(open)).collect();
        let (width, height) = self.size;
        let columns = nodes(self.size, self.step).0;
        let pixel = |i: usize| {
            let part = |k: usize| (k / self.step, (k % self.step) as f32 / self.step as f32);
            let [(x, fx), (y, fy)] = [part(i % width), part(i / width)];
            let at = y * columns + x;
            if self.step == 1 {
                return places[at];
            }
            let [top, bottom] = [at, at + columns].map(|at| places[at].mix(places[at + 1], fx));
            top.mix(bottom, fy)
        };
        for output in &self.outputs {
            let mut plane = Vec::with_capacity(width * height * output.channels());
            (0..width * height).for_each(|i| pixel(i).add_to(&mut plane, *output));
            frame.planes.insert(*output, plane);
        }
    }

    /// The values of a pixel without ground, and those of the points.
    fn of_points(&self) -> (GroundPoint, Vec<GroundPoint>) {
        let mut sums = [[0.0f32; 3]; 2];
        for cell in &self.cells {
            let sum = &mut sums[usize::from(!cell.is_of_light)];
            (0..3).for_each(|c| sum[c] += cell.irradiance[c]);
        }
        let open: [f32; 3] = std::array::from_fn(|c| sums[0][c] + sums[1][c]);
        // A channel without light has no shadow and no bounce.
        let share = |value: f32, c: usize, dark: f32| if open[c] > 0.0 { value / open[c] } else { dark };
        let lit = |received: [[f32; 3]; 2]| {
            let all = |c: usize| share(received[0][c] + received[1][c], c, 1.0);
            // A channel without light has all of its shadow in the part of the rest.
            let part = |k: usize| std::array::from_fn(|c| share(received[k][c], c, [0.0, 1.0][k]));
            GroundPoint {
                shadow: std::array::from_fn(all),
                parts: [0, 1].map(part),
                bounce: [0.0; 3],
                contact: 1.0,
                lamp_light: [0.0; 3],
                lamp_shadow: [1.0; 3],
            }
        };
        let without_ground = lit(sums);
        let mut points = vec![without_ground; self.points.len()];
        for (point, (key, fill)) in points.iter_mut().zip(self.received[0].iter().zip(&self.received[1])) {
            *point = lit([*key, *fill]);
        }
        for (point, view) in points.iter_mut().zip(&self.views) {
            let GroundView { open: contact, radiance } = view.mean(self.directions.len());
            point.contact = contact;
            point.bounce = std::array::from_fn(|c| share(std::f32::consts::PI * radiance[c], c, 0.0));
        }
        let of_lamps = self.lamps.iter().flat_map(LampsOnGround::light_and_shadow);
        for (point, [light, shadow]) in points.iter_mut().zip(of_lamps) {
            (point.lamp_light, point.lamp_shadow) = (light, shadow);
        }
        (without_ground, points)
    }
}

/// Columns and rows of the places: all pixels, or the nodes of a grid that covers the centres of all pixels.
fn nodes((width, height): (usize, usize), step: usize) -> (usize, usize) {
    match step {
        1 => (width, height),
        _ => ((width - 1) / step + 2, (height - 1) / step + 2),
    }
}

/// The point of the ground at a place of the image; `None` above the horizon, and where the camera is below the ground.
fn hit(view: &RasterCamera, height: f32, place: [f32; 2]) -> Option<[f32; 3]> {
    let (centre, ray) = (view.centre, view.ray_through(place));
    let along = (height - centre[2]) / ray[2];
    let is_hit = centre[2] > height && ray[2] < 0.0 && along.is_finite();
    is_hit.then(|| [centre[0] + along * ray[0], centre[1] + along * ray[1], height])
}

/// `n` directions of the upper hemisphere with a density that is proportional to the cosine to +Z.
fn cosine_directions(n: usize) -> Vec<[f32; 3]> {
    let direction = |[x, y]: [f64; 2]| [x, y, (1.0 - x * x - y * y).max(0.0).sqrt()].map(|v| v as f32);
    disc_points(n).map(direction).collect()
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
