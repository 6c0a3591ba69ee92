//! Imports models from files of splats: Relume's own PLY files, whose columns are recognised with or without their
//! comments, and ordinary splat files (PLY, compressed PLY, SPZ, `.splat`), which have colour but no materials.
//!
//! Each format becomes the table of an ordinary PLY (`kinds`), from which `columns` reads the Gaussians.

mod columns;
mod compressed_ply;
mod kinds;
mod splat_records;
mod spz;
mod usable;
mod world;

use serde_json::json;

pub use crate::formats::ply_table::PlyError;

use crate::formats::ply_model::{METADATA_COMMENT, PlyMetadata};
use crate::formats::ply_table::{PlyTable, bad};
use columns::SplatColumns;
use kinds::SplatFile;
use relume_scene::{Gaussians, IndirectForm, Model, VisibilityForm, softplus_inverse};
use usable::UsableRows;
use world::Extent;

/// Size of the environment of an imported model, which is uniform and white.
const LIGHT_SIZE: (usize, usize) = (16, 8);

/// A model read from a file of splats.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportedModel {
    /// The model.
    pub model: Model,
    /// Notes on values that the import omits or assumes. The model card has the same sentences in `imported.notes`.
    pub notes: Vec<String>,
}

/// Reads a model; the format is detected from the content. The files contain no light: the environment of the model is
/// white and uniform. A file without material columns gives a model with colour only ([`Model::has_materials`] is
/// false).
///
/// An opacity of infinity is full opacity, and a log-scale of minus infinity is a size of 0. Splats of opacity 0, and up
/// to half of the splats if they have values that are not finite or above 1e12 (sizes above 1e12 units), are left out with a
/// note. A rotation of zero becomes the identity, with a note. Splats of more than 10 times the radius of the model stay, with a
/// note.
///
/// # Errors
/// Names the property, vertex or part of the file that is missing or wrong, and the kind of a file without splats.
pub fn decode(bytes: &[u8]) -> Result<ImportedModel, PlyError> {
    let SplatFile { table, from, mut notes } = kinds::read(bytes)?;
    let columns = SplatColumns::of(&table)?;
    notes.extend(columns.note());
    let rows = UsableRows::of(&table, &columns)?;
    notes.extend(rows.notes());
    let gaussians = read_gaussians(&table, &columns, &rows);
    let extent = world::extent(&gaussians);
    notes.extend(extent.huge(&gaussians, |i| rows.row_of(i)));
    let lit = columns.material.is_some();
    let mut model = Model {
        card: json!({ "imported": { "from": from, "materials": lit } }),
        ..Model::new(
            gaussians,
            vec![[0.0; 3]],
            vec![[softplus_inverse(1.0); 3]; LIGHT_SIZE.0 * LIGHT_SIZE.1],
            (LIGHT_SIZE.0, LIGHT_SIZE.1),
        )
    };
    if !notes.is_empty() {
        model.card["imported"]["notes"] = json!(notes);
    }
    // Files of other programs have materials for renderers that conserve energy, and are classic, unless they state otherwise; Relume
    // trains with compensation.
    model.shading.conserves_energy = true;
    model.shading.low_pass_compensation = stated_compensation(&table.comments).unwrap_or(lit);
    read_metadata(&table, &extent, &mut model)?;
    if columns.material.as_ref().is_none_or(|m| m.visibility.is_empty()) {
        (model.shading.visibility, model.shading.indirect) = (VisibilityForm::Off, IndirectForm::Off);
    }
    if model.shading.indirect == IndirectForm::Learned {
        model.shading.indirect = IndirectForm::Off;
    }
    world::into_world(&mut model);
    if let Some(normal) = columns.normal {
        for (i, row) in rows.kept(&table).enumerate() {
            world::set_normal(&mut model, i, columns::pick(row, normal));
        }
    }
    model.check().map_err(|e| PlyError { field: e.field.to_owned(), reason: e.reason })?;
    Ok(ImportedModel { model, notes })
}

fn read_gaussians(table: &PlyTable, columns: &SplatColumns, rows: &UsableRows) -> Gaussians {
    let visibility_degree = columns.material.as_ref().map_or(0, |m| m.visibility_degree);
    let mut gaussians = Gaussians::zeroed(rows.len(), 1, visibility_degree, columns.degree());
    for (i, row) in rows.kept(table).enumerate() {
        columns.read_splat(row, i, &mut gaussians);
        if let Some(material) = &columns.material {
            material.read(row, i, &mut gaussians);
        }
    }
    gaussians
}

/// Whether the opacities need the low-pass compensation of Mip-Splatting, according to the comments: `SplatRenderMode:
/// mip`, `default` or `2dgs` (Brush, splat-transform) or `antialiased 0` or `1` (Postshot). The last one decides.
fn stated_compensation(comments: &[String]) -> Option<bool> {
    let stated = |line: &String| {
        let line = line.strip_prefix("comment ")?.trim().to_ascii_lowercase();
        if let Some(mode) = line.strip_prefix("splatrendermode:") {
            return match mode.trim() {
                "mip" => Some(true),
                "default" | "2dgs" => Some(false),
                _ => None,
            };
        }
        match line.strip_prefix("antialiased ")?.trim() {
            "1" => Some(true),
            "0" => Some(false),
            _ => None,
        }
    };
    comments.iter().rev().find_map(stated)
}

/// Reads shading options and world transform from the comments. Without them, the transform follows from the
/// extent of the Gaussians.
fn read_metadata(table: &PlyTable, extent: &Extent, model: &mut Model) -> Result<(), PlyError> {
    match table.comments.iter().find_map(|line| line.strip_prefix(METADATA_COMMENT)) {
        Some(text) => {
            let metadata: PlyMetadata = match serde_json::from_str(text) {
                Ok(metadata) => metadata,
                Err(error) => return bad("comment relume", error.to_string()),
            };
            if !(metadata.world_scale.is_finite() && metadata.world_scale > 0.0) {
                return bad("comment relume", "world_scale must be above 0");
            }
            (model.world_scale, model.world_offset) = (metadata.world_scale, metadata.world_offset);
            (model.shading, model.framing) = (metadata.shading, metadata.framing);
        }
        None => (model.world_scale, model.world_offset) = extent.world(),
    }
    Ok(())
}

#[cfg(test)]
mod tests;
