//! `/v1/uploads`: resumable uploads (tus 1.0.0).

mod finalise;
mod finding;
mod headers;
mod protocol;
mod receiving;

use axum::extract::{Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Json, middleware};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::deletion;
use crate::server::description::File;
use crate::server::extract::{NoQuery, QueryString, UrlPath, content_length, media_type};
use crate::server::listing::{PageQuery, rfc3339};
use crate::server::problem::Problem;
use crate::server::uploads::finding::{PIECE, find, find_locked};
use crate::store::UploadRecord;
use relume_api::metadata::ResourceMetadata;
use relume_api::uploads::{UploadState, UploadView};
use relume_api::{List, UploadId};

pub(super) use finalise::finalise;
pub(super) use finding::expiry;
pub(super) use protocol::advertise;

/// The routes of this file that accept no chunks.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(describe_protocol, list_uploads))
        .routes(routes!(head_upload, get_upload, delete_upload))
        .layer(middleware::from_fn(protocol::check_version))
}

/// The routes of this file that accept chunks.
pub(super) fn uploads() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(create_upload))
        .routes(routes!(append_to_upload, override_method))
        .layer(middleware::from_fn(protocol::check_version))
}

/// Get the supported tus options
///
/// Returns the headers `Tus-Version`, `Tus-Extension`, `Tus-Max-Size` and `Tus-Checksum-Algorithm`.
#[utoipa::path(
    options, path = "/v1/uploads", tag = "uploads",
    responses((status = 204, description = "Success; see the headers"))
)]
async fn describe_protocol() -> StatusCode {
    StatusCode::NO_CONTENT
}

/// List uploads
///
/// Returns the uploads of the caller's tenant that have not expired and have not become a capture, newest
/// first. Uploads of captures in the states `validating` and `invalid` are included. This operation is not
/// part of tus and does not need the header `Tus-Resumable`.
#[utoipa::path(
    get, path = "/v1/uploads", tag = "uploads", params(PageQuery),
    responses((status = 200, body = List<UploadView>))
)]
async fn list_uploads(
    State(app): State<AppState>,
    caller: Caller,
    QueryString(query): QueryString<PageQuery>,
) -> Result<Json<List<UploadView>>, Problem> {
    let page = query.page(async |id| app.store.upload(&caller.tenant, &id.into()).await).await?;
    let uploads = app.store.uploads(&caller.tenant, app.jobs.now_ms(), &page.store_page()).await?;
    Ok(Json(page.list(uploads, |upload| view(&upload))))
}

/// Create an upload
///
/// Creates a resumable upload according to tus 1.0.0. `Upload-Length` is the size of the whole file.
/// `Upload-Metadata` can contain its file name. The body can contain the first part of the file. The header
/// `Location` of the answer is the URL for further parts.
///
/// When the upload is complete, `POST /v1/captures` with `{"upload": "ID"}` creates a capture. That request
/// sets name, external identifier and labels; this one accepts no query.
#[utoipa::path(
    post, path = "/v1/uploads", tag = "uploads",
    params(
        ("Tus-Resumable" = String, Header, description = "Version of tus, `1.0.0`"),
        ("Upload-Length" = u64, Header, description = "Size of the whole file, bytes"),
        ("Upload-Metadata" = Option<String>, Header, description = "Keys and Base64 values, at most 4096 bytes, e.g. `filename c2Nhbi56aXA=`"),
        ("Upload-Checksum" = Option<String>, Header, description = "Checksum of the body: `sha1` or `sha256`, a space, and the digest in Base64")
    ),
    request_body(content = Option<File>, content_type = "application/offset+octet-stream"),
    responses(
        (status = 201, description = "Created; `Location` is the URL of the upload, `Upload-Offset` the number of stored bytes"),
        (status = 400, body = Problem, description = "Invalid header"),
        (status = 412, body = Problem, description = "Unsupported version of tus"),
        (status = 413, body = Problem, description = "Larger than `Tus-Max-Size`"),
        (status = 422, body = Problem, description = "The request has a query"),
        (status = 429, body = Problem, description = "Too many unfinished uploads"),
        (status = 460, body = Problem, description = "Checksum mismatch; the server created no upload"),
        (status = 507, body = Problem, description = "Not enough disk space for the whole file")
    )
)]
async fn create_upload(
    State(app): State<AppState>,
    caller: Caller,
    _: QueryString<NoQuery>,
    request: Request,
) -> Result<Response, Problem> {
    let length = headers::length(request.headers())?;
    if length > app.limits.capture_bytes {
        return Err(Problem::too_large(app.limits.capture_bytes));
    }
    let metadata = headers::metadata(request.headers())?;
    let brings_piece = media_type(request.headers()).as_deref() == Some(PIECE);
    if !brings_piece && content_length(request.headers()).is_some_and(|n| n > 0) {
        return Err(Problem::unsupported_media_type(PIECE));
    }
    let mut upload = UploadRecord {
        id: app.jobs.fresh_id(),
        tenant: caller.tenant.clone(),
        length: i64::try_from(length).map_err(Problem::internal)?,
        received: 0,
        metadata,
        created_ms: app.jobs.now_ms(),
        expires_ms: expiry(&app),
        capture_id: None,
        capture_metadata: ResourceMetadata::default(),
        sha256: None,
        problem: None,
    };
    app.store
        .begin_upload(&upload, app.upload_limits.each)
        .await
        .map_err(|error| caller.problem_for(error))?;
    if brings_piece {
        upload = receiving::first_piece(&app, &caller, upload, request).await?;
    }
    let location = format!("/v1/uploads/{}", upload.id);
    let mut response = (StatusCode::CREATED, [(header::LOCATION, location)]).into_response();
    headers::write_headers(response.headers_mut(), &upload);
    Ok(response)
}

