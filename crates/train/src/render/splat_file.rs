//! Exports a model to the file formats of other programs: Gaussians with one colour, and their materials if the
//! format supports them.

use std::borrow::Cow;
use std::sync::Arc;

use crate::render::renderer::Renderer;
use crate::render::splat_budget::{BudgetedFile, SplatBudget};
use crate::render::{MeshOptions, RenderError};
use relume_capture::formats::environment::{self, EnvironmentFileError};
use relume_capture::formats::ply_model::{self, PlyProperties};
use relume_capture::formats::splats::{Layer, Splats};
use relume_capture::formats::{gltf, usd};
use relume_engine::DeviceError;
use relume_scene::{Illumination, Model};
use relume_spec::rendering::ExportedColour;

/// The surface property that `shown` selects; `None` for radiance and relit colour.
fn layer(shown: ExportedColour) -> Option<Layer> {
    match shown {
        ExportedColour::Radiance | ExportedColour::Relit => None,
        ExportedColour::Albedo => Some(Layer::Albedo),
        ExportedColour::Normal => Some(Layer::Normal),
        ExportedColour::Roughness => Some(Layer::Roughness),
        ExportedColour::Metallic => Some(Layer::Metallic),
    }
}

/// A file format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SplatFile {
    /// PLY as splat viewers read it.
    Ply,
    /// glTF with KHR_gaussian_splatting.
    Glb,
    /// OpenUSD as text.
    Usda,
    /// OpenUSD in a package.
    Usdz,
    /// A Radiance map with only the light of the photographs.
    Hdr,
}

