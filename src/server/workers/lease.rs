//! The lease in requests of workers.

use axum::extract::{FromRequestParts, Path};
use axum::http::request::Parts;
use serde::Deserialize;

use crate::jobs::Lease;
use crate::server::app::AppState;
use crate::server::problem::Problem;
use crate::store::{LeaseStatus, StoreError};
use relume_api::JobId;
use relume_api::work::LeaseView;

/// The header with the lease token.
pub(super) const LEASE: &str = "relume-lease";

/// The lease of the job in the path. Handlers with this argument are not called if the lease is lost.
pub(super) struct Held(pub(super) Lease);

#[derive(Deserialize)]
struct JobPath {
    job: JobId,
}

impl FromRequestParts<AppState> for Held {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, app: &AppState) -> Result<Self, Problem> {
        let path = Path::<JobPath>::from_request_parts(parts, app).await;
        let Path(JobPath { job }) = path.map_err(Problem::internal)?;
        let token = parts.headers.get(LEASE).and_then(|value| value.to_str().ok());
        let token = token.ok_or_else(|| Problem::invalid_field("header/Relume-Lease", "is missing"))?;
        app.jobs.lease(&job, token).await?.map(Self).ok_or_else(lost)
    }
}

/// 409 for a worker whose job was given to another worker, was cancelled or has ended.
fn lost() -> Problem {
    Problem::conflict("lease-lost", "the worker no longer holds the job: stop, and publish nothing")
}

/// The answer to a request of a worker; 409 if the lease was lost in the meantime.
pub(super) fn lease_view(status: Result<LeaseStatus, StoreError>) -> Result<LeaseView, Problem> {
    match status? {
        LeaseStatus::Lost => Err(lost()),
        status => Ok(LeaseView { status, should_yield: false }),
    }
}
