//! A model as a file of other programs: Gaussians with one colour, with their materials beside it where the format has a place.

use std::sync::Arc;

use crate::render::renderer::Renderer;
use crate::render::{MeshOptions, RenderError};
use relume_capture::formats::environment::{self, EnvironmentFileError};
use relume_capture::formats::ply_model::{self, PlyProperties};
use relume_capture::formats::splats::{Layer, Splats};
use relume_capture::formats::{gltf, usd};
use relume_engine::DeviceError;
use relume_scene::{Illumination, Model};
use relume_spec::rendering::ExportedColour;

/// The layer of the surface that `shown` is, if it is one.
fn layer(shown: ExportedColour) -> Option<Layer> {
    match shown {
        ExportedColour::Radiance | ExportedColour::Relit => None,
        ExportedColour::Albedo => Some(Layer::Albedo),
        ExportedColour::Normal => Some(Layer::Normal),
        ExportedColour::Roughness => Some(Layer::Roughness),
        ExportedColour::Metallic => Some(Layer::Metallic),
    }
}

/// A kind of file.
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
    /// The light of the photographs alone, a Radiance map.
    Hdr,
}

/// Why there is no file.
#[derive(Debug, thiserror::Error)]
pub enum SplatFileError {
    /// The glTF would be too large.
    #[error(transparent)]
    Gltf(#[from] gltf::GltfTooLarge),
    /// The package of a USD could not be made.
    #[error(transparent)]
    Package(#[from] zip::result::ZipError),
    /// The light could not be encoded.
    #[error(transparent)]
    Light(#[from] EnvironmentFileError),
    /// The model could not be rendered.
    #[error(transparent)]
    Render(#[from] RenderError),
}

/// Encodes a model.
///
/// Without `shown` the colour is the radiance and a PLY has the materials as well; with it, or of a model without materials, a PLY is
/// an ordinary file of splats. For [`ExportedColour::Relit`] the model is one that [`relit`] made. With `flatten` each Gaussian is turned
/// until its shortest axis is its shading normal.
///
/// # Errors
/// When the file would be too large for its format.
pub fn encode_splat_file(
    model: &Model,
    file: SplatFile,
    shown: Option<ExportedColour>,
    flatten: bool,
) -> Result<Vec<u8>, SplatFileError> {
    let mut splats = Splats::of(model);
    if flatten {
        splats = splats.flattened();
    }
    if file != SplatFile::Ply {
        splats = splats.with_y_up();
    }
    if let Some(layer) = shown.and_then(layer) {
        splats = splats.painted(layer);
    }
    let ordinary = shown.is_some() || !model.has_materials();
    let columns = if ordinary { PlyProperties::Ordinary } else { PlyProperties::Relightable };
    Ok(match file {
        SplatFile::Ply => ply_model::encode_splats(model, &splats, columns),
        SplatFile::Glb => gltf::encode_splats(&splats)?,
        SplatFile::Usda => usd::encode_splats(&splats).into_bytes(),
        SplatFile::Usdz => usd::encode_splats_package(&splats)?,
        SplatFile::Hdr => environment::encode_hdr(&model.environment())?,
    })
}

/// The model with the colours it has under `light`, as harmonics of `degree` (at most [`relume_spec::rendering::MAX_BAKED_DEGREE`]).
///
/// # Errors
/// When the light cannot be prepared.
pub fn relit(model: Model, light: impl Into<Illumination>, degree: usize) -> Result<Model, DeviceError> {
    let renderer = Renderer::new(Arc::new(model));
    let light = renderer.prepare_light(light)?;
    Ok(renderer.baked(&light, degree))
}

/// The surface of a model as a glTF file of triangles with textures; `cells` as in [`MeshOptions`].
///
/// # Errors
/// When there is no surface, `cells` are out of range, or the file would be too large.
pub fn encode_mesh_file(model: Model, cells: usize) -> Result<Vec<u8>, SplatFileError> {
    let options = MeshOptions { cells, ..MeshOptions::default() };
    let mesh = Renderer::new(Arc::new(model)).mesh(options)?;
    Ok(gltf::encode_mesh(&mesh)?)
}
