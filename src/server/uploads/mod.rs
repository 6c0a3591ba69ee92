//! `/v1/uploads`: uploads that arrive in pieces and go on where they broke off (tus 1.0.0).

mod finding;
mod headers;
mod protocol;
mod receiving;
mod taking;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware;
use axum::response::{IntoResponse, Response};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::marks::Marks;
use crate::api::uploads::{UploadState, UploadView};
use crate::api::{List, Problem, UploadId};
use crate::server::app::Shared;
use crate::server::caller::Caller;
use crate::server::deletion;
use crate::server::description::File;
use crate::server::extract::{NoQuery, QueryString, UrlPath, content_length, media_type};
use crate::server::listing::{PageQuery, rfc3339};
use crate::server::uploads::finding::{PIECE, find, held};
use crate::store::UploadRecord;

pub(super) use finding::expiry;
pub(super) use protocol::advertise;
pub(super) use taking::take;

/// The routes of this file that take no pieces.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(describe_protocol, list_uploads))
        .routes(routes!(head_upload, get_upload, delete_upload))
        .layer(middleware::from_fn(protocol::speak))
}

/// The routes of this file that take pieces.
pub(super) fn uploads() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(create_upload))
        .routes(routes!(append_to_upload, override_method))
        .layer(middleware::from_fn(protocol::speak))
}

/// Ask what of tus is spoken
///
/// In the headers `Tus-Version`, `Tus-Extension`, `Tus-Max-Size` and `Tus-Checksum-Algorithm`.
#[utoipa::path(
    options, path = "/v1/uploads", tag = "uploads",
    responses((status = 204, description = "The headers say it"))
)]
async fn describe_protocol() -> StatusCode {
    StatusCode::NO_CONTENT
}

/// List uploads
///
/// Those that no capture was made of and that have not expired, also those of captures that are being validated or were found
/// invalid. This is not part of tus: no version need be named.
#[utoipa::path(
    get, path = "/v1/uploads", tag = "uploads", params(PageQuery),
    responses((status = 200, body = List<UploadView>))
)]
async fn list_uploads(
    State(app): State<Shared>,
    caller: Caller,
    QueryString(query): QueryString<PageQuery>,
) -> Result<Json<List<UploadView>>, Problem> {
    let page = query.page(async |id| app.store.upload(&caller.tenant, &id.into()).await).await?;
    let uploads = app.store.uploads(&caller.tenant, app.jobs.now_ms(), &page.of_store()).await?;
    Ok(Json(page.list(uploads, |upload| view(&upload))))
}

/// Begin an upload
///
/// As tus 1.0.0 says, without a query: `Upload-Length` is the length of the whole file, `Upload-Metadata` may name it. The answer's `Location` is where
/// its pieces go. The first piece may come as the body. When it is complete, `POST /v1/captures` with `{"upload": "ID"}` makes a
/// capture of it; what that is called is said there.
#[utoipa::path(
    post, path = "/v1/uploads", tag = "uploads",
    params(
        ("Tus-Resumable" = String, Header, description = "1.0.0"),
        ("Upload-Length" = u64, Header, description = "Bytes of the whole file"),
        ("Upload-Metadata" = Option<String>, Header, description = "Keys and Base64 values, e.g. `filename c2Nhbi56aXA=`"),
        ("Upload-Checksum" = Option<String>, Header, description = "Of the body: `sha1` or `sha256`, a space, Base64")
    ),
    request_body(content = Option<File>, content_type = "application/offset+octet-stream"),
    responses(
        (status = 201, description = "`Location` says where; `Upload-Offset` how much of it is there"),
        (status = 400, body = Problem, description = "A header is wrong"),
        (status = 412, body = Problem, description = "Another version of tus"),
        (status = 413, body = Problem, description = "Longer than Tus-Max-Size"),
        (status = 422, body = Problem, description = "There is a query"),
        (status = 429, body = Problem, description = "Too many unfinished uploads"),
        (status = 460, body = Problem, description = "The checksum is not that of the body; nothing was begun"),
        (status = 507, body = Problem, description = "There is no room for all of it")
    )
)]
async fn create_upload(
    State(app): State<Shared>,
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
        marks: Marks::default(),
        sha256: None,
        problem: None,
    };
    app.store.begin_upload(&upload, app.upload_limits.each).await.map_err(|error| caller.told(error))?;
    if brings_piece {
        upload = receiving::first_piece(&app, &caller, upload, request).await?;
    }
    let location = format!("/v1/uploads/{}", upload.id);
    let mut response = (StatusCode::CREATED, [(header::LOCATION, location)]).into_response();
    headers::tell(response.headers_mut(), &upload);
    Ok(response)
}

