//! The light of the surroundings in captures without masks.
//!
//! The photographs show the radiance of walls, furniture and ground around the subject, so the environment is known in these
//! directions. This fixes the level and the colour of the light, which light and albedo could otherwise trade. Only sources
//! are trained: texels in which the photographs are clipped, such as windows, lamps and bright sky.

mod sources;
mod texels;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::crop;
use crate::dataset::Dataset;
use crate::lights;
use relume_engine::{PhotoLights, PhotoSize, TrainState, evaluation};
use relume_scene::{Camera, DisplayRange, Field, softplus_inverse};
use relume_spec::training::TrainConfig;
use sources::Source;
use texels::Texels;

/// Width and height of a face of the cube in which the surroundings are rendered, pixels.
const FACE: u32 = 48;
/// Least number of pixels of the photographs in which a Gaussian of the surroundings is visible.
const MIN_VISIBLE_PIXELS: f32 = 1.0;
/// Least share of the sphere that the photographs must show.
const MIN_SHOWN_SHARE: f32 = 0.2;
/// Second moment of a texel that Adam must not move: a step is at most the rate times 1e-15 for a gradient of 1.
const HELD: f32 = 1e30;
/// A second moment above this one belongs to a held texel: no gradient has such a square, and Adam lowers [`HELD`] by at most
/// 1e-13 in 30,000 steps.
const IS_HELD: f32 = 1e10;
/// Least radiance of a held texel, the range of the softplus.
const MIN_RADIANCE: f32 = 1e-3;

/// The photographed light of the surroundings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SurroundingLight {
    /// Linear radiance of each texel of the environment; `None` for a source, whose radiance is trained.
    texels: Vec<Option<[f32; 3]>>,
    /// Connected regions of sources.
    sources: Vec<Source>,
    /// Share of the sphere that the photographs show.
    shown: f32,
}

/// The ball that contains the subject. Everything outside of it belongs to the surroundings.
#[derive(Debug, Clone, Copy)]
struct SubjectBall {
    centre: DVec3,
    radius: f64,
}

impl SurroundingLight {
    /// The light around the subject of `data`, before a crop. `None` if the light is known or rotates, if the photographs have masks, or
    /// if they show too little of the surroundings or no source: then the light comes from parts that they do not show.
    pub fn of(config: &TrainConfig, state: &TrainState, data: &Dataset) -> Option<Self> {
        let is_wanted =
            config.surrounding_light && config.light.is_none() && state.model.shading.shades_lights();
        if !is_wanted || data.has_alpha || data.lights != PhotoLights::default() {
            return None;
        }
        let reach = f64::from(state.model.shading.occluder_reach?);
        let (centre, radius) = crop::ball(config.crop, data).unwrap_or_else(|| {
            let (centre, _) = relume_capture::focus_region(&data.cameras(PhotoSize::Full));
            (centre, reach)
        });
        let seen = lights::seen(state, &data.cameras(PhotoSize::Half));
        let light = Self::around(state, &seen, SubjectBall { centre, radius }, data.range);
        (light.shown > MIN_SHOWN_SHARE && !light.sources.is_empty()).then_some(light)
    }

    /// The radiance of the Gaussians outside of `ball`, as its centre sees them. `seen`: number of pixels of the photographs in which each
    /// Gaussian is visible.
    fn around(state: &TrainState, seen: &[f32], ball: SubjectBall, range: DisplayRange) -> Self {
        let surroundings = outside(state, seen, ball);
        let size = (state.model.env_width, state.model.env_height);
        let mut texels = Texels::new(size, range);
        for (forward, up) in faces() {
            let to = ball.centre + forward;
            let camera = Camera::look_at(ball.centre, to, up, std::f64::consts::FRAC_PI_2, (FACE, FACE));
            let Ok(camera) = camera else { continue };
            let [dark, bright] =
                [0.0, 1.0].map(|behind| evaluation::radiance(&surroundings, &camera, [behind; 3]));
            for (i, (dark, bright)) in dark.iter().zip(&bright).enumerate() {
                let ray = camera.ray(i as u32 % FACE, i as u32 / FACE).normalize();
                let coverage = 1.0 - (bright[1] - dark[1]);
                texels.add(ray, *dark, coverage, ray.dot(forward).powi(3) as f32);
            }
        }
        Self { texels: texels.radiance(), sources: sources::of(&texels), shown: texels.shown_share() }
    }

    /// Share of the sphere around the subject that sources fill.
    pub fn source_share(&self) -> f32 {
        let sources = self.texels.iter().filter(|texel| texel.is_none()).count();
        sources as f32 / self.texels.len().max(1) as f32
    }

    /// Share of the sphere around the subject that the photographs show, and number of sources, for the model card.
    pub fn card(&self) -> serde_json::Value {
        serde_json::json!({ "shown_share": self.shown, "sources": self.sources.len() })
    }

    /// Sets the known texels of the environment and holds them; releases the others.
    pub fn hold(&self, state: &mut TrainState) {
        let first = state.model.prototypes.len();
        let [gradient, square] = &mut state.moments.globals;
        let rows = gradient[first..].iter_mut().zip(&mut square[first..]);
        for ((raw, known), (gradient, square)) in state.model.env_raw.iter_mut().zip(&self.texels).zip(rows) {
            match known {
                Some(radiance) => {
                    *raw = radiance.map(|v| softplus_inverse(v.max(MIN_RADIANCE)));
                    (*gradient, *square) = ([0.0; 3], [HELD; 3]);
                }
                None if square[0] > IS_HELD => *square = [0.0; 3],
                None => {}
            }
        }
    }
}

/// The state with only the photographed Gaussians outside of `ball`.
fn outside(state: &TrainState, seen: &[f32], ball: SubjectBall) -> TrainState {
    let g = &state.model.gaussians;
    let is_outside = |i: &usize| {
        let mean = DVec3::from(g.get::<3>(Field::Mean, *i).map(f64::from));
        seen[*i] >= MIN_VISIBLE_PIXELS && (mean - ball.centre).length() > ball.radius
    };
    let kept: Vec<usize> = (0..g.len()).filter(is_outside).collect();
    let mut out = state.clone();
    out.select(&kept);
    out
}

/// Directions and up vectors of the faces of a cube.
fn faces() -> [(DVec3, DVec3); 6] {
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    [(x, z), (-x, z), (y, z), (-y, z), (z, y), (-z, y)]
}

#[cfg(test)]
mod tests;
