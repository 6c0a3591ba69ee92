//! Renders a frame in bands of rows, so that intermediate data takes bounded memory, and so that other frames can be
//! rendered in between.

use std::collections::BTreeMap;

use crate::render::Frame;
use crate::render::cryptomatte::MAX_MATERIALS;
use crate::render::error::RenderError;
use crate::render::ground::{GroundPlanes, positions};
use crate::render::lamps::add_lamps;
use crate::render::material_planes::material_planes;
use crate::render::motion::{Neighbours, motion};
use crate::render::renderer::{PreparedLight, Renderer};
use relume_engine::{ColourMode, DeviceError, FrameJob, LampFrame, RasterCamera, RayLight};
use relume_layout::constants::TILE;
use relume_scene::{Camera, Model};
use relume_spec::rendering::{Lamp, Output, Quality, Tier};

/// A frame that is being rendered, see [`Renderer::bands`].
pub struct Bands<'a> {
    renderer: &'a Renderer,
    light: &'a PreparedLight,
    view: RasterCamera,
    quality: Quality,
    /// Requested outputs, sorted, without duplicates, including coverage.
    outputs: Vec<Output>,
    /// Those of them that the device renders, and the depth that positions and motion need.
    of_device: Vec<Output>,
    /// Height of the ground, capture units; `None`: [`Renderer::ground_height`].
    ground: Option<f64>,
    lamps: Vec<Lamp>,
    /// The camera of the frame, capture units, and those of its neighbours in a sequence.
    camera: Camera,
    neighbours: Neighbours,
    /// The work that remains after the bands.
    rest: Rest<'a>,
    /// Rows of a band: whole tiles where the device allows, so that no tile is blended twice.
    rows: usize,
    /// Completed rows.
    done: usize,
    frame: Frame,
}

/// The work that remains after the bands: lamps, then the ground. [`Bands::render_next`] does one step of it.
enum Rest<'a> {
    /// The bands are not complete.
    Unknown,
    /// The rows from `first` on under lamps.
    Lamps {
        first: usize,
        frame: Box<LampFrame<'a>>,
    },
    Ground(Box<GroundPlanes<'a>>),
    Nothing,
}

impl Renderer {
    /// Renders `outputs` for a camera in capture coordinates, at a [`Tier`] or at a [`Quality`], which includes
    /// samples and seed.
    ///
    /// # Errors
    /// Names the field (of the camera, or `samples`) that cannot be rendered. [`DeviceError::Misuse`] for a light of another
    /// renderer.
    pub fn render(
        &self,
        camera: &Camera,
        light: &PreparedLight,
        quality: impl Into<Quality>,
        outputs: &[Output],
    ) -> Result<Frame, RenderError> {
        let mut bands = self.bands(camera, light, quality.into(), outputs)?.undivided();
        while bands.render_next()? {}
        Ok(bands.into_frame())
    }

    /// Renders the same frame band by band, for a caller that interleaves other work.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub fn bands<'a>(
        &'a self,
        camera: &Camera,
        light: &'a PreparedLight,
        quality: Quality,
        outputs: &[Output],
    ) -> Result<Bands<'a>, RenderError> {
        self.check_light(light)?;
        quality.check().map_err(|reason| RenderError::Refused { field: "samples", reason })?;
        check_outputs(self.model(), outputs)?;
        let mut outputs = outputs.to_vec();
        outputs.push(Output::Alpha);
        outputs.sort_unstable();
        outputs.dedup();
        let view = self.view(camera)?;
        let (width, height) = (camera.width, camera.height);
        let frame = Frame { width, height, planes: BTreeMap::new() };
        let max_cost = match (self.frames.is_gpu(), quality.tier) {
            (false, _) => Quality::CPU_BAND_COST,
            (true, Tier::MonteCarlo) => Quality::SAMPLED_BAND_COST,
            (true, _) => Quality::BAND_COST,
        };
        let of_device = of_device(&outputs);
        let max_rows = self.frames.max_rows(view.width, self.colour(quality.tier, &of_device));
        let rows = rows(view.width, quality, max_cost, max_rows);
        Ok(Bands {
            renderer: self,
            light,
            view,
            quality,
            outputs,
            of_device,
            ground: None,
            lamps: Vec::new(),
            camera: *camera,
            neighbours: Neighbours::default(),
            rest: Rest::Unknown,
            rows,
            done: 0,
            frame,
        })
    }
}

