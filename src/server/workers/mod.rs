//! Workers: the protocol of remote workers, and the worker registry for the operator.

mod inputs;
mod lease;
mod registry;
mod reports;
mod results;

use utoipa_axum::router::OpenApiRouter;

use crate::server::app::AppState;

/// Routes with small bodies and queries.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    registry::routes().merge(reports::routes())
}

/// Routes with files, which may be large.
pub(super) fn transfers() -> OpenApiRouter<AppState> {
    inputs::routes().merge(results::routes())
}
