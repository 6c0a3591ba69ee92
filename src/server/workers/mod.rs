//! Workers with a process of their own: what they ask of the server, and what whoever runs it sees and says of them.

mod inputs;
mod lease;
mod reports;
mod results;
mod roll;

use utoipa_axum::router::OpenApiRouter;

use crate::server::app::Shared;

/// Small bodies and queries.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    roll::routes().merge(reports::routes())
}

/// Files, which may be large.
pub(super) fn transfers() -> OpenApiRouter<Shared> {
    inputs::routes().merge(results::routes())
}
