//! `/v1/signed-urls`: URLs that are valid without a key for a limited time.

use axum::Json;
use axum::extract::State;
use axum::http::uri::PathAndQuery;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::extract::JsonBody;
use crate::server::listing::rfc3339;
use crate::server::problem::Problem;
use crate::server::signing::{self, SignedResource};
use relume_api::signed_urls::{NewSignedUrl, SignedUrl};

const LONGEST_PATH: usize = 2048;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(sign_url))
}

/// Sign a URL
///
/// Signs a `GET` URL for clients that cannot send a key, such as `<img>` and `EventSource`. Allowed are the
/// URLs of a thumbnail, of a model's stream, light or file, of an export's file, of a job's events, and of the
/// page that shows a model (`/share/{id}`). The URL gives read access to that resource until it expires, or
/// until the caller's key expires or is revoked. The URL of a page also gives access to the thumbnails, the
/// stream and the lights of its model.
#[utoipa::path(
    post, path = "/v1/signed-urls", tag = "signed-urls", request_body = NewSignedUrl,
    responses(
        (status = 200, body = SignedUrl), (status = 404, body = Problem), (status = 422, body = Problem)
    )
)]
async fn sign_url(
    State(app): State<AppState>,
    caller: Caller,
    JsonBody(asked): JsonBody<NewSignedUrl>,
) -> Result<Json<SignedUrl>, Problem> {
    let wrong = |why: &str| Problem::invalid_field("/path", why);
    if !(1..=NewSignedUrl::MAX_LIFETIME_S).contains(&asked.expires_in) {
        let detail = format!("must be 1 to {}, got {}", NewSignedUrl::MAX_LIFETIME_S, asked.expires_in);
        return Err(Problem::invalid_field("/expires_in", detail));
    }
    let target: Option<PathAndQuery> = asked.path.parse().ok().filter(|_| asked.path.len() <= LONGEST_PATH);
    let target =
        target.ok_or_else(|| wrong("must be the path and query of a URL, at most 2048 characters"))?;
    let subject = SignedResource::of(target.path());
    let subject = subject.ok_or_else(|| {
        wrong("must be the path of a thumbnail, a stream, a light or a file of a model, of the file of an export, of the events of a job, or /share/ and the identifier of a model")
    })?;
    must_exist(&app, &caller, &subject).await?;

    let now = app.jobs.now_ms() / 1000;
    let end = now.saturating_add_unsigned(asked.expires_in);
    let expires = caller.expires_ms.map_or(end, |key_ends| end.min(key_ends / 1000));
    let secret = app.signing.read_or_make().await.map_err(Problem::internal)?;
    let url = signing::sign(&caller, &secret, target.path(), target.query(), expires);
    let url = url.ok_or_else(|| {
        wrong("must not have the parameters key, expires and signature, which the server adds")
    })?;
    Ok(Json(SignedUrl { url, expires_at: rfc3339(expires.saturating_mul(1000)) }))
}

/// # Errors
/// 404 if the resource is not one of the caller's tenant.
async fn must_exist(app: &AppState, caller: &Caller, subject: &SignedResource) -> Result<(), Problem> {
    let (there, what, id) = match subject {
        SignedResource::Picture(id) | SignedResource::Share(id) => {
            (app.store.model(&caller.tenant, id).await?.is_some(), "model", id.to_string())
        }
        SignedResource::File(id, name) => {
            let file = app.store.model_file(&caller.tenant, id, name).await?;
            (file.is_some(), "file", format!("{id}/{name}"))
        }
        SignedResource::Export(id) => {
            (app.store.export(&caller.tenant, id).await?.is_some(), "export", id.to_string())
        }
        SignedResource::Events(id) => {
            (app.store.job(&caller.tenant, id).await?.is_some(), "job", id.to_string())
        }
    };
    if there { Ok(()) } else { Err(Problem::not_found(what, &id)) }
}
