//! `/v1/usage`: how much is stored.

use axum::Json;
use axum::extract::State;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::Problem;
use crate::api::usage::Usage;
use crate::server::app::Shared;
use crate::server::caller::Caller;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_usage))
}

/// Count what is stored
///
/// Things of the caller's tenant; what there is in all is shown to whoever runs the server alone.
#[utoipa::path(get, path = "/v1/usage", tag = "operations", responses((status = 200, body = Usage)))]
async fn get_usage(State(app): State<Shared>, caller: Caller) -> Result<Json<Usage>, Problem> {
    Ok(Json(app.store.usage(&caller.tenant, caller.is_operator()).await?))
}
