//! Whether a tenant already has a capture of the content of an upload.

use crate::server::app::AppState;
use crate::server::metadata;
use crate::server::problem::Problem;
use crate::store::{CaptureRecord, StagedUpload};
use relume_api::metadata::ResourceMetadata;
use relume_api::{ResourceKind, ResourceName, TenantId};

/// The result of [`look_up`].
pub(in crate::server) enum CaptureLookup {
    /// The tenant has a capture of this content; the upload is discarded.
    Existing(Box<CaptureRecord>),
    /// The content is new.
    New(Box<StagedUpload>),
}

/// Looks for a capture of a tenant that has this content or was made of it. Gives it the metadata of the request.
pub(in crate::server) async fn look_up(
    app: &AppState,
    tenant: &TenantId,
    incoming: StagedUpload,
    metadata: &ResourceMetadata,
) -> Result<CaptureLookup, Problem> {
    let Some(mut same) = app.store.capture_of_content(tenant, &incoming.sha256).await? else {
        return Ok(CaptureLookup::New(Box::new(incoming)));
    };
    // This comes before the upload is discarded, so that invalid metadata leave the upload unchanged.
    let what = ResourceName::new(ResourceKind::Capture, same.id.to_string());
    same.metadata = metadata::apply_metadata(app, tenant, what, metadata.clone(), same.metadata).await?;
    if same.sha256 != incoming.sha256 {
        // The capture was made of these photographs.
        app.store.discard_duplicate(incoming).await?;
        return Ok(CaptureLookup::Existing(Box::new(same)));
    }
    Ok(match app.store.repair_artifact(incoming, &same.artifact).await? {
        None => CaptureLookup::Existing(Box::new(same)),
        // The capture was deleted in the meantime.
        Some(given_back) => CaptureLookup::New(Box::new(given_back)),
    })
}

/// The problem of a creation whose content became a capture in the meantime.
pub(super) fn duplicate_capture(same: &CaptureRecord) -> Problem {
    Problem::conflict("stored-before", format!("the capture {:?} has the same content", same.id.as_str()))
}
