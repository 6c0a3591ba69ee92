//! `relume bench light-matrix`: measures time and error of light matrices against frames.

use std::path::PathBuf;
use std::time::Instant;

use crate::cli::bench::input::BenchModel;
use crate::cli::bench::table::{head, publish, row};
use crate::cli::error::CommandResult;
use crate::cli::light::illumination;
use relume_scene::light::{LightLobes, MAX_LOBES, MatrixWeights, dominant_lights};
use relume_scene::{Camera, Illumination, SplitLight};
use relume_spec::rendering::{ColourDepth, Output, Tier};
use relume_train::render::{FrameMetadata, MatrixLights, RenderError, Renderer, orbit_camera};

/// Options of `relume bench light-matrix`.
#[derive(Debug, clap::Args)]
pub(super) struct LightMatrixArgs {
    /// Models.
    #[arg(required = true)]
    models: Vec<PathBuf>,
    /// Numbers of lobes, 1 to 512, separated by commas.
    #[arg(long, value_delimiter = ',', default_value = "32,128", value_parser = clap::value_parser!(u32).range(1..=MAX_LOBES as i64))]
    lobes: Vec<u32>,
    /// Lights for the errors, separated by commas: files or names of built-in maps.
    #[arg(long, value_delimiter = ',', default_value = "sunset,studio")]
    envs: Vec<String>,
    /// Width and height of the frames, pixels.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u32).range(16..=4096))]
    size: u32,
    /// Repetitions of each time; the fastest counts.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    repeats: u32,
    /// The Markdown file to write. The report is also printed.
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(super) fn run(args: &LightMatrixArgs) -> CommandResult {
    let numbers = [
        "Gaussians",
        "lobes",
        "frame, ms",
        "light, ms",
        "matrix, s",
        "file, s",
        "file, MB",
        "matrix / frame",
        "matrix / (light + frame)",
    ];
    let mut times = head(&["model"], numbers);
    let mut errors = head(
        &["model", "light"],
        ["lobes", "suns", "even in each lobe", "whole map, lobes alone", "whole map, with suns"],
    );
    for path in &args.models {
        let bench_model = BenchModel::read(path)?;
        let renderer = Renderer::new(bench_model.model.clone());
        let bench = Bench {
            args,
            name: &bench_model.name,
            camera: orbit_camera(renderer.model(), None, None, (args.size, args.size))?,
            renderer: &renderer,
        };
        times += &bench.times()?;
        errors += &bench.errors()?;
    }
    let text = format!(
        "CPU engine, {} threads; {} px, tier standard. Light: preparation of another map of the same model. Matrix: tables of the lobes, frames \
         and their weighted sum; file: the same with half floats and compression in place of the sum. The fastest of {}.\n\n{times}\nErrors of weighted \
         sums against the frame under the same light: root mean square over covered pixels, relative to that of the frame. Even in each lobe: the map \
         with the mean radiance in each lobe, which a matrix reproduces.\n\n{errors}",
        rayon::current_num_threads(),
        args.size,
        args.repeats
    );
    Ok(publish(&text, args.out.as_deref())?)
}

struct Bench<'a> {
    args: &'a LightMatrixArgs,
    name: &'a str,
    camera: Camera,
    renderer: &'a Renderer,
}

