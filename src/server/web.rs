//! The web app, which is embedded in the program. It is built from `web/` and uses the API like any other client.

use std::borrow::Cow;
use std::io::Write;
use std::sync::LazyLock;

use axum::Router;
use axum::extract::Path;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use flate2::Compression;
use flate2::write::GzEncoder;
use rust_embed::RustEmbed;

use crate::server::files::{etag, matches_etag};
use crate::server::problem::Problem;
use crate::store::hex;

/// The output of `npm run build` in `web/`.
#[derive(RustEmbed)]
#[folder = "web/dist"]
struct EmbeddedAssets;

/// Routes of the web app. They need no key; the data come from the API, which requires one.
pub(super) const ROUTES: [&str; 5] = ["/", "/docs", "/favicon.svg", "/relume-viewer.js", "/assets/{name}"];

/// The content security policy of pages: their own files, the API of this server, and images that they create.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; \
                      connect-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// A file of the web app, ready to be sent.
struct WebAsset {
    /// Path relative to the root.
    path: Cow<'static, str>,
    bytes: Cow<'static, [u8]>,
    /// The gzipped content, if it is smaller.
    gzip: Option<Vec<u8>>,
    sha256: String,
}

/// All files, which are compressed at the first request.
static WEB_ASSETS: LazyLock<Vec<WebAsset>> =
    LazyLock::new(|| EmbeddedAssets::iter().filter_map(WebAsset::read).collect());

impl WebAsset {
    fn read(path: Cow<'static, str>) -> Option<Self> {
        let file = EmbeddedAssets::get(&path)?;
        let gzip = gzip(&file.data).filter(|packed| packed.len() < file.data.len());
        Some(Self { path, gzip, sha256: hex(&file.metadata.sha256_hash()), bytes: file.data })
    }

    fn find(path: &str) -> Option<&'static Self> {
        WEB_ASSETS.iter().find(|file| file.path == path)
    }

    fn media_type(&self) -> &'static str {
        match self.path.rsplit_once('.').map(|(_, extension)| extension) {
            Some("html") => "text/html; charset=utf-8",
            Some("js") => "text/javascript; charset=utf-8",
            Some("css") => "text/css; charset=utf-8",
            Some("svg") => "image/svg+xml",
            Some("png") => "image/png",
            _ => "application/octet-stream",
        }
    }

    /// Files named by their hash never change. Other files are revalidated for each use, with 304 if they are unchanged.
    fn cache_control(&self) -> &'static str {
        match self.path.starts_with("assets/") {
            true => "public, max-age=31536000, immutable",
            false => "no-cache",
        }
    }

    fn respond(&'static self, headers: &HeaderMap) -> Response {
        let gzip = self.gzip.as_ref().filter(|_| accepts_gzip(headers));
        // Each encoding is a separate representation with its own tag.
        let tag = etag(&match gzip {
            Some(_) => format!("{}-gzip", self.sha256),
            None => self.sha256.clone(),
        });
        let mut response = if matches_etag(headers, &tag) {
            StatusCode::NOT_MODIFIED.into_response()
        } else {
            let content = [(header::CONTENT_TYPE, self.media_type())];
            match gzip {
                Some(packed) => {
                    ([(header::CONTENT_ENCODING, "gzip")], content, packed.as_slice()).into_response()
                }
                None => (content, self.bytes.clone()).into_response(),
            }
        };
        let out = response.headers_mut();
        let mut set =
            |name: HeaderName, value: &'static str| out.insert(name, HeaderValue::from_static(value));
        set(header::CACHE_CONTROL, self.cache_control());
        set(header::VARY, "accept-encoding");
        set(header::CONTENT_SECURITY_POLICY, POLICY);
        if let Ok(value) = HeaderValue::from_str(&tag) {
            out.insert(header::ETAG, value);
        }
        response
    }
}

/// The pages and their files.
pub(super) fn routes<S: Clone + Send + Sync + 'static>() -> Router<S> {
    let [index, docs, icon, viewer, assets] = ROUTES;
    Router::new()
        .route(index, get(|headers| async { send("index.html", headers) }))
        .route(docs, get(|headers| async { send("docs.html", headers) }))
        .route(icon, get(|headers| async { send("favicon.svg", headers) }))
        .route(viewer, get(|headers| async { send("relume-viewer.js", headers) }))
        .route(
            assets,
            get(|Path(name): Path<String>, headers| async move { send(&format!("assets/{name}"), headers) }),
        )
}

