//! Origins whose web pages may call the API.

use std::str::FromStr;

use axum::http::{HeaderName, HeaderValue, Method, Uri, header};
use tower_http::cors::{AllowHeaders, AllowMethods, AllowOrigin, CorsLayer, ExposeHeaders};

use crate::server::photograph_angle;

/// Headers that pages may read in addition to the CORS-safelisted ones.
const EXPOSED: [HeaderName; 27] = [
    header::ACCEPT_RANGES,
    header::ALLOW,
    header::CONTENT_DISPOSITION,
    header::CONTENT_RANGE,
    header::ETAG,
    header::LOCATION,
    header::RETRY_AFTER,
    header::WWW_AUTHENTICATE,
    HeaderName::from_static("idempotent-replayed"),
    HeaderName::from_static("preference-applied"),
    HeaderName::from_static("ratelimit"),
    HeaderName::from_static("ratelimit-policy"),
    HeaderName::from_static("relume-depth-range"),
    photograph_angle::PHOTOGRAPH_ANGLE,
    HeaderName::from_static("relume-step"),
    HeaderName::from_static("repr-digest"),
    HeaderName::from_static("server-timing"),
    HeaderName::from_static("tus-checksum-algorithm"),
    HeaderName::from_static("tus-extension"),
    HeaderName::from_static("tus-max-size"),
    HeaderName::from_static("tus-resumable"),
    HeaderName::from_static("tus-version"),
    HeaderName::from_static("upload-expires"),
    HeaderName::from_static("upload-length"),
    HeaderName::from_static("upload-metadata"),
    HeaderName::from_static("upload-offset"),
    HeaderName::from_static("x-request-id"),
];

/// An origin whose web pages may call the API.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CorsOrigin {
    /// All origins, written `*`. Browsers then send no cookies or stored credentials.
    Any,
    /// One origin, as a browser sends it.
    One(HeaderValue),
}

/// An invalid origin.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not an origin: must be * or like https://app.example.org, in lower case, without a path")]
pub struct OriginError(String);

impl FromStr for CorsOrigin {
    type Err = OriginError;

    fn from_str(text: &str) -> Result<Self, OriginError> {
        if text == "*" {
            return Ok(Self::Any);
        }
        let wrong = || OriginError(text.to_owned());
        let uri: Uri = text.parse().map_err(|_| wrong())?;
        let (Some(scheme @ ("http" | "https")), Some(authority)) = (uri.scheme_str(), uri.authority()) else {
            return Err(wrong());
        };
        // The origin is compared byte by byte with that of a browser, so only the canonical form is valid.
        let canonical = format!("{scheme}://{authority}").to_ascii_lowercase();
        if canonical != text || authority.as_str().contains(['@', '*']) {
            return Err(wrong());
        }
        HeaderValue::from_str(text).map(Self::One).map_err(|_| wrong())
    }
}

/// Permits pages of the given origins to call the API, and no others; `None` if there are none.
pub(super) fn cors(origins: &[CorsOrigin]) -> Option<CorsLayer> {
    let listed = origins.iter().map(|origin| match origin {
        CorsOrigin::Any => None,
        CorsOrigin::One(value) => Some(value.clone()),
    });
    let allowed = match listed.collect::<Option<Vec<_>>>() {
        None => AllowOrigin::any(),
        Some(list) if list.is_empty() => return None,
        Some(list) => AllowOrigin::list(list),
    };
    let layer = CorsLayer::new()
        .allow_origin(allowed)
        .allow_methods(AllowMethods::list([Method::GET, Method::POST, Method::PATCH, Method::DELETE]))
        .allow_headers(AllowHeaders::mirror_request())
        .expose_headers(ExposeHeaders::list(EXPOSED));
    Some(layer)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cors_origins_must_be_written_as_browsers_send_them() {
        for good in ["*", "http://localhost:5173", "https://app.example.org", "https://[::1]:8080"] {
            assert!(good.parse::<CorsOrigin>().is_ok(), "{good}");
        }
        for bad in [
            "",
            "app.example.org",
            "https://",
            "https://a.example/",
            "https://a.example/page",
            "HTTPS://A.example",
            "ftp://a.example",
            "https://me@a.example",
            "null",
            "https://*",
            "https://*.a.example",
        ] {
            let found = bad.parse::<CorsOrigin>();
            assert!(found.is_err_and(|e| e.to_string().contains("https://app.example.org")), "{bad:?}");
        }
    }
}
