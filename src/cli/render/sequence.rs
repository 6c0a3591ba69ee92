//! Renders frames in order and writes each file atomically.

use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};

use super::args::SequenceArgs;
use super::frame_list::FrameList;
use super::frame_writer::FrameWriter;
use super::numbering::Numbering;
use super::session::RenderSession;
use crate::cli::error::CommandResult;
use crate::cli::output;
use relume_train::render::{FrameView, RotatedLight};

/// Renders the frames of a sequence and writes their files.
pub(super) trait SequenceFrames {
    /// Renders a frame. Its file exists when the next frame is complete, or after [`Self::finish`].
    fn write(&mut self, file: &Path, view: &FrameView) -> CommandResult;

    /// Waits until all files are written.
    fn finish(&mut self) -> CommandResult {
        Ok(())
    }
}

/// The pictures of a session.
pub(super) struct Pictures<'a> {
    session: &'a RenderSession,
    light: RotatedLight,
    writer: FrameWriter,
}

impl<'a> Pictures<'a> {
    pub(super) fn of(session: &'a RenderSession) -> Self {
        Self { session, light: RotatedLight::default(), writer: FrameWriter::default() }
    }
}

impl SequenceFrames for Pictures<'_> {
    fn write(&mut self, file: &Path, view: &FrameView) -> CommandResult {
        let picture = self.session.picture(view, &mut self.light)?;
        let file = file.to_owned();
        self.writer.start(move || Ok(output::write_named(&file, &picture.encoded()?)?))
    }

    fn finish(&mut self) -> CommandResult {
        self.writer.finish()
    }
}

/// Writes one image.
pub(super) fn single(session: &RenderSession, view: &FrameView, out: &Path) -> CommandResult {
    output::write_named(out, &session.picture(view, &mut RotatedLight::default())?.encoded()?)?;
    eprintln!("wrote {}", out.display());
    Ok(())
}

/// Writes the frames of `views` in order, or only those with the requested numbers. With `resume`, existing files are
/// not changed.
pub(super) fn sequence(
    views: &[FrameView],
    numbering: &Numbering,
    args: &SequenceArgs,
    frames_of: &mut impl SequenceFrames,
) -> CommandResult {
    let frames = asked_for(views, numbering, args.frames.as_ref())?;
    let bar = ProgressBar::new(frames.len() as u64);
    bar.set_style(ProgressStyle::with_template("{bar:32} {pos}/{len} {per_sec:>12} eta {eta:>4}  {msg}")?);
    let mut written = 0;
    for (done, (file, view)) in (1_usize..).zip(&frames) {
        if !(args.resume && file.exists()) {
            if let Err(error) = frames_of.write(file, view) {
                // The frame before is complete; its file is kept.
                frames_of.finish()?;
                return Err(error);
            }
            written += 1;
        }
        // Without a terminal the bar is hidden: about 20 lines are printed instead.
        if bar.is_hidden() && done.is_multiple_of((frames.len() / 20).max(1)) {
            eprintln!("frame {done}/{}  {}", frames.len(), file.display());
        }
        bar.set_message(file.display().to_string());
        bar.set_position(done as u64);
    }
    frames_of.finish()?;
    bar.finish();
    let there = frames.len() - written;
    let kept = if there > 0 { format!(", existed already: {there}") } else { String::new() };
    eprintln!("frames written: {written}{kept}");
    Ok(())
}

/// The requested frames, each with its file.
fn asked_for<'a>(
    views: &'a [FrameView],
    numbering: &Numbering,
    list: Option<&FrameList>,
) -> CommandResult<Vec<(PathBuf, &'a FrameView)>> {
    if let Some(list) = list {
        list.check(numbering.number(0), numbering.number(views.len() - 1))?;
    }
    let is_asked_for = |index: &usize| list.is_none_or(|list| list.contains(numbering.number(*index)));
    Ok((0..views.len()).filter(is_asked_for).map(|index| (numbering.file(index), &views[index])).collect())
}