fn send(path: &str, headers: HeaderMap) -> Response {
    match WebAsset::find(path) {
        Some(file) => file.respond(&headers),
        None => Problem::not_found("path", &format!("/{path}")).into_response(),
    }
}

/// The text of a page and its content security policy; `None` if there is no such page.
pub(super) fn page(path: &str) -> Option<(String, &'static str)> {
    let file = WebAsset::find(path)?;
    Some((String::from_utf8_lossy(&file.bytes).into_owned(), POLICY))
}

/// The redirection of a browser that opened a path of no route, e.g. `/models/ID`, to the page of that path in the web app, `/#/models/ID`.
/// `None` for paths of the API and for other clients, which do not ask for HTML.
pub(super) fn redirect(method: &Method, uri: &Uri, headers: &HeaderMap) -> Option<Response> {
    let asks_for_html = headers
        .get_all(header::ACCEPT)
        .iter()
        .any(|value| value.to_str().is_ok_and(|text| text.contains("text/html")));
    let path = uri.path().trim_start_matches('/');
    if *method != Method::GET || !asks_for_html || path.starts_with("v1/") {
        return None;
    }
    // Relative to the path, so that it also works below a path of a proxy.
    let root = match uri.path().matches('/').count() {
        0 | 1 => "./".to_owned(),
        depth => "../".repeat(depth - 1),
    };
    Some((StatusCode::SEE_OTHER, [(header::LOCATION, format!("{root}#/{path}"))]).into_response())
}

fn gzip(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes).ok()?;
    encoder.finish().ok()
}

/// Whether `Accept-Encoding` contains gzip with a weight above 0.
fn accepts_gzip(headers: &HeaderMap) -> bool {
    let values = headers.get_all(header::ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).any(|entry| {
        let (name, weight) = entry.split_once(';').unwrap_or((entry, ""));
        let refused = weight.trim().strip_prefix("q=").is_some_and(|q| q.parse() == Ok(0.0));
        name.trim().eq_ignore_ascii_case("gzip") && !refused
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gzip_is_used_only_if_accept_encoding_allows_it() {
        let accepts = |value: &str| {
            accepts_gzip(&HeaderMap::from_iter([(header::ACCEPT_ENCODING, value.parse().unwrap())]))
        };
        assert!(accepts("gzip") && accepts("br, GZIP;q=0.5") && accepts("deflate,gzip, zstd"));
        assert!(!accepts("br") && !accepts("gzip;q=0, br") && !accepts("gzip;q=0.0") && !accepts("xgzip"));
        assert!(!accepts_gzip(&HeaderMap::new()));
    }

    #[test]
    fn only_browsers_are_redirected_from_unknown_paths() {
        let location = |method: Method, path: &'static str, accept: &str| {
            let headers = HeaderMap::from_iter([(header::ACCEPT, accept.parse().unwrap())]);
            let response = redirect(&method, &Uri::from_static(path), &headers)?;
            Some(response.headers()[header::LOCATION].to_str().unwrap().to_owned())
        };
        let browser = "text/html,application/xhtml+xml,*/*;q=0.8";
        assert_eq!(location(Method::GET, "/models/a1", browser).as_deref(), Some("../#/models/a1"));
        assert_eq!(location(Method::GET, "/nothing", browser).as_deref(), Some("./#/nothing"));
        assert_eq!(
            location(Method::GET, "//evil.example/", browser).as_deref(),
            Some("../../#/evil.example/")
        );
        assert_eq!(location(Method::GET, "/models/a1", "*/*"), None);
        assert_eq!(location(Method::GET, "/v1/nothing", browser), None);
        assert_eq!(location(Method::POST, "/models/a1", browser), None);
    }

    #[test]
    fn every_web_file_is_served_by_a_route() {
        assert!(WebAsset::find("index.html").is_some() && WebAsset::find("relume-viewer.js").is_some());
        let known = |path: &str| {
            ["index.html", "docs.html", "share/index.html"].contains(&path)
                || path.starts_with("assets/")
                || ROUTES.contains(&&*format!("/{path}"))
        };
        let lost: Vec<_> = WEB_ASSETS.iter().map(|file| &*file.path).filter(|path| !known(path)).collect();
        assert!(lost.is_empty(), "{lost:?}");
        assert!(WEB_ASSETS.iter().all(|file| file.media_type() != "application/octet-stream"));
    }
}
