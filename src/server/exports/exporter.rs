//! The task that makes exports. It has two queues, so that a small file does not wait for a long sequence of frames.

use std::time::Duration;

use tokio_util::sync::CancellationToken;
use tracing::Instrument;

use crate::server::app::AppState;
use crate::server::exports::export_error::{BusyRetry, ExportError};
use crate::server::exports::{delight, frames, light_matrix, splats};
use crate::store::{ClaimedExport, ExportedFile, StoreError};
use relume_api::ExportId;
use relume_api::exports::NewExport;

/// Time between two checks of the queue without a notification.
const INTERVAL: Duration = Duration::from_secs(10);
/// Time between two attempts while the disk is full or the database cannot be reached.
const PAUSE: Duration = Duration::from_secs(2);

/// Makes exports until the server stops.
pub(in crate::server) async fn work(app: AppState) {
    tokio::join!(lane(&app, true), lane(&app, false));
}

/// Makes exports of frames, or all other exports, one after the other.
async fn lane(app: &AppState, frames: bool) {
    while !app.stop.is_cancelled() {
        // Also removes the folders of cancelled and failed exports.
        if frames && let Err(error) = app.store.clear_export_folders().await {
            tracing::error!(%error, "cannot remove leftover files of exports yet");
        }
        match app.store.claim_export(frames, app.jobs.now_ms()).await {
            Ok(Some(export)) => {
                let span = tracing::info_span!("export", id = %export.record.id);
                run(app, export).instrument(span).await;
                continue;
            }
            Ok(None) => {}
            Err(error) => tracing::error!(%error, "cannot claim exports yet"),
        }
        tokio::select! {
            () = app.stop.cancelled() => {}
            () = app.exports.wait_for_wake(frames) => {}
            () = tokio::time::sleep(INTERVAL) => {}
        }
    }
}

/// Makes one export and records its result.
async fn run(app: &AppState, export: ClaimedExport) {
    let id = export.record.id.clone();
    let token = app.stop.child_token();
    app.exports.begin(&id, token.clone());
    let made = tokio::select! {
        biased;
        () = token.cancelled() => Err(ExportError::Unwanted),
        made = make(app, &export, &token) => made,
    };
    app.exports.end(&id);
    // Stops the remaining work on the export.
    token.cancel();
    let kept = match made {
        Ok(file) => publish(app, &id, file).await,
        // Has an effect if the server stops, or if the model was replaced. An export that was cancelled or deleted stays so.
        Err(ExportError::Unwanted) => {
            app.store.requeue_exports(Some(&id)).await.map(drop).map_err(ExportError::from)
        }
        Err(failed) => Err(failed),
    };
    match kept {
        Ok(()) | Err(ExportError::Unwanted) => {}
        Err(ExportError::Paused(error)) => {
            tracing::warn!(%error, export = %id, "an export is paused");
            if !matches!(error, StoreError::DatabaseUnreachable(_)) {
                app.store.disk_space().note_shortage(1);
            }
            record(app, &id, None).await;
            pause(app).await;
        }
        Err(ExportError::Failed { code, detail }) => {
            tracing::info!(export = %id, code, detail, "an export failed");
            record(app, &id, Some((&code, &detail))).await;
        }
    }
}

/// Waits before the next attempt, or until the server stops.
async fn pause(app: &AppState) {
    tokio::select! {
        () = app.stop.cancelled() => {}
        () = tokio::time::sleep(PAUSE) => {}
    }
}

/// Records that an export failed with this code and detail, or that it waits again. On a full disk the reserve is released. Tries
/// again until it succeeds or the server stops; then the next start queues the export again.
async fn record(app: &AppState, id: &ExportId, failure: Option<(&str, &str)>) {
    while !app.stop.is_cancelled() {
        let recorded = match failure {
            Some((code, detail)) => app.store.fail_export(id, code, detail, app.jobs.now_ms()).await,
            None => app.store.requeue_exports(Some(id)).await.map(drop),
        };
        match recorded {
            Ok(()) => return,
            Err(StoreError::Full) if app.store.disk_space().spend_reserve() => continue,
            Err(error) => tracing::error!(%error, export = %id, "cannot record the state of an export yet"),
        }
        pause(app).await;
    }
}

/// Publishes the file of an export, when the object store is reachable.
async fn publish(app: &AppState, id: &ExportId, file: ExportedFile) -> Result<(), ExportError> {
    let busy_retry = BusyRetry::new();
    loop {
        match app.store.publish_export(id, file.clone(), app.jobs.now_ms()).await {
            // The next server publishes it from the files in its folder.
            Err(StoreError::ArtifactsUnreachable(_)) if app.stop.is_cancelled() => return Ok(()),
            Err(error @ StoreError::ArtifactsUnreachable(_)) => busy_retry.wait(error.into()).await?,
            kept => return Ok(kept.map(drop)?),
        }
    }
}

async fn make(
    app: &AppState,
    export: &ClaimedExport,
    token: &CancellationToken,
) -> Result<ExportedFile, ExportError> {
    match &export.request {
        NewExport::Frames(spec) => frames::make(app, &export.record, spec, token).await,
        NewExport::Splats(spec) => splats::make(app, &export.record, spec, token).await,
        NewExport::Mesh(spec) => splats::make_mesh(app, &export.record, spec, token).await,
        NewExport::LightMatrix(spec) => light_matrix::make(app, &export.record, spec, token).await,
        NewExport::Delight(spec) => delight::make(app, &export.record, spec, token).await,
    }
}
