//! The model of an export.

use crate::server::app::AppState;
use crate::server::models;
use crate::server::problem::Problem;
use crate::store::ExportRecord;
use crate::worker::{MaterialChange, ModelSource};
use relume_spec::rendering::MaterialEdit;

/// The model of an export with the changes of its materials, and the content hash of its file.
///
/// # Errors
/// 404 if the model was deleted.
pub(super) async fn source(
    app: &AppState,
    export: &ExportRecord,
    materials: &[MaterialEdit],
) -> Result<(ModelSource, String), Problem> {
    let (source, sha256) = models::source(app, &export.tenant, &export.model_id).await?;
    Ok((ModelSource { materials: MaterialChange::Edits(materials.to_vec()), ..source }, sha256))
}