/// Refuses outputs that `model` does not have.
fn check_outputs(model: &Model, outputs: &[Output]) -> Result<(), RenderError> {
    let refuse = |reason: String| Err(RenderError::Refused { field: "outputs", reason });
    if outputs.contains(&Output::Confidence) && model.gaussians.confidence().is_none() {
        return refuse(
            "the model has no confidence; only models that this version trained have it".to_owned(),
        );
    }
    let materials = model.prototypes.len();
    if outputs.iter().any(|output| output.is_of_materials()) && materials > MAX_MATERIALS {
        return refuse(format!(
            "material_id and cryptomatte are available up to {MAX_MATERIALS} materials; the model has {materials}"
        ));
    }
    Ok(())
}

/// The outputs that a device renders for `outputs`.
fn of_device(outputs: &[Output]) -> Vec<Output> {
    let of_points = [Output::Position, Output::Motion];
    let renders = |output: &Output| {
        let is_of_host = output.is_of_ground() || output.is_of_materials() || *output == Output::Confidence;
        !is_of_host && !of_points.contains(output)
    };
    let mut of_device: Vec<Output> = outputs.iter().copied().filter(renders).collect();
    if of_points.iter().any(|output| outputs.contains(output)) && !outputs.contains(&Output::Depth) {
        of_device.push(Output::Depth);
        of_device.sort_unstable();
    }
    of_device
}

