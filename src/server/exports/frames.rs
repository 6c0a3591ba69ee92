//! Exports of frames. Each finished frame is a file in the work folder of its export, so that the next server can continue after
//! a stop.

use std::path::Path;
use std::sync::Arc;

use tokio::io::AsyncWriteExt;
use tokio_util::sync::CancellationToken;

use crate::server::app::AppState;
use crate::server::exports::export_error::{BusyRetry, ExportError};
use crate::server::exports::plan::FramesPlan;
use crate::server::exports::work_folder::{prepared, run_blocking};
use crate::server::exports::{model, splats, video, zip};
use crate::server::memory::export_bytes;
use crate::server::{models, renders};
use crate::store::{ExportRecord, ExportedFile};
use crate::worker::{ModelSource, RenderTask};
use relume_api::TenantId;
use relume_api::exports::{FramesExport, Package};
use relume_scene::Model;
use relume_spec::rendering::{Background, FrameFormat};
use relume_train::render::{EncodeOptions, FrameView, Viewpoint};

/// Frames per second of a video without a given rate.
const FPS: u32 = 24;

/// Renders the missing frames, and makes a zip or a video of all.
pub(super) async fn make(
    app: &AppState,
    export: &ExportRecord,
    spec: &FramesExport,
    token: &CancellationToken,
) -> Result<ExportedFile, ExportError> {
    let up = models::world_of(app, &export.tenant, &export.model_id).await?;
    let plan = FramesPlan::of(app, &export.tenant, spec, up).await?;
    let (source, sha256) = model::source(app, export, &spec.materials).await?;
    let plan = Arc::new(plan);
    let views = views(app, &plan, &export.tenant, &source).await?;
    let folder = prepared(app, export, sha256).await?;
    let (mut names, mut bytes) = (Vec::with_capacity(views.len()), 0);
    for (index, view) in views.iter().enumerate() {
        let name = frame_name(index, plan.format);
        let file = folder.join(&name);
        if let Ok(found) = tokio::fs::metadata(&file).await {
            bytes += found.len();
        } else {
            let frame = frame(app, &source, &plan, spec, view).await?;
            let size = frame.len() as u64;
            app.store.admit_bytes_of(&export.tenant, size).await?;
            app.store.admit_bytes(size).await?;
            write_whole(&file, &frame).await?;
            bytes += size;
            let done = i64::try_from(index + 1).unwrap_or(i64::MAX);
            if !app.store.record_export_progress(&export.id, done, bytes).await? {
                return Err(ExportError::Unwanted);
            }
        }
        names.push(name);
    }
    // The disk contains both for a while; the quota of the tenant counts only one of them.
    app.store.admit_bytes(bytes).await?;
    package(app, export, spec, &folder, names, token).await
}

/// File name of the frame with index `index`, from 0.
pub(super) fn frame_name(index: usize, format: FrameFormat) -> String {
    format!("{:04}.{}", index + 1, format.extension())
}

/// The views. A turntable depends on the model, which is then read.
async fn views(
    app: &AppState,
    plan: &Arc<FramesPlan>,
    tenant: &TenantId,
    source: &ModelSource,
) -> Result<Vec<FrameView>, ExportError> {
    if !plan.needs_model() {
        return Ok(plan.path_views());
    }
    let plan = plan.clone();
    // Not the threads of files: a mesh may occupy them for minutes.
    let views = move |model: Model| plan.views(&model).map_err(ExportError::from);
    let bytes_of = |size| export_bytes(size, 0);
    splats::with_model(app, &app.decoders, tenant, (source, &bytes_of), views).await
}

/// Renders and encodes one frame when no other request waits for a frame.
async fn frame(
    app: &AppState,
    model: &ModelSource,
    plan: &FramesPlan,
    spec: &FramesExport,
    view: &FrameView,
) -> Result<Vec<u8>, ExportError> {
    let task = RenderTask {
        model: model.clone(),
        light: plan.light.clone(),
        rotation_deg: spec.environment.rotation_deg + view.light_rotation_deg,
        exposure_ev: spec.environment.exposure_ev,
        viewpoint: Viewpoint::Camera(view.camera),
        shows_environment: plan.encoding.background == Background::Environment,
        quality: plan.quality,
        outputs: spec.outputs.clone(),
        ground_height: spec.ground_height,
        lamps: spec.lamps.clone(),
        neighbours: view.neighbours,
    };
    let mut frame_metadata = renders::notes(&task, Some(view.camera));
    frame_metadata.frames_per_second = spec.frames_per_second;
    let encoding = EncodeOptions { frame_metadata, ..plan.encoding.clone() };
    let busy_retry = BusyRetry::new();
    loop {
        match renders::render_in_background(app, task.clone(), plan.format, encoding.clone()).await {
            Ok(bytes) => return Ok(bytes),
            Err(refusal) => busy_retry.wait(refusal).await?,
        }
    }
}

/// Writes a file atomically. The file is durable on return.
async fn write_whole(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let part = path.with_extension("part");
    let mut file = tokio::fs::File::create(&part).await?;
    file.write_all(bytes).await?;
    file.sync_all().await?;
    tokio::fs::rename(&part, path).await
}

async fn package(
    app: &AppState,
    export: &ExportRecord,
    spec: &FramesExport,
    folder: &Path,
    names: Vec<String>,
    token: &CancellationToken,
) -> Result<ExportedFile, ExportError> {
    let (model, from, token) = (&export.model_id, folder.to_owned(), token.clone());
    let is_wanted = move || !token.is_cancelled();
    match spec.package {
        Package::Zip => {
            let path = folder.join("frames.zip");
            let to = path.clone();
            run_blocking(move || Ok(zip::pack(&from, &names, &to, &is_wanted)?)).await?;
            Ok(ExportedFile { path, name: format!("{model}.zip"), content_type: "application/zip" })
        }
        Package::Mp4 => {
            let path = folder.join("frames.mp4");
            let (to, ffmpeg) = (path.clone(), app.exports.policy.ffmpeg.clone());
            let (extension, fps) = (spec.format.extension(), spec.frames_per_second.unwrap_or(FPS));
            run_blocking(move || video::encode(&ffmpeg, &from, extension, fps, &to, &is_wanted)).await?;
            Ok(ExportedFile { path, name: format!("{model}.mp4"), content_type: "video/mp4" })
        }
    }
}
