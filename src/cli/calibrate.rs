//! `relume calibrate`: scales the albedo of a model to the known reflectance of a surface in a photograph.

use std::path::PathBuf;
use std::str::FromStr;

use crate::cli::error::CommandResult;
use crate::cli::{input, output};
use relume_capture::formats::model_file;
use relume_capture::{ImportLimits, patch_camera};
use relume_engine::{Device, DeviceChoice};
use relume_spec::training::GreyCard;
use relume_train::calibration::{calibrate_finished, measure_albedo};
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
    #[arg(long, value_name = "PHOTO:X,Y,WIDTH,HEIGHT")]
    patch: GreyCard,
    /// Linear reflectance of the surface, 0.01 to 1: one number, or red, green and blue (Rec.709), or `white` (0.9, matte paper).
    /// A grey card has 0.18.
    #[arg(long, value_name = "R|R,G,B|white")]
    reflectance: Reflectance,
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
    let up = up_of_card(&model.card)?;
    let camera = patch_camera(&args.capture, &ImportLimits::default(), up, &args.patch)?;
    let device = Device::open(args.device)?;
    let albedo = measure_albedo(&model, &camera, &device);
    let done = calibrate_finished(&mut model, albedo, args.reflectance.0)?;
    output::write_named(&args.out, &model_file::encode(&model)?)?;
    let shown = |rgb: [f32; 3]| rgb.map(|v| format!("{v:.3}")).join(", ");
    eprintln!(
        "wrote {}: the albedo of the patch was {}, is {}; the light was divided by {}",
        args.out.display(),
        shown(done.albedo_before),
        shown(done.reflectance),
        shown(done.scale)
    );
    Ok(())
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