impl Bench<'_> {
    /// The fastest of some runs, seconds.
    fn fastest<E>(&self, mut work: impl FnMut() -> Result<(), E>) -> Result<f64, E> {
        let mut best = f64::INFINITY;
        for _ in 0..self.args.repeats {
            let start = Instant::now();
            work()?;
            best = best.min(start.elapsed().as_secs_f64());
        }
        Ok(best)
    }

    fn times(&self) -> CommandResult<String> {
        let light = illumination("studio", self.renderer.model())?;
        // The first preparation also measures what the model's surfaces hide from each other.
        let prepared = self.renderer.prepare_light(light.clone())?;
        let frame = self.fastest(|| {
            self.renderer.render(&self.camera, &prepared, Tier::Standard, &[Output::Rgb]).map(drop)
        })?;
        let preparation = self.fastest(|| self.renderer.prepare_light(light.clone()).map(drop))?;
        let mut out = String::new();
        for &lobes in &self.args.lobes {
            let even = vec![[1.0; 3]; lobes as usize];
            let matrix = self.fastest(|| -> Result<(), RenderError> {
                let lights = self.lights(lobes, Vec::new());
                self.renderer.light_matrix(&self.camera, &lights)?.weighted_sum(&even);
                Ok(())
            })?;
            let mut bytes = 0;
            let file = self.fastest(|| -> CommandResult {
                let mut file = tempfile::tempfile()?;
                let lights = self.lights(lobes, Vec::new());
                let frames = self.renderer.light_matrix(&self.camera, &lights)?;
                frames.write(&mut file, ColourDepth::Half, &FrameMetadata::default(), &|_| true)?;
                bytes = file.metadata()?.len();
                Ok(())
            })?;
            out += &row([
                self.name.to_owned(),
                self.renderer.model().gaussians.len().to_string(),
                lobes.to_string(),
                format!("{:.1}", 1e3 * frame),
                format!("{:.0}", 1e3 * preparation),
                format!("{matrix:.2}"),
                format!("{file:.2}"),
                format!("{:.1}", bytes as f64 / 1e6),
                format!("{:.1}", matrix / frame),
                format!("{:.1}", matrix / (preparation + frame)),
            ]);
        }
        Ok(out)
    }

    fn lights(&self, lobes: u32, suns: Vec<SplitLight>) -> MatrixLights {
        self.renderer.matrix_lights(&LightLobes::new(lobes as usize), suns)
    }

    fn errors(&self) -> CommandResult<String> {
        let mut out = String::new();
        for name in &self.args.envs {
            let light = illumination(name, self.renderer.model())?;
            let suns: Vec<SplitLight> = dominant_lights(&light).1.iter().map(SplitLight::from).collect();
            for &lobes in &self.args.lobes {
                let partition = LightLobes::new(lobes as usize);
                let weights = MatrixWeights::of(&light, &partition, &[]).columns();
                let even = self.error(&partition.combined(&weights).into(), &partition, Vec::new())?;
                let alone = self.error(&light, &partition, Vec::new())?;
                let with_suns = self.error(&light, &partition, suns.clone())?;
                out += &row([
                    self.name.to_owned(),
                    name.clone(),
                    lobes.to_string(),
                    suns.len().to_string(),
                    format!("{even:.1e}"),
                    format!("{alone:.4}"),
                    format!("{with_suns:.4}"),
                ]);
            }
        }
        Ok(out)
    }

    /// Error of the weighted sum for `light` against the frame under it: root mean square over the covered pixels, relative to that of
    /// the frame.
    fn error(&self, light: &Illumination, lobes: &LightLobes, suns: Vec<SplitLight>) -> CommandResult<f64> {
        let prepared = self.renderer.prepare_light(light.clone())?;
        let outputs = [Output::Rgb, Output::Alpha];
        let frame = self.renderer.render(&self.camera, &prepared, Tier::Standard, &outputs)?;
        let plane = |output| frame.planes.get(&output).map_or(&[][..], Vec::as_slice);
        let (expected, alpha) = (plane(Output::Rgb).as_chunks::<3>().0, plane(Output::Alpha));
        let weights = MatrixWeights::of(light, lobes, &suns).columns();
        let lights = self.renderer.matrix_lights(lobes, suns);
        let found = self.renderer.light_matrix(&self.camera, &lights)?.weighted_sum(&weights);
        if expected.len() != found.len() || alpha.len() != found.len() {
            return Err("the frame and the matrix have different sizes".into());
        }
        let (mut square, mut whole) = (0.0f64, 0.0f64);
        for ((a, b), _) in expected.iter().zip(&found).zip(alpha).filter(|(_, alpha)| **alpha > 0.0) {
            for c in 0..3 {
                square += f64::from(a[c] - b[c]).powi(2);
                whole += f64::from(a[c]).powi(2);
            }
        }
        Ok((square / whole).sqrt())
    }
}