impl Bands<'_> {
    /// Renders colour in as few bands as memory allows, for a caller that has nothing to interleave. Every band repeats projection and
    /// sorting.
    #[must_use]
    pub fn undivided(self) -> Self {
        let tier = self.quality.tier;
        let is_cheap = matches!(tier, Tier::Preview | Tier::Standard);
        if self.done > 0 || !is_cheap || self.renderer.colour(tier, &self.of_device) != ColourMode::Alone {
            return self;
        }
        let max_rows = self.renderer.frames.max_rows(self.view.width, ColourMode::Alone);
        let rows = rows(self.view.width, self.quality, Quality::BAND_COST, max_rows);
        Self { rows, ..self }
    }

    /// Sets the height of the ground, capture units. Default, and with `None`: [`Renderer::ground_height`].
    #[must_use]
    pub fn on_ground(self, height: Option<f64>) -> Self {
        Self { ground: height, ..self }
    }

    /// Adds lamps to the environment. At most [`MAX_LAMPS`](relume_spec::rendering::MAX_LAMPS) valid lamps.
    #[must_use]
    pub fn with_lamps(self, lamps: Vec<Lamp>) -> Self {
        Self { lamps, ..self }
    }

    /// Sets the cameras of the previous and the next frame, from which the output `motion` follows. Without neighbours it is zero.
    #[must_use]
    pub fn between(self, neighbours: Neighbours) -> Self {
        Self { neighbours, ..self }
    }

    /// Renders the next band, and after the last one a step of the light of lamps and of the planes of the ground. Returns false when the frame is complete.
    ///
    /// # Errors
    /// The device failed.
    pub fn render_next(&mut self) -> Result<bool, RenderError> {
        let first = self.done;
        if first == self.view.height {
            return Ok(self.continue_rest());
        }
        let mut view = self.view;
        view.height = self.rows.min(self.view.height - first);
        view.centre_px[1] -= first as f32;
        let band = self.render(view, first)?;
        self.done += view.height;
        if first == 0 && self.done == self.view.height {
            self.frame.planes = band.planes;
            return Ok(self.end_bands());
        }
        for (output, mut values) in band.planes {
            let plane = self.frame.planes.entry(output).or_default();
            if first == 0 {
                plane.reserve_exact(self.view.width * self.view.height * output.channels());
            }
            plane.append(&mut values);
        }
        if self.done < self.view.height { Ok(true) } else { Ok(self.end_bands()) }
    }

    /// Adds the positions and the motion to the complete bands. Returns whether lamps or the ground remain.
    fn end_bands(&mut self) -> bool {
        self.add_points();
        let outputs = &self.outputs;
        self.frame.planes.retain(|output, _| outputs.contains(output));
        let is_lit = |output: &Output| output.shows_lamps() && !output.is_of_ground();
        if self.lamps.is_empty() || !self.outputs.iter().any(is_lit) {
            return self.begin_ground();
        }
        self.begin_lamps(0);
        true
    }

    /// Adds the planes that follow from the depths.
    fn add_points(&mut self) {
        let model = self.renderer.model();
        let has_points = self.outputs.contains(&Output::Position) || self.outputs.contains(&Output::Motion);
        let (true, Some(depths)) = (has_points, self.frame.planes.get(&Output::Depth)) else { return };
        let points = positions(&self.view, depths, (model.world_scale, model.world_offset));
        if self.outputs.contains(&Output::Motion) {
            let vectors = motion(&self.camera, &points, depths, &self.neighbours);
            self.frame.planes.insert(Output::Motion, vectors);
        }
        self.frame.planes.insert(Output::Position, points);
    }

    /// Prepares a band of the light of lamps, from row `first` on.
    fn begin_lamps(&mut self, first: usize) {
        let rows = rows(self.view.width, self.quality, Quality::CPU_BAND_COST, usize::MAX);
        let mut view = self.view;
        view.height = rows.min(self.view.height - first);
        view.centre_px[1] -= first as f32;
        let frame = self.renderer.lamp_frame(view, &self.lamps, self.quality.tier);
        self.rest = Rest::Lamps { first, frame: Box::new(frame) };
    }

    /// Prepares the planes of the ground. Returns false if none is requested.
    fn begin_ground(&mut self) -> bool {
        if !self.outputs.iter().any(|output| output.is_of_ground()) {
            self.rest = Rest::Nothing;
            return false;
        }
        let height = self.renderer.normalised_height(self.ground);
        let lights = (self.light, &self.lamps[..]);
        let planes = GroundPlanes::new(self.renderer, lights, &self.view, height, &self.outputs);
        self.rest = Rest::Ground(Box::new(planes));
        true
    }

    /// Computes the next step of lamps or ground. Returns false when the frame is complete.
    fn continue_rest(&mut self) -> bool {
        let has_more = match &mut self.rest {
            Rest::Lamps { frame, .. } => frame.step(),
            Rest::Ground(ground) => ground.step(),
            Rest::Unknown | Rest::Nothing => false,
        };
        if has_more {
            return true;
        }
        match std::mem::replace(&mut self.rest, Rest::Nothing) {
            Rest::Lamps { first, frame } => {
                let planes = frame.into_planes();
                let done = first + planes[0].len() / (3 * self.view.width).max(1);
                add_lamps(&mut self.frame, first * self.view.width, &planes);
                if done >= self.view.height {
                    return self.begin_ground();
                }
                self.begin_lamps(done);
                true
            }
            Rest::Ground(ground) => {
                ground.add_to(&mut self.frame);
                false
            }
            Rest::Unknown | Rest::Nothing => false,
        }
    }

    /// The frame with the bands rendered so far.
    pub fn into_frame(self) -> Frame {
        self.frame
    }

    /// Renders the rows from `first` on that `view` covers.
    fn render(&self, view: RasterCamera, first: usize) -> Result<Frame, RenderError> {
        let (renderer, light, quality) = (self.renderer, self.light, self.quality);
        let job = FrameJob {
            view,
            outputs: &self.of_device,
            colour: renderer.colour(quality.tier, &self.of_device),
            depth_scale: (1.0 / renderer.model().world_scale) as f32,
        };
        let mut frame = match quality.tier {
            Tier::Preview | Tier::Standard => light.frame.render(&job)?,
            Tier::High | Tier::MonteCarlo => self.render_by_rays(&job, first)?,
        };
        if self.outputs.contains(&Output::Confidence) {
            let values = renderer.model().gaussians.confidence().unwrap_or_default();
            let plane = renderer.host().blended(view, values.as_chunks::<1>().0);
            frame.planes.insert(Output::Confidence, plane.into_flattened());
        }
        let alpha = frame.planes.get(&Output::Alpha).map_or(&[][..], Vec::as_slice);
        let of_materials = material_planes(renderer.host(), view, alpha, &self.outputs);
        frame.planes.extend(of_materials);
        Ok(frame)
    }

    /// Renders a band of a ray-traced tier on the device.
    fn render_by_rays(&self, job: &FrameJob<'_>, first: usize) -> Result<Frame, DeviceError> {
        let (model, light, quality) = (self.renderer.model(), self.light, self.quality);
        let rays = match quality.tier {
            Tier::MonteCarlo => Some(RayLight::Sampled {
                environment: light.sampler(),
                samples: quality.samples,
                seed: quality.seed,
                pixels_before: pixels_before(&job.view, first),
            }),
            _ => light.split(model.gaussians.visibility_degree()).rays(),
        };
        match rays {
            Some(rays) => light.frame.render_by_rays(job, &rays),
            // Without sharp lights no rays are needed.
            None => light.frame.render(job),
        }
    }
}

