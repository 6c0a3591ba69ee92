//! The task that makes exports. Two lanes, so that a small file does not wait for a long sequence of frames.

use std::time::Duration;

use tokio_util::sync::CancellationToken;
use tracing::Instrument;

use crate::server::app::AppState;
use crate::server::exports::export_error::{BusyRetry, ExportError};
use crate::server::exports::{frames, splats};
use crate::store::{ClaimedExport, ExportedFile, StoreError};
use relume_api::ExportId;
use relume_api::exports::NewExport;

/// Time between two looks when nobody asks for one.
const INTERVAL: Duration = Duration::from_secs(10);

/// Makes exports until the server stops.
pub(in crate::server) async fn work(app: AppState) {
    tokio::join!(lane(&app, true), lane(&app, false));
}

/// Makes those of frames, or all others, one after another.
async fn lane(app: &AppState, frames: bool) {
    while !app.stop.is_cancelled() {
        // What was cancelled or has failed leaves its folder to this.
        if frames && let Err(error) = app.store.clear_export_folders().await {
            tracing::error!(%error, "what exports left cannot be removed yet");
        }
        match app.store.claim_export(frames, app.jobs.now_ms()).await {
            Ok(Some(export)) => {
                let span = tracing::info_span!("export", id = %export.record.id);
                run(app, export).instrument(span).await;
                continue;
            }
            Ok(None) => {}
            Err(error) => tracing::error!(%error, "exports cannot be made yet"),
        }
        tokio::select! {
            () = app.stop.cancelled() => {}
            () = app.exports.wait_for_wake(frames) => {}
            () = tokio::time::sleep(INTERVAL) => {}
        }
    }
}

/// Makes one, and writes down what came of it.
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
    // Whatever still works on it aside ends soon.
    token.cancel();
    let kept = match made {
        Ok(file) => publish(app, &id, file).await,
        Err(ExportError::Unwanted) if app.stop.is_cancelled() => {
            app.store.requeue_exports(Some(&id)).await.map(drop).map_err(ExportError::from)
        }
        Err(ExportError::Unwanted) => Ok(()),
        Err(failed) => Err(failed),
    };
    if let Err(ExportError::Failed { code, detail }) = kept {
        tracing::info!(export = %id, code, detail, "an export cannot be made");
        if let Err(error) = app.store.fail_export(&id, &code, &detail, app.jobs.now_ms()).await {
            tracing::error!(%error, export = %id, "the next start makes an export again");
        }
    }
}

/// Keeps the file of one, once the object store is there.
async fn publish(app: &AppState, id: &ExportId, file: ExportedFile) -> Result<(), ExportError> {
    let busy_retry = BusyRetry::new();
    loop {
        match app.store.publish_export(id, file.clone(), app.jobs.now_ms()).await {
            // The next server makes it again of what is there.
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
        NewExport::Splats(spec) => splats::make(app, &export.record, spec).await,
        NewExport::Mesh(spec) => splats::make_mesh(app, &export.record, spec).await,
    }
}
