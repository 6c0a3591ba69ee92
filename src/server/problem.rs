//! Problems: their constructors and their HTTP responses.

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

use crate::server::telemetry;
use crate::store::StoreError;
use crate::worker::RenderFailure;
use relume_api::problem::{ContentError, FieldError, TYPE_PREFIX};
use relume_api::{ResourceKind, ResourceName};

/// A problem that a handler returns: the wire type with constructors for each kind, and its response.
#[derive(Debug, Clone, PartialEq)]
pub struct Problem(relume_api::Problem);

impl std::ops::DerefMut for Problem {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.0
    }
}

impl std::ops::Deref for Problem {
    type Target = relume_api::Problem;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl From<relume_api::Problem> for Problem {
    fn from(problem: relume_api::Problem) -> Self {
        Self(problem)
    }
}

impl From<Problem> for relume_api::Problem {
    fn from(problem: Problem) -> Self {
        problem.0
    }
}

/// The schema of the wire type.
impl utoipa::PartialSchema for Problem {
    fn schema() -> utoipa::openapi::RefOr<utoipa::openapi::schema::Schema> {
        relume_api::Problem::schema()
    }
}

impl utoipa::ToSchema for Problem {
    fn name() -> std::borrow::Cow<'static, str> {
        relume_api::Problem::name()
    }

    fn schemas(schemas: &mut Vec<(String, utoipa::openapi::RefOr<utoipa::openapi::schema::Schema>)>) {
        relume_api::Problem::schemas(schemas);
    }
}

/// Longest text of a problem, bytes. Texts can repeat what a file contains.
const MAX_TEXT: usize = 16 << 10;

/// A text that every database can store: of at most [`MAX_TEXT`] bytes, and without control characters except line breaks.
fn storable(text: &str) -> String {
    let end = text.floor_char_boundary(MAX_TEXT);
    let is_bad = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
    let kept: String = text[..end].chars().map(|c| if is_bad(c) { '\u{fffd}' } else { c }).collect();
    if end < text.len() { format!("{kept}... ({} more bytes)", text.len() - end) } else { kept }
}

impl Problem {
    /// A problem with a stable kind.
    pub fn new(status: StatusCode, kind: &str, title: &str) -> Self {
        Self(relume_api::Problem {
            kind: format!("{TYPE_PREFIX}{kind}"),
            title: title.to_owned(),
            status: status.as_u16(),
            detail: None,
            request_id: telemetry::request_id(),
            errors: Vec::new(),
            content: None,
            needed_by: Vec::new(),
            retry_after: None,
        })
    }