/// Get the offset of an upload
///
/// Returns the headers `Upload-Offset` and `Upload-Length`. The bytes before the offset are durable on disk.
#[utoipa::path(
    head, path = "/v1/uploads/{id}", tag = "uploads",
    params(
        ("id" = String, Path, description = "Upload identifier"),
        ("Tus-Resumable" = String, Header, description = "Version of tus, `1.0.0`")
    ),
    responses(
        (status = 200, description = "Success; see the headers"), (status = 404, description = "Not found"),
        (status = 410, description = "The upload has expired"),
        (status = 412, description = "Unsupported version of tus")
    )
)]
async fn head_upload(
    app: State<AppState>,
    caller: Caller,
    id: UrlPath<UploadId>,
) -> Result<Response, Problem> {
    get_upload(app, caller, id).await
}

/// Get an upload
///
/// Returns the upload as JSON, with the headers of `HEAD`. This operation is not part of tus and does not
/// need the header `Tus-Resumable`.
#[utoipa::path(
    get, path = "/v1/uploads/{id}", tag = "uploads", params(("id" = String, Path, description = "Upload identifier")),
    responses(
        (status = 200, body = UploadView), (status = 404, body = Problem),
        (status = 410, body = Problem, description = "The upload has expired")
    )
)]
async fn get_upload(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<UploadId>,
) -> Result<Response, Problem> {
    let upload = find(&app, &caller, &id).await?;
    let mut response = Json(view(&upload)).into_response();
    let told = response.headers_mut();
    told.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    told.insert(headers::LENGTH, HeaderValue::from(upload.total()));
    if let Some(metadata) = upload.metadata.as_ref().and_then(|text| HeaderValue::from_str(text).ok()) {
        told.insert(headers::METADATA, metadata);
    }
    headers::write_headers(told, &upload);
    Ok(response)
}

/// Append a part to an upload
///
/// `Upload-Offset` must equal the current offset of the upload. If the connection breaks, the server keeps
/// the received bytes. With `Upload-Checksum` it keeps the part only as a whole.
#[utoipa::path(
    patch, path = "/v1/uploads/{id}", tag = "uploads",
    params(
        ("id" = String, Path, description = "Upload identifier"),
        ("Tus-Resumable" = String, Header, description = "Version of tus, `1.0.0`"),
        ("Upload-Offset" = u64, Header, description = "Offset of the part, bytes"),
        ("Upload-Checksum" = Option<String>, Header, description = "Checksum of the part: `sha1` or `sha256`, a space, and the digest in Base64")
    ),
    request_body(content = File, content_type = "application/offset+octet-stream"),
    responses(
        (status = 204, description = "Stored; `Upload-Offset` is the new offset"),
        (status = 400, body = Problem, description = "Invalid header"),
        (status = 404, body = Problem),
        (status = 409, body = Problem, description = "`Upload-Offset` is not the current offset"),
        (status = 410, body = Problem, description = "The upload has expired"),
        (status = 412, body = Problem, description = "Unsupported version of tus"),
        (status = 413, body = Problem, description = "The part exceeds the size of the upload"),
        (status = 415, body = Problem),
        (status = 423, body = Problem, description = "Another request uses the upload"),
        (status = 460, body = Problem, description = "Checksum mismatch; the server discarded the part"),
        (status = 507, body = Problem, description = "Not enough disk space")
    )
)]
async fn append_to_upload(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<UploadId>,
    request: Request,
) -> Result<Response, Problem> {
    let upload = receiving::piece(&app, &caller, &id, request).await?;
    let mut response = StatusCode::NO_CONTENT.into_response();
    headers::write_headers(response.headers_mut(), &upload);
    Ok(response)
}