/// Errors of an export.
#[derive(Debug, thiserror::Error)]
pub enum SplatFileError {
    /// The glTF would be too large.
    #[error(transparent)]
    Gltf(#[from] gltf::GltfTooLarge),
    /// The USD package could not be written.
    #[error(transparent)]
    Package(#[from] zip::result::ZipError),
    /// The light could not be encoded.
    #[error(transparent)]
    Light(#[from] EnvironmentFileError),
    /// The model could not be rendered.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// The limit is too small for one Gaussian.
    #[error("a file of {limit} bytes cannot hold a Gaussian; allow a larger file")]
    Budget {
        /// The limit, bytes.
        limit: u64,
    },
}

/// Encodes a whole model, see [`encode_splat_file_within`].
fn encode_splat_file(
    model: &Model,
    file: SplatFile,
    shown: Option<ExportedColour>,
    flatten: bool,
) -> Result<Vec<u8>, SplatFileError> {
    let ordinary = shown.is_some() || !model.has_materials();
    let columns = if ordinary { PlyProperties::Ordinary } else { PlyProperties::Relightable };
    let has_rates = file == SplatFile::Ply && !ordinary;
    let model = if has_rates { Cow::Borrowed(model) } else { as_shown(model) };
    let model = &*model;
    let mut splats = Splats::of(model);
    if !has_rates {
        splats = splats.with_low_pass(model);
    }
    if flatten {
        splats = splats.flattened();
    }
    if file != SplatFile::Ply {
        splats = splats.with_y_up();
    }
    if let Some(layer) = shown.and_then(layer) {
        splats = splats.painted(layer);
    }
    Ok(match file {
        SplatFile::Ply => ply_model::encode_splats(model, &splats, columns),
        SplatFile::Glb => gltf::encode_splats(&splats)?,
        SplatFile::Usda => usd::encode_splats(&splats).into_bytes(),
        SplatFile::Usdz => usd::encode_splats_package(&splats)?,
        SplatFile::Hdr => environment::encode_hdr(&model.environment(0))?,
    })
}

/// Encodes a model with as many Gaussians as `budget` allows. Stops early once `is_wanted` returns false.
///
/// Without `shown`, the colour is the radiance and a PLY includes the materials. With `shown`, and for a model
/// without materials, a PLY is an ordinary splat file. For [`ExportedColour::Relit`] the model must come from
/// [`relit`]. With `flatten`, each Gaussian is rotated until its shortest axis is its shading normal.
///
/// The PLY with materials states the sampling rates. All other files have Gaussians widened for enlargement
/// ([`Splats::with_low_pass`]), without those that no photograph shows.
///
/// # Errors
/// If the file would be too large for its format, or the budget is too small for one Gaussian, or the file is not wanted.
pub fn encode_splat_file_within(
    model: Model,
    file: SplatFile,
    shown: Option<ExportedColour>,
    flatten: bool,
    budget: SplatBudget,
    is_wanted: &dyn Fn() -> bool,
) -> Result<BudgetedFile, SplatFileError> {
    let has_rates = file == SplatFile::Ply && shown.is_none() && model.has_materials();
    let shown_model = if has_rates { None } else { hidden_left_out(&model) };
    let model = shown_model.unwrap_or(model);
    budget.encode(model, |model| encode_splat_file(model, file, shown, flatten), is_wanted)
}

/// The model without the Gaussians that frames omit.
fn as_shown(model: &Model) -> Cow<'_, Model> {
    hidden_left_out(model).map_or(Cow::Borrowed(model), Cow::Owned)
}

/// The model without the Gaussians that frames omit; `None` if it has no such Gaussians.
fn hidden_left_out(model: &Model) -> Option<Model> {
    let g = &model.gaussians;
    let has_hidden = (0..g.len()).any(|i| !g.is_photographed(i));
    has_hidden.then(|| Model { gaussians: g.photographed(), ..model.clone() })
}

/// The model with its colours under `light`, as SH of `degree` (at most
/// [`relume_spec::rendering::MAX_BAKED_DEGREE`]).
///
/// # Errors
/// If the light cannot be prepared.
pub fn relit(model: Model, light: impl Into<Illumination>, degree: usize) -> Result<Model, DeviceError> {
    let renderer = Renderer::new(Arc::new(model));
    let light = renderer.prepare_light(light)?;
    Ok(renderer.baked(&light, degree))
}

/// The surface of a model as a glTF file of textured triangles; `cells` as in [`MeshOptions`].
///
/// # Errors
/// If the model has no surface, `cells` is out of range, or the file would be too large.
pub fn encode_mesh_file(
    model: Model,
    cells: usize,
    is_wanted: &dyn Fn() -> bool,
) -> Result<Vec<u8>, SplatFileError> {
    let options = MeshOptions { cells, ..MeshOptions::default() };
    let mesh = Renderer::new(Arc::new(model)).mesh(options, is_wanted)?;
    Ok(gltf::encode_mesh(&mesh)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_capture::formats::splat_import;
    use relume_scene::{Field, Gaussians};

    /// Two Gaussians with materials; no photograph shows the second one if `is_hidden`.
    fn model(is_hidden: bool) -> Model {
        let mut g = Gaussians::zeroed(2, 1, 0, 0);
        for i in 0..2 {
            g.row_mut(Field::Mean, i)[0] = i as f32;
            g.row_mut(Field::LogScale, i).fill(-3.0);
            g.row_mut(Field::Quaternion, i)[0] = 1.0;
            g.row_mut(Field::OpacityLogit, i)[0] = 2.0;
        }
        g.field_mut(Field::SamplingRate).copy_from_slice(&[8.0, if is_hidden { -8.0 } else { 8.0 }]);
        Model::new(g, vec![[0.5; 3]], vec![[0.5; 3]; 8], (4, 2))
    }

    #[test]
    fn only_the_relightable_file_has_unphotographed_gaussians() {
        let count = |model: &Model, shown: Option<ExportedColour>| {
            let bytes = encode_splat_file(model, SplatFile::Ply, shown, false).unwrap();
            let gaussians = splat_import::decode(&bytes).unwrap().model.gaussians;
            let photographed = (0..gaussians.len()).filter(|i| gaussians.is_photographed(*i)).count();
            (gaussians.len(), photographed)
        };
        for shown in [ExportedColour::Radiance, ExportedColour::Albedo] {
            assert_eq!(count(&model(true), Some(shown)), (1, 1));
            assert_eq!(count(&model(false), Some(shown)), (2, 2), "the control");
        }
        assert_eq!(count(&model(true), None), (2, 1));
    }
}
