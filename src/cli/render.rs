//! `relume render`: a model file and a light in, an image file out.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::cli::args::{QualityArgs, named};
use crate::cli::error::CommandResult;
use crate::cli::light::named_light;
use crate::cli::{input, output};
use crate::engine::Device;
use crate::engine::DeviceChoice;
use crate::render::{
    Background, Finish, FrameFormat, FrameNotes, Orbit, Output, Renderer, Tier, ToneCurve, Viewpoint,
    encode_frame,
};
use crate::scene::Model;

/// Options of `relume render`.
#[derive(Debug, clap::Args)]
pub(super) struct RenderArgs {
    /// The model file.
    model: PathBuf,
    /// A `.hdr` or `.exr` file, the name of a built-in map, or `recovered`.
    #[arg(long, default_value = "recovered")]
    env: String,
    /// Turn of the light about +Z, degrees counter-clockwise.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, value_parser = finite)]
    rotation: f64,
    /// Exposure of the light, stops, -20 to 20.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, value_parser = up_to::<20>)]
    exposure: f64,
    /// Degrees around the model, counter-clockwise seen from above. 0, on the +x side, when absent, but of a capture without masks that
    /// in the middle of its photographs.
    #[arg(long, allow_negative_numbers = true, value_parser = finite)]
    azimuth: Option<f64>,
    /// Degrees above the horizon, -90 to 90. 20 when absent, but of a capture without masks as `--azimuth`.
    #[arg(long, allow_negative_numbers = true, value_parser = up_to::<90>)]
    elevation: Option<f64>,
    /// Side of the image, pixels.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u32).range(1..=8192))]
    size: u32,
    #[command(flatten)]
    quality: QualityArgs,
    /// Outputs to render, separated by commas; a PNG or JPEG holds one, an EXR all. When absent `rgb`, of a model without
    /// materials `radiance`.
    #[arg(long, value_delimiter = ',', value_parser = named::<Output>)]
    output: Vec<Output>,
    /// Behind the model: `transparent` (JPEG shows white), `environment` or a colour like `f4f4f4`.
    #[arg(long, default_value_t)]
    background: Background,
    /// How colours come to a display: `srgb`, `neutral`, `agx` or, in a 16-bit PNG, `linear`.
    #[arg(long, default_value = "srgb", value_parser = named::<ToneCurve>)]
    tone_curve: ToneCurve,
    /// Where to compute: `auto`, `cpu`, `gpu` or `gpu:N`; `relume doctor` lists them.
    #[arg(long, default_value_t)]
    device: DeviceChoice,
    /// The image file to write: `.png`, `.jpg` or `.exr`.
    #[arg(long, default_value = "frame.png")]
    out: PathBuf,
}

pub(super) fn run(args: &RenderArgs) -> CommandResult {
    let format = format(&args.out)?;
    if format != FrameFormat::Exr && args.output.len() > 1 {
        return Err("only an .exr holds several outputs".into());
    }
    let finish = Finish { background: args.background, tone_curve: args.tone_curve, ..Finish::default() };
    let model = Arc::new(input::read_model(&args.model)?);
    let outputs = args.outputs(&model)?;
    finish.check(&outputs, format)?;
    let light = match args.env.as_str() {
        "recovered" => model.environment(),
        name => named_light(name, "recovered ")?,
    };
    let light = light.rotated_and_scaled(args.rotation, args.exposure.exp2() as f32);
    let orbit = Orbit { azimuth_deg: args.azimuth, elevation_deg: args.elevation, size: args.size };
    let camera = Viewpoint::Orbit(orbit).camera(&model)?;
    let renderer = Renderer::on(model, &Device::open(args.device)?)?;
    let light = renderer.prepare_light(&light)?;
    let quality = args.quality.quality(Tier::default());
    let mut frame = renderer.render(&camera, &light, quality, &outputs)?;
    if args.background == Background::Environment {
        renderer.show_environment(&mut frame, &camera, &light);
    }
    let notes = FrameNotes {
        model: file_name(&args.model),
        light: args.env.clone(),
        rotation_deg: args.rotation,
        exposure_ev: args.exposure,
        quality,
        camera: Some(camera),
    };
    let encoded = encode_frame(&frame, &outputs, format, &Finish { notes, ..finish })?;
    output::write_named(&args.out, &encoded.bytes)?;
    eprintln!("wrote {}", args.out.display());
    Ok(())
}

impl RenderArgs {
    /// What was asked for, as far as `model` has it.
    fn outputs(&self, model: &Model) -> Result<Vec<Output>, String> {
        use Output::{Alpha, Depth, Normal, Radiance, Rgb};
        let relightable = model.has_materials();
        if self.output.is_empty() {
            return Ok(vec![if relightable { Rgb } else { Radiance }]);
        }
        let of_any = |o: &Output| matches!(o, Radiance | Alpha | Depth | Normal);
        match relightable || self.output.iter().all(of_any) {
            true => Ok(self.output.clone()),
            false => {
                Err("--output: the model has no materials: only radiance, normal, depth and alpha".to_owned())
            }
        }
    }
}

/// A number that is neither infinite nor no number.
pub(super) fn finite(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "must be a number")?;
    if value.is_finite() { Ok(value) } else { Err("must be finite".to_owned()) }
}

/// A number of at most `MOST` either way.
pub(super) fn up_to<const MOST: i32>(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    if value.abs() <= f64::from(MOST) { Ok(value) } else { Err(format!("must be -{MOST} to {MOST}")) }
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

fn format(path: &Path) -> Result<FrameFormat, String> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    match extension.as_str() {
        "png" => Ok(FrameFormat::Png),
        "jpg" | "jpeg" => Ok(FrameFormat::Jpeg),
        "exr" => Ok(FrameFormat::Exr),
        _ => Err(format!("{}: must end in .png, .jpg or .exr", path.display())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_make_no_picture_are_refused() {
        assert_eq!(
            (finite("-1e3"), up_to::<20>("-20"), up_to::<90>("89.5")),
            (Ok(-1e3), Ok(-20.0), Ok(89.5))
        );
        for wrong in ["nan", "inf", "", "ten"] {
            assert!(finite(wrong).is_err() && up_to::<20>(wrong).is_err(), "{wrong}");
        }
        assert!(up_to::<20>("20.5").is_err() && up_to::<90>("-91").is_err());
    }
}
