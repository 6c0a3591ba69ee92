//! Bodies that are files, raw or in one field of a multipart form. They are streamed to disk and hashed.

use std::error::Error;

use axum::body::Bytes;
use axum::extract::multipart::MultipartError;
use axum::extract::{FromRequest, Multipart, Request};
use futures::{Stream, TryStreamExt};

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::extract::{STALLED, content_length, is_too_slow, media_type};
use crate::server::file_form;
use crate::server::problem::Problem;
use crate::store::StagedUpload;

/// The body that a route accepts.
pub(super) struct AcceptedBody {
    /// Name of the multipart field.
    pub(super) field: &'static str,
    /// Media types of a raw body.
    pub(super) media_types: &'static [&'static str],
    /// Whether a form may contain single files instead.
    pub(super) takes_files: bool,
    /// Maximum bytes.
    pub(super) limit: u64,
}

/// Maximum bytes by which a declared length may exceed the file, for multipart boundaries and headers.
const FORM_OVERHEAD: u64 = 65_536;

/// Receives the file of a request. After an error nothing of it is left on disk.
pub(super) async fn receive(
    app: &AppState,
    caller: &Caller,
    request: Request,
    expected: &AcceptedBody,
) -> Result<StagedUpload, Problem> {
    let declared = content_length(request.headers());
    if declared.is_some_and(|n| n > expected.limit + FORM_OVERHEAD) {
        return Err(Problem::too_large(expected.limit));
    }
    // A body that is known to be too large is refused before its transfer.
    let least = declared.unwrap_or(0).saturating_sub(FORM_OVERHEAD);
    app.store.admit_bytes_of(&caller.tenant, least).await?;
    app.store.admit_bytes(least).await.map_err(|error| caller.problem_for(error))?;
    match media_type(request.headers()).as_deref() {
        Some("multipart/form-data") => from_form(app, caller, request, expected).await,
        Some(raw) if expected.media_types.contains(&raw) => {
            let body = request.into_body().into_data_stream();
            store(app, caller, body, axum::Error::to_string, expected.limit).await
        }
        _ => {
            let types = expected.media_types.join(", ");
            Err(Problem::unsupported_media_type(&format!("multipart/form-data or one of {types}")))
        }
    }
}

async fn from_form(
    app: &AppState,
    caller: &Caller,
    request: Request,
    expected: &AcceptedBody,
) -> Result<StagedUpload, Problem> {
    let form = Multipart::from_request(request, app).await;
    let mut form = form.map_err(|e| Problem::malformed_form(e.body_text()))?;
    let mut file = None;
    while let Some(field) = form.next_field().await.map_err(|e| match is_too_slow(&e) {
        true => Problem::timeout(STALLED),
        false => Problem::malformed_form(e.body_text()),
    })? {
        let name = field.name().unwrap_or_default().to_owned();
        if name == file_form::FIELD && expected.takes_files && file.is_none() {
            let first = file_form::first(app, caller, field).await?;
            return file_form::receive(app, caller, first, form, expected.limit).await;
        }
        if name != expected.field || file.is_some() {
            let detail = format!("is not allowed; the form has exactly one field, {:?}", expected.field);
            return Err(Problem::invalid_field(format!("/{name}"), detail));
        }
        file = Some(store(app, caller, field, MultipartError::body_text, expected.limit).await?);
    }
    let missing = || Problem::invalid_field(format!("/{}", expected.field), "is missing in the form");
    file.ok_or_else(missing)
}

/// Streams a file to disk.
async fn store<E: Error + 'static>(
    app: &AppState,
    caller: &Caller,
    body: impl Stream<Item = Result<Bytes, E>>,
    reason: impl Fn(&E) -> String,
    limit: u64,
) -> Result<StagedUpload, Problem> {
    let mut stalled = false;
    let body = body.map_err(|error| {
        stalled = is_too_slow(&error);
        reason(&error)
    });
    let name: String = app.jobs.fresh_id();
    let received = app.store.receive(&caller.tenant, &name, body, limit).await;
    match received {
        Err(_) if stalled => Err(Problem::timeout(STALLED)),
        received => received.map_err(|error| caller.problem_for(error)),
    }
}
