//! Makes files of other programs.

use crate::api::exports::{ExportKind, MeshExport, SplatsExport};
use crate::api::renders::EnvironmentSpec;
use crate::formats::model_file;
use crate::render::{Shown, SplatFile, SplatFileError, encode_mesh_file, encode_splat_file, relit};
use crate::scene::Model;
use crate::server::app::Shared;
use crate::server::exports::ended::{Ended, Patience};
use crate::server::exports::light::light;
use crate::server::exports::request;
use crate::server::memory::of_export;
use crate::server::models;
use crate::store::{ExportRecord, ExportedFile, make_private};
use crate::worker::{LightSource, ModelContent, ModelSource};

/// Makes a file of Gaussians.
pub(super) async fn make(
    app: &Shared,
    export: &ExportRecord,
    spec: &SplatsExport,
) -> Result<ExportedFile, Ended> {
    let shown = request::shown(spec)?;
    let environment = spec.environment.clone().unwrap_or_default();
    let light = match shown {
        Some(Shown::Relit) => Some(light(app, &export.tenant, &environment).await?),
        _ => None,
    };
    let (file, extension, content_type) = file_of(export.kind);
    let (degree, flatten) = (spec.relit_degree as usize, spec.flatten);
    let (source, _) = models::source(app, &export.tenant, &export.model_id).await?;
    let bytes = with_model(app, &source, 0, move |mut model| {
        if let Some(light) = light {
            model = under(model, &light, &environment, degree)?;
        }
        encode_splat_file(&model, file, shown, flatten).map_err(refused)
    })
    .await?;
    let layer = shown.map_or_else(String::new, |shown| format!("-{}", layer_name(shown)));
    let name = format!("{}{layer}.{extension}", export.model_id);
    write(app, export, name, content_type, bytes).await
}

/// Makes a surface.
pub(super) async fn make_mesh(
    app: &Shared,
    export: &ExportRecord,
    spec: &MeshExport,
) -> Result<ExportedFile, Ended> {
    let cells = spec.cells as usize;
    let (source, _) = models::source(app, &export.tenant, &export.model_id).await?;
    let bytes =
        with_model(app, &source, cells, move |model| encode_mesh_file(model, cells).map_err(refused)).await?;
    let (_, extension, content_type) = file_of(export.kind);
    write(app, export, format!("{}-mesh.{extension}", export.model_id), content_type, bytes).await
}

/// Reads a model and works with it on threads of its own, with the memory borrowed that it takes; `cells` as in a mesh, 0 for
/// anything else. The work goes on to its end when nobody waits for it any more.
pub(super) async fn with_model<T: Send + 'static>(
    app: &Shared,
    source: &ModelSource,
    cells: usize,
    work: impl FnOnce(Model) -> Result<T, Ended> + Send + 'static,
) -> Result<T, Ended> {
    let ModelContent::File(path) = source.content.clone() else {
        return Err(Ended::failed("the model is not a file"));
    };
    let size = tokio::fs::metadata(&path).await?.len();
    let patience = Patience::new();
    let memory = loop {
        match app.memory.borrow(of_export(size, cells)).await {
            Ok(memory) => break memory,
            Err(refusal) => patience.wait(refusal).await?,
        }
    };
    let made = app.exports.makers.run(move || {
        let _held = memory;
        let model = model_file::decode(&std::fs::read(&path)?);
        work(model.map_err(|error| Ended::failed(format!("the model cannot be read: {error}")))?)
    });
    made.await?
}

/// The model under a light.
fn under(model: Model, light: &LightSource, spec: &EnvironmentSpec, degree: usize) -> Result<Model, Ended> {
    let map = light.map().map_err(|why| Ended::failed(format!("the environment cannot be read: {why}")))?;
    let map = match map {
        Some(map) => map.rotated_and_scaled(spec.rotation_deg, spec.exposure_ev.exp2() as f32),
        None => model.environment().rotated_and_scaled(spec.rotation_deg, spec.exposure_ev.exp2() as f32),
    };
    relit(model, &map, degree).map_err(|error| Ended::failed(error.to_string()))
}

fn refused(error: SplatFileError) -> Ended {
    Ended::failed(error.to_string())
}

/// The file of a kind, its extension and its media type.
fn file_of(kind: ExportKind) -> (SplatFile, &'static str, &'static str) {
    match kind {
        ExportKind::Gltf | ExportKind::Mesh | ExportKind::Frames => {
            (SplatFile::Glb, "glb", "model/gltf-binary")
        }
        ExportKind::Usd => (SplatFile::Usda, "usda", "model/vnd.usda"),
        ExportKind::Usdz => (SplatFile::Usdz, "usdz", "model/vnd.usdz+zip"),
        ExportKind::Ply => (SplatFile::Ply, "ply", "application/octet-stream"),
    }
}

fn layer_name(shown: Shown) -> &'static str {
    match shown {
        Shown::Radiance => "radiance",
        Shown::Relit => "relit",
        Shown::Albedo => "albedo",
        Shown::Normal => "normal",
        Shown::Roughness => "roughness",
        Shown::Metallic => "metallic",
    }
}

/// Writes a file into the work folder, as far as the tenant may store it.
async fn write(
    app: &Shared,
    export: &ExportRecord,
    name: String,
    content_type: &'static str,
    bytes: Vec<u8>,
) -> Result<ExportedFile, Ended> {
    let size = bytes.len() as u64;
    app.store.admit_bytes_of(&export.tenant, size).await?;
    app.store.admit_bytes(size).await?;
    let folder = app.store.export_folder(&export.id);
    make_private(&folder)?;
    let path = folder.join("file");
    tokio::fs::write(&path, bytes).await?;
    Ok(ExportedFile { path, name, content_type })
}
