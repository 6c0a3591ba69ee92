//! The light of an export.

use crate::server::app::AppState;
use crate::server::lights;
use crate::server::problem::Problem;
use crate::worker::LightSource;
use relume_api::TenantId;
use relume_api::renders::EnvironmentSpec;

/// The light of an export. Maps in the request are refused, because they would have to be stored until the export is made.
///
/// # Errors
/// 422, which names the field.
pub(super) async fn light(
    app: &AppState,
    tenant: &TenantId,
    spec: &EnvironmentSpec,
) -> Result<LightSource, Problem> {
    if spec.inline_base64.is_some() {
        let detail = "is not accepted by exports; upload the map to /v1/environments and use its id";
        return Err(Problem::invalid_field("/environment/inline_base64", detail));
    }
    lights::light(app, tenant, spec).await
}
