//! Options of `relume render`.

use std::path::PathBuf;

use super::frame_list::FrameList;
use crate::cli::args::{QualityArgs, named};
use crate::cli::material_args::MaterialArgs;
use relume_engine::DeviceChoice;
use relume_scene::Model;
use relume_scene::light::MAX_LOBES;
use relume_spec::rendering::{
    AlphaMode, Background, ColourDepth, Lamp, MAX_LAMPS, Output, Primaries, ToneCurve,
};

/// Options of `relume render`.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct RenderArgs {
    /// The model file.
    pub(super) model: PathBuf,
    /// The light: a `.hdr` or `.exr` file, the name of a built-in map, `recovered`, or `recovered:GROUP` for a light group of the capture.
    /// Default: `recovered`; with `--light-matrix` none.
    #[arg(long, visible_alias = "environment")]
    pub(super) env: Option<String>,
    /// Rotation of the light about +Z, degrees counter-clockwise.
    #[arg(long, visible_alias = "environment-rotation", default_value_t = 0.0, allow_negative_numbers = true, value_parser = finite)]
    pub(super) rotation: f64,
    /// Exposure of the light, and therefore of the image, stops, -20 to 20.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, value_parser = up_to::<20>)]
    pub(super) exposure: f64,
    /// A lamp beside the light of `--env`; repeat the option for more (at most 16). The shape (`point`, `spot`, `disc` or `rectangle`), then
    /// `position=X,Y,Z`, `target=X,Y,Z`, `radius=R` or `size=W,H` in units of the capture, `cone=DEG`, `kelvin=K` or `colour=#RRGGBB`, and
    /// one of `intensity=I`, `candela=CD` and `lumen=LM`: "spot position=2,1,2 target=0,0,0 intensity=20 kelvin=3200".
    #[arg(long = "lamp", value_name = "LAMP")]
    lamps: Vec<Lamp>,
    #[command(flatten)]
    pub(super) materials: MaterialArgs,
    #[command(flatten)]
    pub(super) cameras: CameraArgs,
    #[command(flatten)]
    pub(super) quality: QualityArgs,
    /// Outputs to render, separated by commas. A PNG or JPEG contains one output, an EXR any number. Default: `rgb`; for a model
    /// without materials `radiance`.
    #[arg(long, value_delimiter = ',', value_parser = named::<Output>)]
    pub(super) output: Vec<Output>,
    /// Height (z) of the ground for the outputs `shadow`, `shadow_key`, `shadow_fill`, `bounce`, `contact`, `lamp_light` and `lamp_shadow`, units of the capture. Default: the lowest visible point of the model.
    #[arg(long, value_name = "Z", allow_negative_numbers = true, value_parser = finite)]
    pub(super) ground_height: Option<f64>,
    /// Background: `transparent` (white in a JPEG), `environment` or a colour such as `f4f4f4`.
    #[arg(long, default_value_t)]
    pub(super) background: Background,
    /// Tone curve for display colours: `srgb`, `neutral`, `agx` or, in a 16-bit PNG, `linear`.
    #[arg(long, default_value = "srgb", value_parser = named::<ToneCurve>)]
    pub(super) tone_curve: ToneCurve,
    /// Render one frame for each of this number of lobes of light (1 to 512) into one multi-part EXR, for relighting in a compositor. With
    /// `--env` also one frame for each strong small light of that map. `relume weights` prints the weights of a map.
    #[arg(long, value_name = "LOBES", value_parser = clap::value_parser!(u32).range(1..=MAX_LOBES as i64))]
    pub(super) light_matrix: Option<u32>,
    /// Precision of the colours in an EXR: `float` (the default) or `half` (the default of a light matrix).
    #[arg(long, value_parser = named::<ColourDepth>)]
    pub(super) colour_depth: Option<ColourDepth>,
    /// Alpha mode of the colours in an EXR: `premultiplied` (the default) or `straight`.
    #[arg(long, value_parser = named::<AlphaMode>)]
    pub(super) alpha: Option<AlphaMode>,
    /// Primaries of the colours in an EXR: `rec709` (the default) or `acescg`.
    #[arg(long, value_parser = named::<Primaries>)]
    pub(super) primaries: Option<Primaries>,
    /// Device: `auto`, `cpu`, `gpu` or `gpu:N`; `relume doctor` lists the devices.
    #[arg(long, default_value_t)]
    pub(super) device: DeviceChoice,
    /// The image file to write: `.png`, `.jpg` or `.exr`. For a sequence the name contains a placeholder for the frame number,
    /// e.g. `frames/%04d.exr`.
    #[arg(long, default_value = "frame.png")]
    pub(super) out: PathBuf,
    #[command(flatten)]
    pub(super) sequence: SequenceArgs,
}

impl RenderArgs {
    /// The lamps.
    pub(super) fn lamps(&self) -> Result<Vec<Lamp>, String> {
        let shows_lamps = self.output.is_empty() || self.output.iter().any(|output| output.shows_lamps());
        if !self.lamps.is_empty() && !shows_lamps {
            return Err(
                "--lamp: applies to the outputs rgb, diffuse, specular, lamp_light and lamp_shadow; add one of them to --output"
                    .to_owned(),
            );
        }
        match self.lamps.len() {
            0..=MAX_LAMPS => Ok(self.lamps.clone()),
            more => Err(format!("--lamp: a picture has at most {MAX_LAMPS} lamps, got {more}")),
        }
    }

