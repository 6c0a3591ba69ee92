//! `relume render`: renders a model under a light, to one image file or a sequence.

mod args;
mod camera_file;
mod frame_list;
mod frame_writer;
mod light_matrix;
mod numbering;
mod sequence;
mod session;
mod unseen;
mod views;

use std::path::Path;

use crate::cli::error::CommandResult;
use relume_scene::Model;
use relume_spec::rendering::{FrameFormat, Output};
use relume_train::render::FrameView;
use relume_train::up_of_card;

pub(super) use args::{RenderArgs, finite, up_to};
use numbering::Numbering;
use sequence::Pictures;
use session::RenderSession;

pub(super) fn run(args: &RenderArgs) -> CommandResult {
    let format = format(&args.out)?;
    if format != FrameFormat::Exr && args.output.len() > 1 {
        return Err("only an .exr can contain several outputs".into());
    }
    let numbering = numbering(args)?;
    if let Some(lobes) = args.light_matrix {
        return light_matrix::run(args, lobes as usize, format, numbering.as_ref());
    }
    let session = RenderSession::open(args, format)?;
    let views = asked_views(args, session.model())?;
    match (numbering, views.as_slice()) {
        (None, [view]) => sequence::single(&session, view, &args.out),
        (None, _) => Err(format!("{}: {}", args.out.display(), Numbering::WANTED).into()),
        (Some(numbering), views) => {
            sequence::sequence(views, &numbering, &args.sequence, &mut Pictures::of(&session))
        }
    }
}

/// The views of the frames. Prints a warning for views from directions without photographs.
fn asked_views(args: &RenderArgs, model: &Model) -> CommandResult<Vec<FrameView>> {
    let up = up_of_card(&model.card)?;
    let file_cameras = args.cameras.path.as_deref().map(|file| camera_file::read(file, &args.cameras, up));
    let views = views::views(&args.cameras, file_cameras.transpose()?, model)?;
    if let Some(warning) = unseen::warning(&views, &model.card) {
        eprintln!("warning: {warning}");
    }
    Ok(views)
}

/// The numbering of the files; `None` for a single image.
fn numbering(args: &RenderArgs) -> Result<Option<Numbering>, String> {
    let is_sequence = args.cameras.path.is_some() || args.cameras.turntable.is_some();
    let alone = [
        ("--env-turn", args.cameras.env_turn != 0.0),
        ("--resume", args.sequence.resume),
        ("--frames", args.sequence.frames.is_some()),
        ("--start-number", args.sequence.start_number != 1),
        ("--path-world", args.cameras.path_world.is_some()),
        ("--output motion", args.output.contains(&Output::Motion)),
    ];
    match alone.into_iter().find(|(_, is_given)| *is_given && !is_sequence) {
        Some((option, _)) => {
            Err(format!("{option} applies to a sequence; it requires --path or --turntable"))
        }
        None if is_sequence => Numbering::of(&args.out, args.sequence.start_number).map(Some),
        None => Ok(None),
    }
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