    /// A form that cannot be parsed.
    pub(super) fn malformed_form(reason: String) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "malformed-form", "The multipart form cannot be read")
            .detail(reason)
    }

    /// Sets the description of this occurrence.
    #[must_use]
    pub fn detail(mut self, detail: impl Into<String>) -> Self {
        self.0.detail = Some(storable(&detail.into()));
        self
    }

    /// Sets the time after which the client may retry, seconds.
    #[must_use]
    pub fn retry_after(mut self, seconds: u32) -> Self {
        self.0.retry_after = Some(seconds);
        self
    }

    /// 401.
    pub fn unauthorized() -> Self {
        Self::new(StatusCode::UNAUTHORIZED, "unauthorized", "An API key is required")
            .detail("send Authorization: Bearer <key>, with a key that is neither revoked nor expired")
    }

    /// 404.
    pub fn not_found(what: &str, id: &str) -> Self {
        Self::new(StatusCode::NOT_FOUND, "not-found", "The resource does not exist")
            .detail(format!("{what} {id:?} does not exist"))
    }

    /// 422, which names a field.
    pub fn invalid_field(pointer: impl Into<String>, detail: impl Into<String>) -> Self {
        let (pointer, detail) = (pointer.into(), detail.into());
        let mut problem = Self::new(StatusCode::UNPROCESSABLE_ENTITY, "invalid-field", "A field is invalid")
            .detail(format!("{pointer}: {detail}"));
        problem.0.errors.push(FieldError { pointer, detail });
        problem
    }

    /// 422 for an uploaded file with invalid content.
    pub fn invalid_content(content: ContentError, detail: impl Into<String>) -> Self {
        let status = StatusCode::UNPROCESSABLE_ENTITY;
        let mut problem = Self::new(status, "invalid-content", "The uploaded file is invalid");
        let ContentError { code, file, field } = content;
        let [file, field] = [file, field].map(|text| text.as_deref().map(storable));
        problem.0.content = Some(ContentError { code, file, field });
        problem.detail(detail)
    }

    /// 413.
    pub fn too_large(limit: u64) -> Self {
        Self::new(StatusCode::PAYLOAD_TOO_LARGE, "too-large", "The body is too large")
            .detail(format!("at most {limit} bytes are accepted"))
    }

    /// 408.
    pub fn timeout(detail: &str) -> Self {
        Self::new(StatusCode::REQUEST_TIMEOUT, "timeout", "The request took too long").detail(detail)
    }

    /// 403.
    pub fn forbidden(kind: &str, detail: impl Into<String>) -> Self {
        Self::new(StatusCode::FORBIDDEN, kind, "The request may come from a foreign web page").detail(detail)
    }

    /// 415.
    pub fn unsupported_media_type(expected: &str) -> Self {
        Self::new(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            "unsupported-media-type",
            "The content type is not supported",
        )
        .detail(format!("expected {expected}"))
    }

    /// 409.
    pub fn conflict(kind: &str, detail: impl Into<String>) -> Self {
        Self::new(StatusCode::CONFLICT, kind, "The state of the resource does not allow the request")
            .detail(detail)
    }

    /// 409 for a resource that cannot be deleted because others need it.
    pub fn in_use(what: &ResourceName, mut needed_by: Vec<ResourceName>) -> Self {
        let count = needed_by.len();
        needed_by.truncate(100);
        let detail = match needed_by.as_slice() {
            [it] if it == what => format!("{what} is running; cancel it first, or use ?cascade=true"),
            _ => format!(
                "{what} is needed by {count} queued, running or retryable jobs; delete them first, or use ?cascade=true"
            ),
        };
        let mut problem = Self::conflict("in-use", detail);
        problem.0.needed_by = needed_by;
        problem
    }

    /// 500. The cause is logged and not sent to the client.
    pub fn internal(cause: impl std::fmt::Display) -> Self {
        tracing::error!(%cause, "internal error");
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "internal", "The server failed")
            .detail("the cause is in the server's log under this request_id")
    }

    /// 500 for a disk failure. The cause is logged and not sent to the client.
    pub fn storage_failed(cause: impl std::fmt::Display) -> Self {
        tracing::error!(%cause, "a file operation failed");
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "storage-failed", "The storage failed")
            .detail("the cause is in the server's log under this request_id; retry after it is fixed")
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let body = serde_json::to_vec(&self.0).unwrap_or_default();
        let mut response = (status, body).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
        if let Some(seconds) = self.retry_after {
            headers.insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        if status == StatusCode::UNAUTHORIZED {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        response
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::Full | StoreError::NoDiskSpace { .. } => {
                Self::new(StatusCode::INSUFFICIENT_STORAGE, "insufficient-storage", "The disk is full")
                    .detail("the server stored nothing")
                    .retry_after(60)
            }
            StoreError::JobQuotaExceeded { .. }
            | StoreError::UploadQuotaExceeded { .. }
            | StoreError::ExportQuotaExceeded { .. } => {
                let title = "The quota of the tenant is exhausted";
                Self::new(StatusCode::TOO_MANY_REQUESTS, "quota-exceeded", title)
                    .detail(error.to_string())
                    .retry_after(60)
            }
            StoreError::ByteQuotaExceeded { .. } => {
                let title = "The quota of the tenant is exhausted";
                Self::new(StatusCode::INSUFFICIENT_STORAGE, "quota-exceeded", title).detail(error.to_string())
            }
            StoreError::InvalidMetadata { field, why } => Self::invalid_field(format!("/{field}"), why),
            StoreError::TooManyWebhooks { .. } => Self::conflict("quota-exceeded", error.to_string()),
            StoreError::StorageLimitExceeded { .. } => {
                Self::new(StatusCode::INSUFFICIENT_STORAGE, "storage-limit", "The storage limit of the server is reached")
                    .detail("all tenants together have reached the storage limit; the server stored nothing of this request")
            }
            StoreError::TooLarge { limit } => Self::too_large(limit),
            StoreError::Body(reason) => {
                Self::new(StatusCode::BAD_REQUEST, "incomplete-body", "The body could not be read")
                    .detail(reason)
            }
            StoreError::Deleted(what) => match what.kind {
                ResourceKind::Capture => {
                    Self::invalid_field("/capture", format!("{:?} does not exist", what.id))
                }
                ResourceKind::Environment => Self::invalid_field(
                    "/overrides/light/environment",
                    format!("{:?} does not exist", what.id),
                ),
                kind => Self::not_found(kind.name(), &what.id),
            },
            StoreError::KeyRevoked => Self::unauthorized(),
            StoreError::IdempotencyKeyReused => Self::new(
                StatusCode::UNPROCESSABLE_ENTITY,
                "idempotency-key-reused",
                "The idempotency key was used for another request",
            )
            .detail("use a new Idempotency-Key for a different body"),
            StoreError::Damaged(_) | StoreError::Missing(_) => {
                tracing::error!(%error, "a stored file is damaged or missing");
                Self::new(
                    StatusCode::INTERNAL_SERVER_ERROR,
                    "artifact-damaged",
                    "A stored file is damaged or missing",
                )
                .detail(
                    "its bytes differ from the stored hash; `relume doctor` on the server names the file",
                )
            }
            StoreError::DatabaseUnreachable(_) => {
                tracing::error!(%error, "the database does not answer");
                let title = "The database cannot be reached";
                Self::new(StatusCode::SERVICE_UNAVAILABLE, "database-unreachable", title)
                    .detail(
                        "probably nothing was changed; retry with the same Idempotency-Key",
                    )
                    .retry_after(5)
            }
            StoreError::ArtifactsUnreachable(_) => {
                tracing::error!(%error, "the object store does not answer");
                let title = "The object store cannot be reached";
                Self::new(StatusCode::SERVICE_UNAVAILABLE, "artifacts-unreachable", title)
                    .detail("probably nothing was stored; retry with the same Idempotency-Key")
                    .retry_after(5)
            }
            StoreError::Artifacts(_) | StoreError::File(_) => Self::storage_failed(error),
            error => Self::internal(error),
        }
    }
}

impl From<RenderFailure> for Problem {
    fn from(failure: RenderFailure) -> Self {
        match failure {
            RenderFailure::Busy | RenderFailure::Abandoned => {
                Self::new(StatusCode::SERVICE_UNAVAILABLE, "busy", "The device is busy")
                    .detail("other frames are rendered first; retry after a second")
                    .retry_after(1)
            }
            RenderFailure::Gone { what, id } => Self::not_found(what, &id),
            RenderFailure::Refused { field, reason } => Self::invalid_field(format!("/{field}"), reason),
            RenderFailure::Device(error) => {
                tracing::error!(%error, "the device failed during a render");
                Self::new(StatusCode::SERVICE_UNAVAILABLE, "device-failed", "The device failed")
                    .detail("the server opens the device again; retry after some seconds")
                    .retry_after(5)
            }
            RenderFailure::Internal(cause) => Self::internal(cause),
        }
    }
}
