//! Validates an upload and publishes it as a capture.

use crate::server::app::AppState;
use crate::server::capture_creation::validate;
use crate::server::metadata;
use crate::server::poses::{self, PoseJob};
use crate::server::problem::Problem;
use crate::store::{CaptureRecord, StagedUpload};
use relume_api::metadata::ResourceMetadata;
use relume_api::{CaptureId, TenantId};

/// Creates the capture `id` of a tenant with these metadata, or returns the tenant's existing capture of the same content.
pub(in crate::server) async fn create(
    app: &AppState,
    tenant: &TenantId,
    id: CaptureId,
    incoming: StagedUpload,
    metadata: ResourceMetadata,
) -> Result<CaptureRecord, Problem> {
    publish(app, tenant, id, incoming, metadata, None).await
}

/// Creates the capture `id` of a tenant from photographs without poses.
pub(super) async fn create_with_poses(
    app: &AppState,
    tenant: &TenantId,
    id: CaptureId,
    photographs: StagedUpload,
    pose_job: PoseJob,
) -> Result<CaptureRecord, Problem> {
    let made_of = photographs.sha256.clone();
    let posed = poses::find(app, tenant, &id, photographs, pose_job).await?;
    publish(app, tenant, id, posed, ResourceMetadata::default(), Some(made_of)).await
}

async fn publish(
    app: &AppState,
    tenant: &TenantId,
    id: CaptureId,
    incoming: StagedUpload,
    metadata: ResourceMetadata,
    made_of: Option<String>,
) -> Result<CaptureRecord, Problem> {
    let report = validate(app, tenant, &incoming).await?;
    let record = CaptureRecord {
        id,
        sha256: incoming.sha256.clone(),
        bytes: i64::try_from(incoming.bytes).unwrap_or(i64::MAX),
        artifact: format!("captures/{}", incoming.sha256),
        metadata,
        report,
        created_ms: app.jobs.now_ms(),
        made_of,
    };
    app.store.publish_capture(incoming, tenant, &record).await.map_err(metadata::refused)
}