/// Ask how much of an upload is there
///
/// In the headers `Upload-Offset` and `Upload-Length`. What is counted is on disk and survives the server's death.
#[utoipa::path(
    head, path = "/v1/uploads/{id}", tag = "uploads",
    params(("id" = String, Path), ("Tus-Resumable" = String, Header, description = "1.0.0")),
    responses(
        (status = 200, description = "The headers say it"), (status = 404, description = "There is none"),
        (status = 410, description = "It has expired"), (status = 412, description = "Another version of tus")
    )
)]
async fn head_upload(app: State<Shared>, caller: Caller, id: UrlPath<UploadId>) -> Result<Response, Problem> {
    get_upload(app, caller, id).await
}

/// Get an upload
///
/// What `HEAD` says, as JSON too. This is not part of tus: no version need be named.
#[utoipa::path(
    get, path = "/v1/uploads/{id}", tag = "uploads", params(("id" = String, Path)),
    responses(
        (status = 200, body = UploadView), (status = 404, body = Problem),
        (status = 410, body = Problem, description = "It has expired")
    )
)]
async fn get_upload(
    State(app): State<Shared>,
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
    headers::tell(told, &upload);
    Ok(response)
}

/// Send a piece of an upload
///
/// It begins at `Upload-Offset`, which must be where the upload is. When the connection breaks, what arrived is kept; with
/// `Upload-Checksum` the piece is kept whole or not at all.
#[utoipa::path(
    patch, path = "/v1/uploads/{id}", tag = "uploads",
    params(
        ("id" = String, Path),
        ("Tus-Resumable" = String, Header, description = "1.0.0"),
        ("Upload-Offset" = u64, Header, description = "Where the piece begins"),
        ("Upload-Checksum" = Option<String>, Header, description = "Of the piece: `sha1` or `sha256`, a space, Base64")
    ),
    request_body(content = File, content_type = "application/offset+octet-stream"),
    responses(
        (status = 204, description = "Stored; `Upload-Offset` says how much is there now"),
        (status = 400, body = Problem, description = "A header is wrong"),
        (status = 404, body = Problem),
        (status = 409, body = Problem, description = "The upload is somewhere else"),
        (status = 410, body = Problem, description = "It has expired"),
        (status = 412, body = Problem, description = "Another version of tus"),
        (status = 413, body = Problem, description = "The piece goes past the upload's length"),
        (status = 415, body = Problem),
        (status = 423, body = Problem, description = "Another request works on it"),
        (status = 460, body = Problem, description = "The checksum is not that of the piece; nothing of it was kept"),
        (status = 507, body = Problem, description = "There is no room")
    )
)]
async fn append_to_upload(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<UploadId>,
    request: Request,
) -> Result<Response, Problem> {
    let upload = receiving::piece(&app, &caller, &id, request).await?;
    let mut response = StatusCode::NO_CONTENT.into_response();
    headers::tell(response.headers_mut(), &upload);
    Ok(response)
}

/// Send a piece of an upload, or delete it, where only GET and POST pass
///
/// `X-HTTP-Method-Override` says `PATCH` or `DELETE`; all else is as there.
#[utoipa::path(
    post, path = "/v1/uploads/{id}", tag = "uploads",
    params(
        ("id" = String, Path),
        ("Tus-Resumable" = String, Header, description = "1.0.0"),
        ("X-HTTP-Method-Override" = String, Header, description = "`PATCH` or `DELETE`")
    ),
    request_body(content = Option<File>, content_type = "application/offset+octet-stream"),
    responses(
        (status = 204, description = "Done"), (status = 400, body = Problem, description = "A header is wrong"),
        (status = 404, body = Problem), (status = 412, body = Problem, description = "Another version of tus")
    )
)]
async fn override_method(
    app: State<Shared>,
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

/// Give an upload up
///
/// With what has arrived of it.
#[utoipa::path(
    delete, path = "/v1/uploads/{id}", tag = "uploads",
    params(("id" = String, Path), ("Tus-Resumable" = String, Header, description = "1.0.0")),
    responses(
        (status = 204, description = "Given up"), (status = 404, body = Problem),
        (status = 410, body = Problem, description = "It has expired"),
        (status = 412, body = Problem, description = "Another version of tus"),
        (status = 423, body = Problem, description = "Another request works on it")
    )
)]
async fn delete_upload(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<UploadId>,
) -> Result<StatusCode, Problem> {
    let upload = find(&app, &caller, &id).await?;
    // Whose poses are being found is deleted as a capture is.
    if let Some(capture) = upload.capture_id.filter(|capture| app.poses.progress(capture).is_some()) {
        return deletion::delete_unmade(&app, &caller, capture).await;
    }
    let (hold, _) = held(&app, &caller, &id).await?;
    app.store.drop_upload(&hold).await?;
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
