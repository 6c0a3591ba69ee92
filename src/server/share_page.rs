//! `/share/{id}`: a page that shows a model, for people without a key. Its link is a signed URL.

use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Uri, header};
use axum::response::{IntoResponse, Response};
use percent_encoding::{NON_ALPHANUMERIC, utf8_percent_encode};
use serde::Deserialize;
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::access::signer;
use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::extract::{QueryString, UrlPath};
use crate::server::problem::Problem;
use crate::server::signing::{self, SignedQuery};
#[cfg(feature = "web")]
use crate::server::web;
use relume_api::ModelId;

/// Light of a page whose URL names none, as in the web app.
const LIGHT: &str = "studio";
/// The element of the page in whose place its preview is put.
const PREVIEW: &str = "<meta name=\"relume-preview\" />";

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(share_page))
}

/// What the page shows first. The page also reads the other parameters of the page of a model in the web app.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct ShareQuery {
    /// Light, as `env` of a thumbnail. Omitted: `studio`.
    light: Option<String>,
    /// Azimuth of the camera, as in a thumbnail.
    azimuth: Option<String>,
    /// Elevation of the camera, as in a thumbnail.
    elevation: Option<String>,
}

/// Show a model to people without a key
///
/// An HTML page with a viewer of the model, and a preview picture for messengers and social networks. On a
/// server with keys the URL must be signed (`POST /v1/signed-urls` with the path `/share/{id}`); a page whose
/// link is not valid says so and shows no model.
#[utoipa::path(
    get, path = "/share/{id}", tag = "models",
    params(("id" = String, Path, description = "Model identifier"), ShareQuery),
    responses(
        (status = 200, content_type = "text/html", body = String),
        (status = 404, body = Problem, description = "The server was built without the web app")
    )
)]
async fn share_page(
    State(app): State<AppState>,
    UrlPath(id): UrlPath<ModelId>,
    uri: Uri,
    headers: HeaderMap,
    QueryString(query): QueryString<ShareQuery>,
) -> Result<Response, Problem> {
    #[cfg(feature = "web")]
    let page = web::page("share/index.html");
    #[cfg(not(feature = "web"))]
    let page: Option<(String, &str)> = None;
    let (page, policy) = page.ok_or_else(|| Problem::not_found("path", uri.path()))?;
    let preview = preview(&app, &id, &uri, &headers, &query).await?;
    let head = [
        (header::CONTENT_TYPE, HeaderValue::from_static("text/html; charset=utf-8")),
        // The page depends on the signature and on the model.
        (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
        (header::CONTENT_SECURITY_POLICY, HeaderValue::from_str(policy).map_err(Problem::internal)?),
    ];
    Ok((head, page.replace(PREVIEW, &preview)).into_response())
}

/// The HTML of title and preview; empty if the link is not valid or the model does not exist.
async fn preview(
    app: &AppState,
    id: &ModelId,
    uri: &Uri,
    headers: &HeaderMap,
    query: &ShareQuery,
) -> Result<String, Problem> {
    let caller = match SignedQuery::parse(uri.query()) {
        Some(signed) => match signer(&app.keys, &app.signing, &signed, uri.path()).await {
            Ok(caller) => Some(caller),
            // The page says that the link is not valid. Other failures are answered as such.
            Err(problem) if problem.status == 403 => None,
            Err(problem) => return Err(problem),
        },
        None => app.keys.caller(None).await?,
    };
    let Some(caller) = caller else { return Ok(String::new()) };
    let Some(model) = app.store.model(&caller.tenant, id).await? else { return Ok(String::new()) };
    let title = model.metadata.name.unwrap_or_else(|| "A relightable model".to_owned());
    let image = picture(app, &caller, id, query).await?;
    Ok(html(&title, &format!("{}{image}", origin(uri, headers))))
}

/// Path and query of the preview picture, signed like the page.
async fn picture(
    app: &AppState,
    caller: &Caller,
    id: &ModelId,
    query: &ShareQuery,
) -> Result<String, Problem> {
    let mut parameters = "size=1024&tier=standard&format=jpeg&background=f4f1ea".to_owned();
    let light = query.light.as_deref().unwrap_or(LIGHT);
    for (name, value) in [
        ("env", Some(light)),
        ("azimuth", query.azimuth.as_deref()),
        ("elevation", query.elevation.as_deref()),
    ] {
        if let Some(value) = value {
            parameters += &format!("&{name}={}", utf8_percent_encode(value, NON_ALPHANUMERIC));
        }
    }
    let path = format!("/v1/models/{id}/thumbnail");
    let (Some(_), Some(expires_ms)) = (caller.signed_under, caller.expires_ms) else {
        return Ok(format!("{path}?{parameters}"));
    };
    let secret = app.signing.read_or_make().await.map_err(Problem::internal)?;
    signing::sign(caller, &secret, &path, Some(&parameters), expires_ms / 1000)
        .ok_or_else(|| Problem::internal("the picture of a page cannot be signed"))
}

/// Scheme and host by which the client called the server, also behind a proxy that terminates TLS. Readers of previews need absolute URLs.
fn origin(uri: &Uri, headers: &HeaderMap) -> String {
    let text = |name: &str| headers.get(name).and_then(|value| value.to_str().ok());
    let host = uri.host().or_else(|| text("host")).unwrap_or_default();
    let scheme = if text("x-forwarded-proto") == Some("https") { "https" } else { "http" };
    let authority = uri.authority().map_or(host, |authority| authority.as_str());
    format!("{scheme}://{authority}")
}

/// Title and preview of the page, by the Open Graph protocol.
fn html(title: &str, image: &str) -> String {
    let (title, image) = (escaped(title), escaped(image));
    let properties = [
        ("og:title", title.as_str()),
        ("og:description", "A relightable 3D model. Turn it, and turn its light."),
        ("og:type", "website"),
        ("og:image", &image),
        ("og:image:width", "1024"),
        ("og:image:height", "1024"),
        ("twitter:card", "summary_large_image"),
    ];
    let metas =
        properties.map(|(name, content)| format!("<meta property=\"{name}\" content=\"{content}\" />"));
    format!("<title>{title}</title>\n    {}", metas.join("\n    "))
}

/// A text in HTML, in element content or in an attribute with double quotes.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_models_are_escaped_in_the_page() {
        let text = html("</title><script>\"&", "http://a/?b=1&c=\"");
        assert!(text.starts_with("<title>&lt;/title&gt;&lt;script&gt;&quot;&amp;</title>"), "{text}");
        assert!(text.contains("content=\"http://a/?b=1&amp;c=&quot;\""), "{text}");
        assert!(html("a vase", "http://a/").starts_with("<title>a vase</title>"), "the control");
    }

    #[test]
    fn preview_pictures_have_the_origin_of_the_request() {
        let headers = |entries: &[(&'static str, &str)]| -> HeaderMap {
            entries.iter().map(|(name, value)| (name.parse().unwrap(), value.parse().unwrap())).collect()
        };
        let uri = Uri::from_static("/share/m");
        assert_eq!(origin(&uri, &headers(&[("host", "a.example:80")])), "http://a.example:80");
        let proxied = headers(&[("host", "a.example"), ("x-forwarded-proto", "https")]);
        assert_eq!(origin(&uri, &proxied), "https://a.example");
        assert_eq!(origin(&Uri::from_static("http://b.example/share/m"), &headers(&[])), "http://b.example");
    }
}
