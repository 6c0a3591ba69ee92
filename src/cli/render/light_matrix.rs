//! Light matrices: one frame for each lobe of light and each strong small light of a map, in one file for each camera.

use std::path::Path;
use std::sync::Arc;

use super::args::RenderArgs;
use super::numbering::Numbering;
use super::sequence::SequenceFrames;
use super::session::file_name;
use super::{asked_views, sequence};
use crate::cli::error::CommandResult;
use crate::cli::light::illumination;
use crate::cli::{input, output};
use relume_engine::DeviceChoice;
use relume_scene::light::{LightLobes, dominant_lights};
use relume_scene::{Model, SplitLight};
use relume_spec::rendering::{
    AlphaMode, Background, ColourDepth, FrameFormat, Output, Primaries, Tier, ToneCurve,
};
use relume_train::render::{FrameMetadata, FrameView, MatrixLights, Renderer};

/// Renders the matrix of each view.
pub(super) fn run(
    args: &RenderArgs,
    lobes: usize,
    format: FrameFormat,
    numbering: Option<&Numbering>,
) -> CommandResult {
    check(args, format)?;
    let model = Arc::new(args.materials.apply(input::read_model(&args.model)?)?);
    if !model.has_materials() {
        return Err(
            format!("{}: the model has no materials, so it cannot be relit", args.model.display()).into()
        );
    }
    let suns = suns(args, &model)?;
    let views = asked_views(args, &model)?;
    check_rotations(args, &views)?;
    let renderer = Renderer::new(model);
    let lights = renderer.matrix_lights(&LightLobes::new(lobes), suns);
    eprintln!("lobes: {lobes}, strong small lights: {}", lights.parts().len() - lobes);
    let mut session = MatrixSession { args, renderer: &renderer, lights: &lights };
    match (numbering, views.as_slice()) {
        (None, [view]) => {
            session.write(&args.out, view)?;
            eprintln!("wrote {}", args.out.display());
            Ok(())
        }
        (None, _) => Err(format!("{}: {}", args.out.display(), Numbering::WANTED).into()),
        (Some(numbering), views) => sequence::sequence(views, numbering, &args.sequence, &mut session),
    }
}

/// Refuses options that a light matrix does not have.
fn check(args: &RenderArgs, format: FrameFormat) -> Result<(), String> {
    if format != FrameFormat::Exr {
        return Err(format!("{}: a light matrix must end in .exr", args.out.display()));
    }
    let only_rgb = args.output.iter().all(|output| *output == Output::Rgb);
    let refused = [
        (
            args.quality.tier.is_some_and(|tier| tier != Tier::Standard),
            "--tier: a light matrix has the tier standard",
        ),
        (!only_rgb, "--output: a light matrix contains rgb; render other outputs without --light-matrix"),
        (args.background != Background::Transparent, "--background: a light matrix is transparent"),
        (args.tone_curve != ToneCurve::Srgb, "--tone-curve: a light matrix is linear"),
        (
            args.alpha == Some(AlphaMode::Straight),
            "--alpha: a light matrix is premultiplied; divide by alpha after the sum",
        ),
        (
            args.primaries.is_some_and(|primaries| primaries != Primaries::Rec709),
            "--primaries: weights multiply channels of Rec.709; convert to other primaries after the sum",
        ),
        (!args.lamps()?.is_empty(), "--lamp: a light matrix contains the environment alone"),
        (args.ground_height.is_some(), "--ground-height: a light matrix does not contain the ground"),
        (args.exposure != 0.0, "--exposure: multiply the weights instead"),
        (args.rotation != 0.0 && args.env.is_none(), "--rotation: turns the lights of --env; add --env"),
        (
            args.cameras.env_turn != 0.0,
            "--env-turn: a turning light is a sequence of weights; see relume weights",
        ),
        (
            matches!(args.device, DeviceChoice::Gpu(_)),
            "--device: the CPU engine computes light matrices; omit --device",
        ),
    ];
    match refused.into_iter().find(|(is_refused, _)| *is_refused) {
        Some((_, why)) => Err(why.to_owned()),
        None => Ok(()),
    }
}

/// Refuses cameras that turn the light of `--env`: its small lights have one place in all files.
fn check_rotations(args: &RenderArgs, views: &[FrameView]) -> Result<(), String> {
    let turned = views.iter().position(|view| view.light_rotation_deg.rem_euclid(360.0) != 0.0);
    match (turned, &args.env) {
        (Some(i), Some(_)) => Err(format!(
            "--path: camera {} turns the light, but the small lights of --env have one place in all files; omit --env or light_rotation_deg",
            i + 1
        )),
        _ => Ok(()),
    }
}

/// The strong small lights of `--env`.
fn suns(args: &RenderArgs, model: &Model) -> Result<Vec<SplitLight>, String> {
    let Some(env) = &args.env else { return Ok(Vec::new()) };
    let light = illumination(env, model)?.rotated_and_scaled(args.rotation, 1.0);
    Ok(dominant_lights(&light).1.iter().map(SplitLight::from).collect())
}

struct MatrixSession<'a> {
    args: &'a RenderArgs,
    renderer: &'a Renderer,
    lights: &'a MatrixLights,
}

impl SequenceFrames for MatrixSession<'_> {
    /// Writes the matrix of one view.
    fn write(&mut self, path: &Path, view: &FrameView) -> CommandResult {
        let args = self.args;
        let metadata = FrameMetadata {
            model: file_name(&args.model),
            light: args.env.clone().unwrap_or_default(),
            rotation_deg: args.rotation,
            frames_per_second: args.sequence.fps,
            ..FrameMetadata::default()
        };
        let frames = self.renderer.light_matrix(&view.camera, self.lights)?;
        let depth = args.colour_depth.unwrap_or(ColourDepth::Half);
        output::write_by(path, |file| -> CommandResult {
            let mut file = std::io::BufWriter::with_capacity(1 << 20, file);
            frames.write(&mut file, depth, &metadata, &|_| true)?;
            Ok(())
        })
        .map_err(|error| format!("{}: {error}", path.display()).into())
    }
}
