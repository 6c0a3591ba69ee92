//! `relume bench shadow`: measures how much of the cast shadows of the photographs remains in the albedo of models.

use std::path::PathBuf;

use crate::cli::bench::input::{BenchModel, read_capture};
use crate::cli::bench::table::{head, publish, row};
use crate::cli::error::CommandResult;
use relume_capture::CaptureView;
use relume_engine::linear_from_srgb;
use relume_scene::EnvMap;
use relume_spec::rendering::{Output, Tier};
use relume_train::render::Renderer;

/// Minimum cosine between +Z and the normal of level ground. On one plane only shadows change the light.
const UP: f32 = 0.95;
/// Minimum true albedo. Darker pixels do not show enough light.
const MIN_ALBEDO: f32 = 0.05;
/// Channels of the photograph may be clipped from this value on.
const CLIPPED: f32 = 0.95;
/// Light on a lit pixel and on a pixel in shadow, relative to the brightest tenth.
const LIT: f32 = 0.8;
const IN_SHADOW: f32 = 0.5;

/// Options of `relume bench shadow`.
#[derive(Debug, clap::Args)]
pub(super) struct ShadowArgs {
    /// A capture with held-out views, true albedo and true normals, in which an object casts a shadow on level ground.
    capture: PathBuf,
    /// Models of this capture.
    #[arg(required = true)]
    models: Vec<PathBuf>,
    /// Longest side of the views, pixels.
    #[arg(long, default_value_t = 400, value_parser = clap::value_parser!(u32).range(16..=8192))]
    resolution: u32,
    /// The Markdown file to write. The report is also printed.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// A pixel of the ground: its light, and the ratio of the model's albedo to the true albedo.
struct GroundPixel {
    light: f32,
    albedo: f32,
}

pub(super) fn run(args: &ShadowArgs) -> CommandResult {
    let capture = read_capture(&args.capture, args.resolution)?;
    let mut text = format!(
        "CPU engine; {} px, {} held-out views; level ground. Albedo over the true one, medians.\n\n{}",
        args.resolution,
        capture.test.len(),
        head(&["model"], ["lit pixels", "in shadow", "albedo, lit", "in shadow", "shadow left, %"])
    );
    for path in &args.models {
        let bench_model = BenchModel::read(path)?;
        let renderer = Renderer::new(bench_model.model.clone());
        let mut ground = Vec::new();
        for view in &capture.test {
            ground.extend(ground_of(&renderer, view)?);
        }
        text += &line(&bench_model.name, &ground)?;
    }
    Ok(publish(&text, args.out.as_deref())?)
}

/// The pixels of level ground in one view.
fn ground_of(renderer: &Renderer, view: &CaptureView) -> CommandResult<Vec<GroundPixel>> {
    let (Some(albedo), Some(normal)) = (&view.truth.albedo, &view.truth.normal) else {
        return Err(format!("{}: has no true albedo or no true normals", view.name).into());
    };
    let light = renderer.prepare_light(EnvMap::constant(8, 4, [1.0; 3]))?;
    let frame = renderer.render(&view.camera, &light, Tier::Standard, &[Output::Albedo])?;
    let found = frame.planes.get(&Output::Albedo).map_or(&[][..], Vec::as_slice).as_chunks::<3>().0;
    let mean = |v: [f32; 3]| v.iter().sum::<f32>() / 3.0;
    let truth = albedo.values.iter().zip(&normal.values).zip(view.image.pixels());
    let pixels = truth.zip(found).filter_map(|(((albedo, normal), pixel), found)| {
        let shown = [pixel[0], pixel[1], pixel[2]];
        let is_ground = pixel[3] > 0.99 && normal[2] > UP && mean(*albedo) > MIN_ALBEDO;
        let light = mean(shown.map(linear_from_srgb)) / mean(*albedo);
        (is_ground && shown.iter().all(|v| *v < CLIPPED))
            .then(|| GroundPixel { light, albedo: mean(*found) / mean(*albedo) })
    });
    Ok(pixels.collect())
}

/// The table row of one model.
fn line(name: &str, ground: &[GroundPixel]) -> CommandResult<String> {
    let mut light: Vec<f32> = ground.iter().map(|g| g.light).collect();
    light.sort_by(f32::total_cmp);
    let bright = light.get(light.len() * 9 / 10).copied().unwrap_or(0.0);
    let of = |is_one: &dyn Fn(f32) -> bool| -> Vec<f32> {
        ground.iter().filter(|g| is_one(g.light / bright)).map(|g| g.albedo).collect()
    };
    let (lit, dark) = (of(&|share| share > LIT), of(&|share| share < IN_SHADOW));
    if lit.is_empty() || dark.is_empty() {
        return Err("the held-out views show no shadow on level ground".into());
    }
    let counts = [lit.len(), dark.len()].map(|n| n.to_string());
    let (lit, dark) = (median(lit), median(dark));
    let figures = [format!("{lit:.3}"), format!("{dark:.3}"), format!("{:.1}", 100.0 * (1.0 - dark / lit))];
    Ok(row([name.to_owned()].into_iter().chain(counts).chain(figures)))
}

fn median(mut values: Vec<f32>) -> f32 {
    values.sort_by(f32::total_cmp);
    values[values.len() / 2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shadow_baked_into_the_albedo_is_measured_in_percent() {
        let ground = |left: f32| -> Vec<GroundPixel> {
            (0..100)
                .map(|i| (if i < 60 { 1.0 } else { 0.2 }, if i < 60 { 1.1 } else { 1.1 * left }))
                .collect::<Vec<_>>()
                .into_iter()
                .map(|(light, albedo)| GroundPixel { light, albedo })
                .collect()
        };
        assert!(line("m", &ground(1.0)).unwrap().ends_with("| 0.0 |\n"));
        assert!(line("m", &ground(0.7)).unwrap().ends_with("| 30.0 |\n"));
        assert!(line("m", &ground(1.0)[..50]).is_err(), "no shadow");
        assert!(line("m", &[]).is_err());
    }
}
