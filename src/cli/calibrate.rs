//! `relume calibrate`: scales the albedo of a model to the known reflectance of a surface, or of a colour chart, in a photograph.

use std::path::PathBuf;
use std::str::FromStr;

use crate::cli::args::named;
use crate::cli::error::CommandResult;
use crate::cli::{input, output};
use relume_capture::formats::model_file;
use relume_capture::{ImportLimits, measure_colour_chart, patch_camera};
use relume_engine::{Device, DeviceChoice};
use relume_scene::Model;
use relume_spec::training::{ChartEdition, ColourChart, GreyCard};
use relume_train::calibration::{CalibrationTime, calibrate_by_chart, calibrate_finished, measure_albedo};
use relume_train::up_of_card;

/// Reflectance of matte white paper.
const WHITE: f32 = 0.9;

/// Options of `relume calibrate`.
#[derive(Debug, clap::Args)]
pub(super) struct CalibrateArgs {
    /// The model file.
    model: PathBuf,
    /// The capture from which the model was trained: a folder or an archive.
    #[arg(long, value_name = "DIR")]
    capture: PathBuf,
    /// A surface of known reflectance in a photograph, as a rectangle in pixels of the stored photograph. The surface must be part of
    /// the model; it may lie in a shadow.
    #[arg(
        long,
        value_name = "PHOTO:X,Y,WIDTH,HEIGHT",
        requires = "reflectance",
        required_unless_present = "chart"
    )]
    patch: Option<GreyCard>,
    /// Linear reflectance of the surface, 0.01 to 1: one number, or red, green and blue (Rec.709), or `white` (0.9, matte paper).
    /// A grey card has 0.18.
    #[arg(long, value_name = "R|R,G,B|white", requires = "patch")]
    reflectance: Option<Reflectance>,
    /// A classic colour chart of 24 patches in a photograph, in place of a patch: the outer corners of its patches dark skin, bluish green,
    /// black and white, in pixels of the stored photograph. The albedo is scaled to the neutral patches that the model covers.
    #[arg(long, value_name = "PHOTO:X1,Y1,X2,Y2,X3,Y3,X4,Y4", conflicts_with = "patch")]
    chart: Option<ColourChart>,
    /// When the chart was made: `since_november_2014` or `before_november_2014`.
    #[arg(long, value_parser = named::<ChartEdition>, default_value = "since_november_2014", requires = "chart")]
    chart_edition: ChartEdition,
    /// The model file to write.
    #[arg(long)]
    out: PathBuf,
    /// Device: `auto`, `cpu`, `gpu` or `gpu:N`.
    #[arg(long, default_value_t)]
    device: DeviceChoice,
}

/// Reflectance by channel.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Reflectance([f32; 3]);

impl FromStr for Reflectance {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "white" {
            return Ok(Self([WHITE; 3]));
        }
        let numbers: Option<Vec<f32>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some([grey]) => Ok(Self([*grey; 3])),
            Some([red, green, blue]) => Ok(Self([*red, *green, *blue])),
            _ => Err("must be a number, three numbers separated by commas, or `white`".to_owned()),
        }
    }
}

pub(super) fn run(args: &CalibrateArgs) -> CommandResult {
    let mut model = input::read_model(&args.model)?;
    let device = Device::open(args.device)?;
    let done = match (&args.chart, &args.patch, args.reflectance) {
        (Some(chart), _, _) => by_chart(args, chart, &mut model, &device)?,
        (None, Some(patch), Some(reflectance)) => by_patch(args, patch, reflectance, &mut model, &device)?,
        _ => return Err("--patch and --reflectance, or --chart, must be given".into()),
    };
    output::write_named(&args.out, &model_file::encode(&model)?)?;
    eprintln!("wrote {}: {done}", args.out.display());
    Ok(())
}

fn shown(rgb: [f32; 3]) -> String {
    rgb.map(|v| format!("{v:.3}")).join(", ")
}

/// Calibrates `model` by a patch and returns a sentence with the result.
fn by_patch(
    args: &CalibrateArgs,
    patch: &GreyCard,
    reflectance: Reflectance,
    model: &mut Model,
    device: &Device,
) -> CommandResult<String> {
    let up = up_of_card(&model.card)?;
    let camera = patch_camera(&args.capture, &ImportLimits::default(), up, patch)?;
    let albedo = measure_albedo(model, &camera, device);
    let done = calibrate_finished(model, albedo, reflectance.0)?;
    Ok(format!(
        "the albedo of the patch was {}, is {}; the light was divided by {}",
        shown(done.albedo_before),
        shown(done.reflectance),
        shown(done.scale)
    ))
}

/// Calibrates `model` by a colour chart and returns a sentence with the result.
fn by_chart(
    args: &CalibrateArgs,
    chart: &ColourChart,
    model: &mut Model,
    device: &Device,
) -> CommandResult<String> {
    let up = up_of_card(&model.card)?;
    let chart = ColourChart { edition: args.chart_edition, ..chart.clone() };
    chart.check()?;
    let measured = measure_colour_chart(&args.capture, &ImportLimits::default(), up, &chart)?;
    measured.warning.iter().for_each(|warning| eprintln!("warning: {warning}"));
    let done = calibrate_by_chart(model, &measured.patches, device, CalibrationTime::Finished)?;
    Ok(format!(
        "the model covers {} patches of the chart, {} of them neutral; the albedo was multiplied and the light divided by {}; CIEDE2000 of \
         the albedo in these patches: mean {:.1}, largest {:.1} before, mean {:.1}, largest {:.1} after",
        done.patches,
        done.neutral_patches,
        shown(done.scale),
        done.before.mean,
        done.before.max,
        done.after.mean,
        done.after.max
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reflectance_is_one_number_three_or_white() {
        let read = |text: &str| text.parse::<Reflectance>();
        assert_eq!(read("0.18"), Ok(Reflectance([0.18; 3])));
        assert_eq!(read("0.1, 0.2,0.3"), Ok(Reflectance([0.1, 0.2, 0.3])));
        assert_eq!(read("white"), Ok(Reflectance([0.9; 3])));
        for bad in ["", "grey", "0.1,0.2", "0.1;0.2;0.3", "1,2,3,4"] {
            assert!(read(bad).unwrap_err().contains("three numbers"), "{bad}");
        }
    }
}