    /// The requested outputs. Refuses outputs that `model` does not have.
    pub(super) fn outputs(&self, model: &Model) -> Result<Vec<Output>, String> {
        use Output::{Alpha, Contact, Depth, Motion, Normal, Position, Radiance, Rgb};
        if self.ground_height.is_some() && !self.output.iter().any(|output| output.is_of_ground()) {
            return Err(
                "--ground-height: applies to the outputs shadow, shadow_key, shadow_fill, bounce, contact, lamp_light and lamp_shadow; add --output".to_owned()
            );
        }
        let relightable = model.has_materials();
        if self.output.contains(&Output::Confidence) && model.gaussians.confidence().is_none() {
            return Err(
                "--output: the model has no confidence; only models that this version trained have it"
                    .to_owned(),
            );
        }
        if self.output.is_empty() {
            return Ok(vec![if relightable { Rgb } else { Radiance }]);
        }
        let of_any =
            |o: &Output| matches!(o, Radiance | Alpha | Depth | Normal | Position | Contact | Motion);
        match relightable || self.output.iter().all(of_any) {
            true => Ok(self.output.clone()),
            false => Err(
                "--output: the model has no materials; only radiance, normal, depth, position, motion, contact and alpha are available"
                    .to_owned(),
            ),
        }
    }
}

/// Options for the camera.
#[derive(Debug, clap::Args)]
pub(super) struct CameraArgs {
    /// Azimuth of the camera, degrees counter-clockwise seen from above, from the first photograph. For models that do not record
    /// their photographs, 0 is the +x side. Default: 0; for models without the record, the azimuth of their framing if they have one.
    #[arg(long, allow_negative_numbers = true, value_parser = finite)]
    pub(super) azimuth: Option<f64>,
    /// Elevation of the camera, degrees above the horizon, -90 to 90. Default: the median of the photographs; for models that do not
    /// record them, the elevation of their framing, otherwise 20.
    #[arg(long, allow_negative_numbers = true, value_parser = up_to::<90>)]
    pub(super) elevation: Option<f64>,
    /// Width and height of the image, pixels.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u32).range(1..=8192))]
    pub(super) size: u32,
    /// Width and height of the image, pixels, in place of `--size`. Cameras of another size in a file are scaled.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = resolution)]
    pub(super) resolution: Option<(u32, u32)>,
    /// A file with one camera per frame: a JSON file with `cameras` (as in the API), with a `camera_path` of nerfstudio or with
    /// the `frames` of a transforms.json, or a folder with a COLMAP model.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["turntable", "azimuth", "elevation"])]
    pub(super) path: Option<PathBuf>,
    /// The dataparser_transforms.json of nerfstudio from the training in which a `camera_path` was made. It transforms the
    /// cameras back to the world of the capture.
    #[arg(long, value_name = "FILE", requires = "path")]
    pub(super) path_world: Option<PathBuf>,
    /// Render a turntable of this number of frames around the model, starting at `--azimuth`.
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(super) turntable: Option<u32>,
    /// Degrees by which the camera of a turntable turns over the whole sequence, counter-clockwise; 0 for a static camera. The turn
    /// would be complete one frame after the last one.
    #[arg(long, default_value_t = 360.0, allow_negative_numbers = true, value_parser = finite, requires = "turntable")]
    pub(super) camera_turn: f64,
    /// Degrees by which the light turns over the whole sequence, counter-clockwise, in addition to `--rotation`. The turn would be
    /// complete one frame after the last one.
    #[arg(long, visible_alias = "environment-turn", default_value_t = 0.0, allow_negative_numbers = true, value_parser = finite)]
    pub(super) env_turn: f64,
}

/// Options for the numbers and files of a sequence.
#[derive(Debug, clap::Args)]
pub(super) struct SequenceArgs {
    /// Number of the first frame.
    #[arg(long, default_value_t = 1)]
    pub(super) start_number: u32,
    /// Only the frames with these numbers: `7`, `1-10`, `1-100:10` or several of these separated by commas. A render farm can
    /// divide a sequence into tasks with it.
    #[arg(long, visible_alias = "frame", value_name = "NUMBERS")]
    pub(super) frames: Option<FrameList>,
    /// Skip frames whose file already exists, from an earlier run with the same options.
    #[arg(long)]
    pub(super) resume: bool,
    /// Frame rate to store in an EXR, frames per second.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(super) fps: Option<u32>,
}

/// Parses a finite number.
pub(in crate::cli) fn finite(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "must be a number")?;
    if value.is_finite() { Ok(value) } else { Err("must be finite".to_owned()) }
}

/// Parses a number from `-LIMIT` to `LIMIT`.
pub(in crate::cli) fn up_to<const LIMIT: i32>(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    if value.abs() <= f64::from(LIMIT) { Ok(value) } else { Err(format!("must be -{LIMIT} to {LIMIT}")) }
}

/// Parses a size in pixels, e.g. `1920x1080`.
fn resolution(text: &str) -> Result<(u32, u32), String> {
    let side = |text: &str| text.parse().ok().filter(|side| (1..=8192).contains(side));
    let sides = text.split_once('x').and_then(|(width, height)| side(width).zip(side(height)));
    sides.ok_or_else(|| "must be WIDTHxHEIGHT, e.g. 1920x1080, of 1 to 8192 pixels each".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_numbers_and_resolutions_are_refused() {
        assert_eq!(
            (finite("-1e3"), up_to::<20>("-20"), up_to::<90>("89.5")),
            (Ok(-1e3), Ok(-20.0), Ok(89.5))
        );
        for wrong in ["nan", "inf", "", "ten"] {
            assert!(finite(wrong).is_err() && up_to::<20>(wrong).is_err(), "{wrong}");
        }
        assert!(up_to::<20>("20.5").is_err() && up_to::<90>("-91").is_err());
        assert_eq!(resolution("1920x1080"), Ok((1920, 1080)));
        for wrong in ["1920", "x", "0x10", "10x9000", "-1x2", "1920X1080", "1x2x3"] {
            assert!(resolution(wrong).is_err(), "{wrong}");
        }
    }
}
