//! Frames in their order, each file whole or not there.

use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};

use super::args::SequenceArgs;
use super::numbering::Numbering;
use super::studio::Studio;
use crate::cli::error::CommandResult;
use crate::cli::output;
use crate::render::View;

/// Writes one picture.
pub(super) fn single(studio: &Studio, view: &View, out: &Path) -> CommandResult {
    output::write_named(out, &studio.picture(view, &mut None)?)?;
    eprintln!("wrote {}", out.display());
    Ok(())
}

/// Writes the frames of `views` in their order. With `resume`, frames that are there are left as they are.
pub(super) fn sequence(
    studio: &Studio,
    views: &[View],
    numbering: &Numbering,
    args: &SequenceArgs,
) -> CommandResult {
    let bar = ProgressBar::new(views.len() as u64);
    bar.set_style(ProgressStyle::with_template("{bar:32} {pos}/{len} {per_sec:>12} eta {eta:>4}  {msg}")?);
    let (mut light, mut written) = (None, 0);
    for (index, view) in views.iter().enumerate() {
        let file = numbering.file(index);
        if !(args.resume && file.exists()) {
            output::write_named(&file, &studio.picture(view, &mut light)?)?;
            written += 1;
        }
        // Without a terminal there is no bar: twenty lines go to the log instead.
        if bar.is_hidden() && (index + 1).is_multiple_of((views.len() / 20).max(1)) {
            eprintln!("frame {}/{}  {}", index + 1, views.len(), file.display());
        }
        bar.set_message(file.display().to_string());
        bar.set_position(index as u64 + 1);
    }
    bar.finish();
    let there = views.len() - written;
    let kept = if there > 0 { format!(", {there} were there already") } else { String::new() };
    eprintln!("wrote {written} frames{kept}");
    Ok(())
}
