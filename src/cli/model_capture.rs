//! The capture of a model, read as its training did.

use std::path::Path;

use crate::cli::error::CommandResult;
use crate::cli::light::read_rotations;
use relume_capture::{Capture, ImportLimits, import};
use relume_scene::Model;
use relume_train::{import_options_of_card, light_groups_of_card};

/// Reads the capture at `path` in the world and with the colours of `model`. Prints its warnings.
///
/// # Errors
/// The error names the file.
pub(super) fn read(
    path: &Path,
    model: &Model,
    max_side: Option<u32>,
    light_rotations: Option<&Path>,
) -> CommandResult<Capture> {
    let options = import_options_of_card(&model.card, max_side, ImportLimits::default())?;
    let mut capture = import(path, &options)?;
    if let Some(file) = light_rotations {
        capture.set_light_rotations(&read_rotations(file)?)?;
    }
    if let Err(error) = capture.set_light_groups(&light_groups_of_card(&model.card)) {
        eprintln!("warning: photographs of unknown light groups have the first light: {error}");
    }
    capture.warnings.iter().for_each(|warning| eprintln!("warning: {warning}"));
    Ok(capture)
}
