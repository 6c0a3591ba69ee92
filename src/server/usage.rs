//! `/v1/usage`: storage use.

use axum::Json;
use axum::extract::State;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::problem::Problem;
use relume_api::usage::Usage;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(get_usage))
}

/// Get the storage use
///
/// Returns number and size of the resources of the caller's tenant. Only administrators of the tenant
/// `default` also get the figures of the whole server.
#[utoipa::path(get, path = "/v1/usage", tag = "operations", responses((status = 200, body = Usage)))]
async fn get_usage(State(app): State<AppState>, caller: Caller) -> Result<Json<Usage>, Problem> {
    Ok(Json(app.store.usage(&caller.tenant, caller.is_operator()).await?))
}
