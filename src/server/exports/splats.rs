//! Exports of files for other programs.

use tokio_util::sync::CancellationToken;

use crate::server::app::AppState;
use crate::server::decoders::Decoders;
use crate::server::exports::export_error::{BusyRetry, ExportError};
use crate::server::exports::light::light;
use crate::server::exports::{model, request};
use crate::server::memory::{export_bytes, limited_export_bytes};
use crate::store::{ExportRecord, ExportedFile, make_private};
use crate::worker::{LightSource, ModelContent, ModelSource};
use relume_api::TenantId;
use relume_api::exports::{ExportKind, MeshExport, SplatsExport};
use relume_api::renders::EnvironmentSpec;
use relume_capture::formats::model_file;
use relume_scene::Model;
use relume_spec::rendering::ExportedColour;
use relume_train::render::{
    RenderError, SplatBudget, SplatFile, SplatFileError, encode_mesh_file, encode_splat_file_within, relit,
};

/// Makes a file of Gaussians.
pub(super) async fn make(
    app: &AppState,
    export: &ExportRecord,
    spec: &SplatsExport,
    token: &CancellationToken,
) -> Result<ExportedFile, ExportError> {
    let shown = request::shown(spec)?;
    let environment = spec.environment.clone().unwrap_or_default();
    let light = match shown {
        Some(ExportedColour::Relit) => Some(light(app, &export.tenant, &environment).await?),
        _ => None,
    };
    let (file, extension, content_type) = file_of(export.kind);
    let (degree, flatten) = (spec.relit_degree as usize, spec.flatten);
    let budget = SplatBudget { splats: spec.max_splats, bytes: spec.max_bytes };
    let (source, _) = model::source(app, export, &spec.materials).await?;
    let is_limited = spec.max_splats.is_some() || spec.max_bytes.is_some();
    let bytes_of = move |size| if is_limited { limited_export_bytes(size) } else { export_bytes(size, 0) };
    let token = token.clone();
    let bytes =
        with_model(app, &app.exports.file_threads, &export.tenant, (&source, &bytes_of), move |mut model| {
            if let Some(light) = light {
                model = relight(model, &light, &environment, degree)?;
            }
            encode_splat_file_within(model, file, shown, flatten, budget, &|| !token.is_cancelled())
                .map(|file| file.bytes)
                .map_err(refused)
        })
        .await?;
    let layer = shown.map_or_else(String::new, |shown| format!("-{}", layer_name(shown)));
    let name = format!("{}{layer}.{extension}", export.model_id);
    write(app, export, name, content_type, bytes).await
}

/// Makes a file with a mesh.
pub(super) async fn make_mesh(
    app: &AppState,
    export: &ExportRecord,
    spec: &MeshExport,
    token: &CancellationToken,
) -> Result<ExportedFile, ExportError> {
    let (cells, token) = (spec.cells as usize, token.clone());
    let (source, _) = model::source(app, export, &spec.materials).await?;
    let bytes_of = |size| export_bytes(size, cells);
    let bytes =
        with_model(app, &app.exports.file_threads, &export.tenant, (&source, &bytes_of), move |model| {
            encode_mesh_file(model, cells, &|| !token.is_cancelled()).map_err(refused)
        })
        .await?;
    let (_, extension, content_type) = file_of(export.kind);
    write(app, export, format!("{}-mesh.{extension}", export.model_id), content_type, bytes).await
}

/// Reads a model and runs `work` on `threads`, with a permit for the memory, which is a function of the size of the model's file. The
/// work continues even if the future is dropped, until it asks whether it is wanted.
pub(super) async fn with_model<T: Send + 'static>(
    app: &AppState,
    threads: &Decoders,
    tenant: &TenantId,
    (source, bytes_of): (&ModelSource, &(dyn Fn(u64) -> u64 + Sync)),
    work: impl FnOnce(Model) -> Result<T, ExportError> + Send + 'static,
) -> Result<T, ExportError> {
    let ModelContent::File(path) = source.content.clone() else {
        return Err(ExportError::failed("the model is not a file"));
    };
    let size = tokio::fs::metadata(&path).await?.len();
    let busy_retry = BusyRetry::new();
    let memory = loop {
        match app.memory.reserve(bytes_of(size)).await {
            Ok(memory) => break memory,
            Err(refusal) => busy_retry.wait(refusal).await?,
        }
    };
    let materials = source.materials.clone();
    let made = threads.run(tenant, move || {
        let _held = memory;
        let model = model_file::decode(&std::fs::read(&path)?);
        let model =
            model.map_err(|error| ExportError::failed(format!("the model cannot be read: {error}")))?;
        work(materials.apply(model).map_err(|error| ExportError::failed(error.to_string()))?)
    });
    made.await?
}

/// The model with colours under a light.
fn relight(
    model: Model,
    light: &LightSource,
    spec: &EnvironmentSpec,
    degree: usize,
) -> Result<Model, ExportError> {
    let unreadable = |why| ExportError::failed(format!("the environment cannot be read: {why}"));
    let light = light.illumination(&model).map_err(unreadable)?;
    let light = light.rotated_and_scaled(spec.rotation_deg, spec.exposure_ev.exp2() as f32);
    relit(model, light, degree).map_err(|error| ExportError::failed(error.to_string()))
}

fn refused(error: SplatFileError) -> ExportError {
    match error {
        SplatFileError::Render(RenderError::Abandoned) => ExportError::Unwanted,
        error => ExportError::failed(error.to_string()),
    }
}

/// The encoder of a kind, its extension and its media type.
fn file_of(kind: ExportKind) -> (SplatFile, &'static str, &'static str) {
    match kind {
        ExportKind::Gltf
        | ExportKind::Mesh
        | ExportKind::Frames
        | ExportKind::LightMatrix
        | ExportKind::Delight => (SplatFile::Glb, "glb", "model/gltf-binary"),
        ExportKind::Usd => (SplatFile::Usda, "usda", "model/vnd.usda"),
        ExportKind::Usdz => (SplatFile::Usdz, "usdz", "model/vnd.usdz+zip"),
        ExportKind::Ply => (SplatFile::Ply, "ply", "application/octet-stream"),
    }
}

fn layer_name(shown: ExportedColour) -> &'static str {
    match shown {
        ExportedColour::Radiance => "radiance",
        ExportedColour::Relit => "relit",
        ExportedColour::Albedo => "albedo",
        ExportedColour::Normal => "normal",
        ExportedColour::Roughness => "roughness",
        ExportedColour::Metallic => "metallic",
    }
}

/// Writes a file into the work folder, within the tenant's quota.
async fn write(
    app: &AppState,
    export: &ExportRecord,
    name: String,
    content_type: &'static str,
    bytes: Vec<u8>,
) -> Result<ExportedFile, ExportError> {
    let size = bytes.len() as u64;
    app.store.admit_bytes_of(&export.tenant, size).await?;
    app.store.admit_bytes(size).await?;
    let folder = app.store.export_folder(&export.id);
    make_private(&folder)?;
    let path = folder.join("file");
    tokio::fs::write(&path, bytes).await?;
    Ok(ExportedFile { path, name, content_type })
}
