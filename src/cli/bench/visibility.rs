//! `relume bench visibility`: measures the error of the visibility that models learned, by the source of its labels.

use std::path::PathBuf;

use rayon::prelude::*;

use crate::cli::bench::input::{BenchModel, read_capture};
use crate::cli::bench::table::{head, publish, row};
use crate::cli::error::CommandResult;
use relume_capture::{Capture, CaptureView};
use relume_engine::{HostModel, OccluderBvh, RasterCamera, Surface, fibonacci_sphere};
use relume_scene::light::sh_eval;
use relume_scene::{EnvMap, Model, VisibilityForm};
use relume_spec::rendering::{Output, Tier};
use relume_train::eval::evenly_spaced;
use relume_train::render::Renderer;

/// Minimum coverage of a surface point. Pixels with less coverage are edges, which blend several surfaces.
const SOLID: f32 = 0.9;

/// Options of `relume bench visibility`.
#[derive(Debug, clap::Args)]
pub(super) struct VisibilityArgs {
    /// A capture with held-out views and true ambient occlusion (`ao.png`).
    capture: PathBuf,
    /// Models of this capture, one per label source.
    #[arg(required = true)]
    models: Vec<PathBuf>,
    /// Longest side of the views, pixels.
    #[arg(long, default_value_t = 128, value_parser = clap::value_parser!(u32).range(16..=8192))]
    resolution: u32,
    /// Number of held-out views, evenly spaced.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    views: u32,
    /// Surface points per view at which directions are compared, spread over its pixels.
    #[arg(long, default_value_t = 500, value_parser = clap::value_parser!(u32).range(1..))]
    points: u32,
    /// Directions to compare per point, over the whole sphere.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u32).range(1..=65536))]
    directions: u32,
    /// The Markdown file to write. The report is also printed.
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(super) fn run(args: &VisibilityArgs) -> CommandResult {
    let capture = read_capture(&args.capture, args.resolution)?;
    let figures = ["AO MAE", "AO correlation", "V(w) MAE", "of V = 1", "minimum at this degree"];
    let mut text = format!(
        "CPU engine; {} px, {} held-out views, {} points a view, {} directions.\n\n{}",
        args.resolution,
        args.views,
        args.points,
        args.directions,
        head(&["model", "labels"], figures)
    );
    for path in &args.models {
        let line = measure(args, &capture, &BenchModel::read(path)?)?;
        eprint!("{line}");
        text += &line;
    }
    Ok(publish(&text, args.out.as_deref())?)
}

/// The table row of one model.
fn measure(args: &VisibilityArgs, capture: &Capture, bench_model: &BenchModel) -> CommandResult<String> {
    let renderer = Renderer::new(bench_model.model.clone());
    let views = evenly_spaced(&capture.test, Some(args.views as usize));
    let (mut occlusion, mut directions) = (PairSums::default(), DirectionSums::default());
    let towards = basis(args.directions as usize, bench_model.model.gaussians.visibility_degree());
    for view in views {
        occlusion.add(&ambient_occlusion(&renderer, view)?);
        directions.add(&directional(args, view, &towards, renderer.host()));
    }
    if occlusion.count == 0.0 {
        return Err("the held-out views have no true ambient occlusion (ao.png)".into());
    }
    let figures = [
        occlusion.error / occlusion.count,
        occlusion.correlation(),
        directions.error / directions.weight,
        directions.of_open / directions.weight,
        directions.of_projection / directions.weight,
    ];
    let figures = figures.iter().map(|v| format!("{v:.3}"));
    Ok(row([bench_model.name.clone(), bench_model.setting("labels")].into_iter().chain(figures)))
}

/// Field and ground truth of each foreground pixel.
fn ambient_occlusion(renderer: &Renderer, view: &CaptureView) -> CommandResult<Vec<[f64; 2]>> {
    let Some(truth) = &view.truth.ambient_occlusion else { return Ok(Vec::new()) };
    // The field does not depend on the light.
    let light = renderer.prepare_light(EnvMap::constant(8, 4, [1.0; 3]))?;
    let frame = renderer.render(&view.camera, &light, Tier::Standard, &[Output::Visibility])?;
    let found = frame.planes.get(&Output::Visibility).map_or(&[][..], Vec::as_slice);
    let pixels = found.iter().zip(&truth.values).zip(view.image.pixels());
    Ok(pixels.filter(|(_, p)| p[3] > 0.5).map(|((a, b), _)| [f64::from(*a), f64::from(b[0])]).collect())
}

/// Error of the field in single directions relative to the transmittance of rays through the Gaussians.
fn directional(
    args: &VisibilityArgs,
    view: &CaptureView,
    towards: &[Towards],
    host: &HostModel,
) -> DirectionSums {
    let model = host.model();
    let camera = view.camera.in_normalised_world(model.world_scale, model.world_offset);
    let mut visible = host.surfaces(RasterCamera::new(&camera, &model.shading));
    visible.retain(|at| at.coverage >= SOLID);
    let step = visible.len().div_ceil(args.points as usize).max(1);
    let chosen: Vec<_> = visible.iter().step_by(step).collect();
    let occluders = host.occluders();
    let parts: Vec<DirectionSums> =
        chosen.par_iter().map(|at| at_point(model, at.position, &at.surface, towards, occluders)).collect();
    let mut sum = DirectionSums::default();
    parts.iter().for_each(|p| sum.add(p));
    sum
}

fn at_point(
    model: &Model,
    point: [f32; 3],
    surface: &Surface,
    towards: &[Towards],
    occluders: &OccluderBvh,
) -> DirectionSums {
    let vector = glam::Vec3::from_array;
    let normal = vector(surface.normal).normalize_or_zero();
    let normal = if normal.dot(vector(surface.view)) < 0.0 { -normal } else { normal };
    let truths: Vec<f32> = towards.iter().map(|t| occluders.transmittance(point, t.direction)).collect();
    let mut projection = [0.0f32; 64];
    for (truth, t) in truths.iter().zip(towards) {
        let weight = 4.0 * std::f32::consts::PI / towards.len() as f32 * truth;
        projection.iter_mut().zip(&t.basis).for_each(|(c, y)| *c += weight * y);
    }
    let mut sum = DirectionSums::default();
    for (truth, t) in truths.iter().zip(towards) {
        let cos = f64::from(normal.dot(vector(t.direction)));
        if cos > 0.0 {
            let error = |found: f32| cos * f64::from((found - truth).abs());
            sum.weight += cos;
            sum.error += error(field(model.shading.visibility, &surface.visibility, t));
            sum.of_open += error(1.0);
            sum.of_projection += error(field(VisibilityForm::Linear, &projection, t));
        }
    }
    sum
}

/// A direction and its harmonics, zero above the SH degree.
struct Towards {
    direction: [f32; 3],
    basis: [f32; 64],
}

/// `count` directions over the whole sphere.
fn basis(count: usize, sh_degree: usize) -> Vec<Towards> {
    let towards = |direction: [f32; 3]| {
        let mut basis = [0.0f32; 64];
        sh_eval(sh_degree, direction, &mut basis);
        Towards { direction, basis }
    };
    fibonacci_sphere(count).into_iter().map(towards).collect()
}

/// `V(d)` from blended coefficients, as in shading.
fn field(form: VisibilityForm, coefficients: &[f32], towards: &Towards) -> f32 {
    let sum: f32 = towards.basis.iter().zip(coefficients).map(|(y, c)| y * c).sum();
    match form {
        VisibilityForm::Linear => sum.clamp(0.0, 1.0),
        VisibilityForm::Sigmoid => 1.0 / (1.0 + (-sum).exp()),
        VisibilityForm::Off => 1.0,
    }
}

/// Cosine-weighted sums over directions.
#[derive(Default)]
struct DirectionSums {
    weight: f64,
    error: f64,
    /// Error of a field that is 1 everywhere.
    of_open: f64,
    /// Error of the ground truth projected to the model's SH degree and clamped: about the minimum of any field of that degree.
    of_projection: f64,
}

impl DirectionSums {
    fn add(&mut self, other: &Self) {
        self.weight += other.weight;
        self.error += other.error;
        self.of_open += other.of_open;
        self.of_projection += other.of_projection;
    }
}

/// Sums over pairs of a recovered and a true value.
#[derive(Default)]
struct PairSums {
    count: f64,
    error: f64,
    sums: [f64; 2],
    squares: [f64; 2],
    product: f64,
}

impl PairSums {
    fn add(&mut self, pairs: &[[f64; 2]]) {
        for pair in pairs {
            self.count += 1.0;
            self.error += (pair[0] - pair[1]).abs();
            self.product += pair[0] * pair[1];
            for k in 0..2 {
                self.sums[k] += pair[k];
                self.squares[k] += pair[k] * pair[k];
            }
        }
    }

    /// Pearson correlation; 0 if one side is constant.
    fn correlation(&self) -> f64 {
        let n = self.count;
        let covariance = self.product - self.sums[0] * self.sums[1] / n;
        let variance = |k: usize| (self.squares[k] - self.sums[k] * self.sums[k] / n).max(0.0);
        let scale = (variance(0) * variance(1)).sqrt();
        if scale > 0.0 { covariance / scale } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn correlation_is_one_minus_one_or_zero_for_constant_input() {
        let of = |pairs: &[[f64; 2]]| {
            let mut sums = PairSums::default();
            sums.add(pairs);
            sums.correlation()
        };
        assert!((of(&[[0.0, 0.2], [0.5, 0.4], [1.0, 0.6]]) - 1.0).abs() < 1e-9);
        assert!((of(&[[0.0, 0.6], [0.5, 0.4], [1.0, 0.2]]) + 1.0).abs() < 1e-9);
        assert_eq!(of(&[[0.5, 0.6], [0.5, 0.4]]), 0.0);
    }
}
