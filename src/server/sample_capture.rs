//! The synthetic capture that the server renders for callers without photographs.

use std::convert::Infallible;

use axum::body::Bytes;
use futures::stream;
use tokio::sync::OnceCell;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::problem::Problem;
use crate::store::StagedUpload;
use relume_api::TenantId;
use relume_capture::{SyntheticOptions, synthetic, write_archive};

/// The archive, which is rendered at the first request.
static ARCHIVE: OnceCell<Bytes> = OnceCell::const_new();

/// The bytes of the sample, as if the caller had sent them.
pub(super) async fn receive(app: &AppState, caller: &Caller) -> Result<StagedUpload, Problem> {
    let archive = ARCHIVE.get_or_try_init(|| render(app, &caller.tenant)).await?.clone();
    let name: String = app.jobs.fresh_id();
    let body = stream::iter([Ok::<_, Infallible>(archive)]);
    let received = app.store.receive(&caller.tenant, &name, body, app.limits.capture_bytes).await;
    received.map_err(|error| caller.problem_for(error))
}

async fn render(app: &AppState, tenant: &TenantId) -> Result<Bytes, Problem> {
    let make = || synthetic(&SyntheticOptions::sample()).and_then(|capture| write_archive(&capture));
    app.decoders.run(tenant, make).await?.map(Bytes::from).map_err(Problem::internal)
}