/// Append to or delete an upload through POST
///
/// For networks that allow only GET and POST. The header `X-HTTP-Method-Override` selects `PATCH` or
/// `DELETE`. All other headers, the body and the answers are those of the selected method.
#[utoipa::path(
    post, path = "/v1/uploads/{id}", tag = "uploads",
    params(
        ("id" = String, Path, description = "Upload identifier"),
        ("Tus-Resumable" = String, Header, description = "Version of tus, `1.0.0`"),
        ("X-HTTP-Method-Override" = String, Header, description = "`PATCH` or `DELETE`")
    ),
    request_body(content = Option<File>, content_type = "application/offset+octet-stream"),
    responses(
        (status = 204, description = "Success"), (status = 400, body = Problem, description = "Invalid header"),
        (status = 404, body = Problem), (status = 412, body = Problem, description = "Unsupported version of tus")
    )
)]
async fn override_method(
    app: State<AppState>,
    caller: Caller,
    id: UrlPath<UploadId>,
    request: Request,
) -> Result<Response, Problem> {
    match request.headers().get(headers::OVERRIDE).map(HeaderValue::as_bytes) {
        Some(b"PATCH") => append_to_upload(app, caller, id, request).await,
        Some(b"DELETE") => delete_upload(app, caller, id).await.map(IntoResponse::into_response),
        _ => Err(headers::wrong("X-HTTP-Method-Override", "must be PATCH or DELETE")),
    }
}

/// Delete an upload
///
/// Deletes the upload and its stored bytes.
#[utoipa::path(
    delete, path = "/v1/uploads/{id}", tag = "uploads",
    params(
        ("id" = String, Path, description = "Upload identifier"),
        ("Tus-Resumable" = String, Header, description = "Version of tus, `1.0.0`")
    ),
    responses(
        (status = 204, description = "Deleted"), (status = 404, body = Problem),
        (status = 410, body = Problem, description = "The upload has expired"),
        (status = 412, body = Problem, description = "Unsupported version of tus"),
        (status = 423, body = Problem, description = "Another request uses the upload")
    )
)]
async fn delete_upload(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<UploadId>,
) -> Result<StatusCode, Problem> {
    let upload = find(&app, &caller, &id).await?;
    // An upload whose poses are being found is deleted as a capture.
    if let Some(capture) = upload.capture_id.filter(|capture| app.poses.progress(capture).is_some()) {
        return deletion::delete_unfinished_capture(&app, &caller, capture).await;
    }
    let (lock, _) = find_locked(&app, &caller, &id).await?;
    app.store.drop_upload(&lock).await?;
    Ok(StatusCode::NO_CONTENT)
}

fn state(upload: &UploadRecord) -> UploadState {
    match (&upload.capture_id, &upload.problem) {
        (Some(_), None) => UploadState::Validating,
        (_, Some(_)) => UploadState::Invalid,
        (None, None) if upload.offset() < upload.total() => UploadState::Receiving,
        (None, None) => UploadState::Complete,
    }
}

fn view(upload: &UploadRecord) -> UploadView {
    UploadView {
        id: upload.id.clone(),
        filename: upload.metadata.as_deref().and_then(headers::filename),
        length: upload.total(),
        offset: upload.offset(),
        created_at: rfc3339(upload.created_ms),
        expires_at: rfc3339(upload.expires_ms),
        state: state(upload),
        capture: upload.capture_id.clone(),
    }
}
