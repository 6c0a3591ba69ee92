//! `/v1/signed-urls`: URLs that are good without a key, for a time.

use axum::Json;
use axum::extract::State;
use axum::http::uri::PathAndQuery;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::Problem;
use crate::api::signed_urls::{NewSignedUrl, SignedUrl};
use crate::server::app::Shared;
use crate::server::caller::Caller;
use crate::server::extract::JsonBody;
use crate::server::listing::rfc3339;
use crate::server::signing::{self, Subject};

const LONGEST_PATH: usize = 2048;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(sign_url))
}

/// Sign a URL
///
/// For what cannot send a key, such as `<img>` and `EventSource`: a `GET` of a thumbnail, of a model's or a light's stream for
/// viewers, of a model's file, of an export's or of a job's events. It may read what the caller may, until it expires or the caller's key does or is revoked.
#[utoipa::path(
    post, path = "/v1/signed-urls", tag = "signed-urls", request_body = NewSignedUrl,
    responses(
        (status = 200, body = SignedUrl), (status = 404, body = Problem), (status = 422, body = Problem)
    )
)]
async fn sign_url(
    State(app): State<Shared>,
    caller: Caller,
    JsonBody(asked): JsonBody<NewSignedUrl>,
) -> Result<Json<SignedUrl>, Problem> {
    let wrong = |why: &str| Problem::invalid_field("/path", why);
    if !(1..=NewSignedUrl::LONGEST_LIFE).contains(&asked.expires_in) {
        let detail = format!("must be 1 to {}, got {}", NewSignedUrl::LONGEST_LIFE, asked.expires_in);
        return Err(Problem::invalid_field("/expires_in", detail));
    }
    let target: Option<PathAndQuery> = asked.path.parse().ok().filter(|_| asked.path.len() <= LONGEST_PATH);
    let target =
        target.ok_or_else(|| wrong("is no path with a query, as in a URL, of at most 2048 characters"))?;
    let subject = Subject::of(target.path());
    let subject = subject.ok_or_else(|| {
        wrong("must be that of a thumbnail, a stream, a light or a file of a model, of the file of an export, or of the events of a job; others are not signed")
    })?;
    must_exist(&app, &caller, &subject).await?;

    let now = app.jobs.now_ms() / 1000;
    let end = now.saturating_add_unsigned(asked.expires_in);
    let expires = caller.expires_ms.map_or(end, |key_ends| end.min(key_ends / 1000));
    let secret = app.signing.read_or_make().await.map_err(Problem::internal)?;
    let url = signing::sign(&caller, &secret, target.path(), target.query(), expires);
    let url = url.ok_or_else(|| wrong("has a parameter key, expires or signature, which signing adds"))?;
    Ok(Json(SignedUrl { url, expires_at: rfc3339(expires.saturating_mul(1000)) }))
}

/// # Errors
/// 404 when what is to be signed is nothing of the caller's.
async fn must_exist(app: &Shared, caller: &Caller, subject: &Subject) -> Result<(), Problem> {
    let (there, what, id) = match subject {
        Subject::Picture(id) => {
            (app.store.model(&caller.tenant, id).await?.is_some(), "model", id.to_string())
        }
        Subject::File(id, name) => {
            let file = app.store.model_file(&caller.tenant, id, name).await?;
            (file.is_some(), "file", format!("{id}/{name}"))
        }
        Subject::Export(id) => {
            (app.store.export(&caller.tenant, id).await?.is_some(), "export", id.to_string())
        }
        Subject::Events(id) => (app.store.job(&caller.tenant, id).await?.is_some(), "job", id.to_string()),
    };
    if there { Ok(()) } else { Err(Problem::not_found(what, &id)) }
}
