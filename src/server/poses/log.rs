//! `/v1/captures/{id}/log`: what COLMAP said.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::folder::{self, LOG};
use crate::api::{CaptureId, Problem};
use crate::capture::Source;
use crate::server::app::Shared;
use crate::server::caller::Caller;
use crate::server::extract::{NoQuery, QueryString, UrlPath};

/// Most bytes of a log that are kept and sent: its end.
const LONGEST: u64 = 1 << 20;

/// The routes of this file.
pub(in crate::server) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_log))
}

/// Read the log of a capture
///
/// What COLMAP said while it found the poses of the photographs, or their end where that is more than a MiB: while it works, after it
/// failed, and of the capture that was made. That of a capture that came with poses is empty.
#[utoipa::path(
    get, path = "/v1/captures/{id}/log", tag = "captures", params(("id" = String, Path)),
    responses(
        (status = 200, content_type = "text/plain", body = String),
        (status = 404, body = Problem, description = "There is no such capture")
    )
)]
async fn get_log(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<CaptureId>,
    _: QueryString<NoQuery>,
) -> Result<Response, Problem> {
    let missing = || Problem::not_found("capture", id.as_str());
    let text = match app.store.capture(&caller.tenant, &id).await? {
        Some(capture) if capture.made_of.is_none() => String::new(),
        Some(capture) => {
            app.store.artifacts().verify(&capture.artifact, &capture.sha256).await?;
            let path = app.store.artifacts().local_path(&capture.artifact);
            let limits = app.import_limits;
            let read = move || Source::open(&path, &limits)?.read(LOG);
            let bytes = app.decoders.run(read).await?.map_err(Problem::internal)?;
            String::from_utf8_lossy(&bytes).into_owned()
        }
        None => {
            app.store.upload_for(&caller.tenant, &id).await?.ok_or_else(missing)?;
            let folder = folder::of(&app.store, &id);
            let read = tokio::task::spawn_blocking(move || end_of_log(&folder)).await;
            // It is not there before COLMAP begins.
            read.map_err(Problem::internal)?.unwrap_or_default()
        }
    };
    let kind =
        [(header::CONTENT_TYPE, "text/plain; charset=utf-8"), (header::CACHE_CONTROL, "private, no-cache")];
    Ok((kind, text).into_response())
}

/// The end of the log in a folder, without the name of that folder: where the server keeps things is its own affair.
pub(super) fn end_of_log(folder: &Path) -> io::Result<String> {
    let mut file = File::open(folder.join(LOG))?;
    let length = file.metadata()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(LONGEST)))?;
    let mut bytes = Vec::new();
    file.take(LONGEST).read_to_end(&mut bytes)?;
    Ok(without(&String::from_utf8_lossy(&bytes), folder))
}

/// A text without the name of a folder of the server.
pub(super) fn without(text: &str, folder: &Path) -> String {
    let whole = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let names = [whole, folder.to_owned()].map(|path| path.display().to_string());
    names
        .iter()
        .filter(|name| !name.is_empty())
        .fold(text.to_owned(), |text, name| text.replace(name.as_str(), "."))
}
