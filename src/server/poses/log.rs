//! `/v1/captures/{id}/log`: the output of COLMAP.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::folder::{self, LOG};
use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::extract::{NoQuery, QueryString, UrlPath};
use crate::server::problem::Problem;
use relume_api::CaptureId;
use relume_capture::CaptureFiles;

/// Maximum bytes of a log that are kept and sent, from its end.
const LONGEST: u64 = 1 << 20;

/// The routes of this file.
pub(in crate::server) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(get_log))
}

/// Get the pose estimation log of a capture
///
/// Returns the output of COLMAP from the estimation of the camera poses, at most the last MiB. The log is
/// available while COLMAP works, after a failure, and for the resulting capture. The log of a capture that
/// was uploaded with poses is empty.
#[utoipa::path(
    get, path = "/v1/captures/{id}/log", tag = "captures",
    params(("id" = String, Path, description = "Capture identifier")),
    responses(
        (status = 200, content_type = "text/plain", body = String),
        (status = 404, body = Problem, description = "The capture does not exist")
    )
)]
async fn get_log(
    State(app): State<AppState>,
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
            let read = move || CaptureFiles::open(&path, &limits)?.read(LOG);
            let bytes = app.decoders.run(&caller.tenant, read).await?.map_err(Problem::internal)?;
            String::from_utf8_lossy(&bytes).into_owned()
        }
        None => {
            app.store.upload_of_capture(&caller.tenant, &id).await?.ok_or_else(missing)?;
            let folder = folder::of(&app.store, &id);
            let read = tokio::task::spawn_blocking(move || log_tail(&folder)).await;
            // The log does not exist before COLMAP starts.
            read.map_err(Problem::internal)?.unwrap_or_default()
        }
    };
    let kind =
        [(header::CONTENT_TYPE, "text/plain; charset=utf-8"), (header::CACHE_CONTROL, "private, no-cache")];
    Ok((kind, text).into_response())
}

/// The end of the log in a folder, without the path of that folder, which clients must not see.
pub(super) fn log_tail(folder: &Path) -> io::Result<String> {
    let mut file = File::open(folder.join(LOG))?;
    let length = file.metadata()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(LONGEST)))?;
    let mut bytes = Vec::new();
    file.take(LONGEST).read_to_end(&mut bytes)?;
    Ok(redact_folder(&String::from_utf8_lossy(&bytes), folder))
}

/// A text without the path of a folder of the server.
pub(super) fn redact_folder(text: &str, folder: &Path) -> String {
    let whole = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let names = [whole, folder.to_owned()].map(|path| path.display().to_string());
    names
        .iter()
        .filter(|name| !name.is_empty())
        .fold(text.to_owned(), |text, name| text.replace(name.as_str(), "."))
}