/// Number of pixels of a frame above row `first`.
fn pixels_before(view: &RasterCamera, first: usize) -> u64 {
    (first * view.width) as u64
}

/// Rows of a band: as many as cost at most `max_cost`, at least one row of tiles, and at most `max_rows`.
fn rows(width: usize, quality: Quality, max_cost: u64, max_rows: usize) -> usize {
    let pixels = max_cost / quality.pixel_cost();
    let rows = usize::try_from(pixels).unwrap_or(usize::MAX) / width.max(1);
    let of_whole_tiles = |rows: usize| (rows / TILE).max(1) * TILE;
    of_whole_tiles(rows.min(max_rows)).min(max_rows)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::DVec3;

    use super::*;
    use relume_compare::rms_difference;
    use relume_scene::{EnvMap, Field, Gaussians};

    /// A slanted row of balls that crosses every band.
    fn balls() -> Renderer {
        let mut gaussians = Gaussians::zeroed(9, 1, 2, 0);
        for i in 0..9 {
            let along = i as f32 * 0.2 - 0.8;
            gaussians.row_mut(Field::Mean, i).copy_from_slice(&[along * 0.5, 0.0, along]);
            gaussians.row_mut(Field::LogScale, i).fill(0.12f32.ln());
            gaussians.row_mut(Field::Quaternion, i)[0] = 1.0;
            gaussians.row_mut(Field::OpacityLogit, i)[0] = 4.0;
            gaussians.row_mut(Field::Visibility, i)[0] = relume_scene::light::UNOCCLUDED_SH0;
        }
        Renderer::new(Arc::new(Model::new(gaussians, vec![[0.5; 3]], vec![[0.0; 3]; 8], (4, 2))))
    }

    /// Root mean square difference of two planes, relative to the standard deviation of the first.
    fn relative(a: &[f32], b: &[f32]) -> f64 {
        let mean = a.iter().map(|v| f64::from(*v)).sum::<f64>() / a.len() as f64;
        rms_difference(a, b) / rms_difference(a, &vec![mean; a.len()])
    }

    #[test]
    fn frame_rendered_in_bands_equals_the_whole_frame() {
        let renderer = balls();
        let texel = |d: DVec3| if d.z > 0.9 { [9.0, 8.0, 7.0] } else { [0.4 + 0.3 * d.x as f32, 0.4, 0.5] };
        let light = renderer.prepare_light(EnvMap::from_fn(64, 32, texel)).unwrap();
        let camera =
            Camera::look_at(DVec3::new(0.2, -3.0, 0.4), DVec3::ZERO, DVec3::Z, 0.7, (50, 70)).unwrap();
        let outputs = [Output::Rgb, Output::Normal, Output::Visibility];
        for tier in Tier::ALL {
            let quality = Quality { samples: 4, ..tier.into() };
            let of = |rows: usize, seed: u64| {
                let bands = renderer.bands(&camera, &light, Quality { seed, ..quality }, &outputs).unwrap();
                let (mut bands, mut seams) = (Bands { rows, ..bands }, 0);
                while bands.render_next().unwrap() {
                    seams += 1;
                }
                (bands.into_frame(), seams)
            };
            let ((whole, none), (banded, seams)) = (of(80, 0), of(16, 0));
            assert_eq!((none, seams, banded.planes.len()), (0, 4, 4));
            for (output, plane) in &whole.planes {
                let off = relative(plane, &banded.planes[output]);
                assert!(off < 1e-3, "{tier:?} {output:?}: {off}");
            }
            let other = of(80, 1).0.planes.remove(&Output::Rgb).unwrap();
            let noise = relative(&whole.planes[&Output::Rgb], &other);
            assert!(noise.is_finite(), "{tier:?}");
            assert_eq!(noise > 2e-3, tier == Tier::MonteCarlo, "the control, with other samples: {noise}");
        }
    }

    #[test]
    fn colour_without_interruptions_is_one_band() {
        let renderer = balls();
        let light = renderer.prepare_light(EnvMap::constant(8, 4, [1.0; 3])).unwrap();
        let camera =
            Camera::look_at(DVec3::new(0.2, -3.0, 0.4), DVec3::ZERO, DVec3::Z, 0.7, (800, 800)).unwrap();
        let bands =
            |outputs: &[Output], tier: Tier| renderer.bands(&camera, &light, tier.into(), outputs).unwrap();
        assert!(bands(&[Output::Rgb], Tier::Preview).rows < 800);
        assert!(bands(&[Output::Rgb], Tier::Preview).undivided().rows >= 800);
        for (outputs, tier) in
            [(vec![Output::Rgb, Output::Normal], Tier::Preview), (vec![Output::Rgb], Tier::High)]
        {
            assert_eq!(
                bands(&outputs, tier).undivided().rows,
                bands(&outputs, tier).rows,
                "{outputs:?} {tier:?}"
            );
        }
    }

    #[test]
    fn light_of_another_renderer_is_refused() {
        let (renderer, other) = (balls(), balls());
        let camera = Camera::look_at(DVec3::new(0.2, -3.0, 0.4), DVec3::ZERO, DVec3::Z, 0.7, (8, 8)).unwrap();
        let [own, foreign] =
            [&renderer, &other].map(|r| r.prepare_light(EnvMap::constant(8, 4, [1.0; 3])).unwrap());
        let render = |light| renderer.render(&camera, light, Tier::Standard, &[Output::Rgb]);
        assert!(matches!(render(&foreign), Err(RenderError::Device(DeviceError::Misuse(_)))));
        assert!(render(&own).is_ok(), "the control");
    }

    #[test]
    fn every_tier_blends_confidence_and_refuses_models_without_it() {
        let outputs = [Output::Rgb, Output::Confidence];
        let camera =
            Camera::look_at(DVec3::new(0.2, -3.0, 0.4), DVec3::ZERO, DVec3::Z, 0.7, (50, 70)).unwrap();
        let render = |renderer: &Renderer, tier: Tier| {
            let light = renderer.prepare_light(EnvMap::constant(8, 4, [1.0; 3])).unwrap();
            renderer.render(&camera, &light, Quality { samples: 4, ..tier.into() }, &outputs)
        };
        let refused = render(&balls(), Tier::Standard).unwrap_err();
        assert!(matches!(refused, RenderError::Refused { field: "outputs", .. }), "{refused}");
        let mut model = balls().model().clone();
        model.gaussians.set_confidence(vec![0.75; model.gaussians.len()]);
        let renderer = Renderer::new(Arc::new(model));
        for tier in Tier::ALL {
            let frame = render(&renderer, tier).unwrap();
            let pixels = frame.planes[&Output::Confidence].iter().zip(&frame.planes[&Output::Alpha]);
            let (covered, empty): (Vec<_>, Vec<_>) = pixels.partition(|(_, alpha)| **alpha > 0.5);
            assert!(covered.len() > 50 && covered.iter().all(|(c, _)| (**c - 0.75).abs() < 1e-4), "{tier:?}");
            assert!(empty.iter().any(|(c, _)| **c == 0.0), "{tier:?}");
        }
    }

    #[test]
    fn bands_consist_of_whole_tiles_and_respect_the_cost_limit() {
        for (width, quality) in
            [(4096, Quality::from(Tier::Standard)), (700, Tier::High.into()), (512, Quality::monte_carlo(64))]
        {
            let rows = rows(width, quality, Quality::BAND_COST, usize::MAX);
            assert!(rows.is_multiple_of(TILE) && rows > 0);
            let cost = (rows * width) as u64 * quality.pixel_cost();
            assert!(cost <= Quality::BAND_COST || rows == TILE, "{width} {quality:?}: {rows} rows");
        }
        let of = |width, quality, max_rows| rows(width, quality, Quality::BAND_COST, max_rows);
        assert_eq!(of(1 << 16, Quality::monte_carlo(Quality::MAX_SAMPLES), usize::MAX), TILE);
        let narrow = rows(1, Tier::Preview.into(), Quality::CPU_BAND_COST, usize::MAX);
        assert!(narrow >= 1 << 16, "a narrow frame is one band");
        let limited = [3 * TILE + 5, TILE, 7].map(|max_rows| of(64, Tier::Standard.into(), max_rows));
        assert_eq!(limited, [3 * TILE, TILE, 7], "the device limits the rows");
    }
}
