//! Workers with a process of their own: what they ask of the server, and what whoever runs it sees and says of them.

mod inputs;
mod lease;
mod registry;
mod reports;
mod results;

use utoipa_axum::router::OpenApiRouter;

use crate::server::app::AppState;

/// Small bodies and queries.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    registry::routes().merge(reports::routes())
}

/// Files, which may be large.
pub(super) fn transfers() -> OpenApiRouter<AppState> {
    inputs::routes().merge(results::routes())
}
