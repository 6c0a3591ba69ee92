//! Options that change materials of a model before it is used.

use std::path::{Path, PathBuf};

use crate::cli::input;
use relume_scene::Model;
use relume_spec::rendering::MaterialEdit;
use relume_train::palette::edited;

/// Options that change materials of a model before it is used. The model file stays as it is.
#[derive(Debug, Default, clap::Args)]
pub(super) struct MaterialArgs {
    /// Change materials, separated by commas: `3=#224488` (colour, sRGB), `5*=1.2` (factor of the albedo), `3.roughness=0.4`,
    /// `3.metalness=1`, `3.into=0` (merge material 3 into 0), `3.split=X:Y:Z:RADIUS` (the part in a ball becomes a new material). `relume materials` lists the materials.
    #[arg(long, visible_alias = "recolor", value_name = "CHANGES", value_delimiter = ',')]
    recolour: Vec<MaterialEdit>,
    /// A JSON file with changes of materials, as `relume materials --recolour ... --save FILE` writes it. They come before those of
    /// `--recolour`.
    #[arg(long, value_name = "FILE")]
    edits: Option<PathBuf>,
}

impl MaterialArgs {
    /// All changes in their order.
    pub(super) fn edits(&self) -> Result<Vec<MaterialEdit>, String> {
        let mut edits = self.edits.as_deref().map(read).transpose()?.unwrap_or_default();
        edits.extend(&self.recolour);
        Ok(edits)
    }

    /// The model with its changes.
    pub(super) fn apply(&self, model: Model) -> Result<Model, String> {
        match self.edits()?.as_slice() {
            [] => Ok(model),
            edits => edited(&model, edits).map_err(|error| format!("{}: {error}", self.option())),
        }
    }

    /// The option that an error of the changes names.
    fn option(&self) -> &'static str {
        if self.recolour.is_empty() { "--edits" } else { "--recolour" }
    }
}

/// The changes in a file.
fn read(path: &Path) -> Result<Vec<MaterialEdit>, String> {
    let named = |error: String| format!("{}: {error}", path.display());
    let json = serde_json::from_slice(&input::read(path)?).map_err(|error| named(error.to_string()))?;
    let edits: Vec<MaterialEdit> = input::from_json(json).map_err(named)?;
    match edits.iter().enumerate().find_map(|(i, edit)| Some((i, edit.fault()?))) {
        Some((i, (field, reason))) => Err(named(format!("[{i}].{field}: {reason}"))),
        None => Ok(edits),
    }
}
