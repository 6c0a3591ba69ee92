//! Protection of a server without keys against foreign web pages. A page can make the browser of its visitor send requests to
//! 127.0.0.1, under its own name (DNS rebinding) or across sites.

use std::net::IpAddr;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::header;
use axum::http::uri::Authority;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tower_http::csrf::{CsrfLayer, ProtectionError};

use crate::server::origins::CorsOrigin;
use crate::server::problem::Problem;

/// Host names besides loopback under which the server may be called.
#[derive(Clone, Default)]
pub(super) struct TrustedHosts(Arc<[String]>);

impl From<Vec<String>> for TrustedHosts {
    fn from(names: Vec<String>) -> Self {
        Self(names.iter().map(|name| name.trim().to_ascii_lowercase()).collect())
    }
}

impl TrustedHosts {
    /// Whether a request may use this host; the port does not matter.
    fn trusts(&self, authority: &Authority) -> bool {
        let host = authority.host().trim_end_matches('.').to_ascii_lowercase();
        let address = host.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
        host == "localhost" || address.is_ok_and(|a| a.is_loopback()) || self.0.contains(&host)
    }
}

/// Refuses requests for other hosts.
pub(super) async fn check_host(State(hosts): State<TrustedHosts>, request: Request, next: Next) -> Response {
    let called = request.uri().authority().cloned().or_else(|| {
        let value = request.headers().get(header::HOST)?;
        Authority::try_from(value.as_bytes()).ok()
    });
    if called.as_ref().is_some_and(|authority| hosts.trusts(authority)) {
        return next.run(request).await;
    }
    let name = called.map(|c| c.to_string()).unwrap_or_default();
    let detail = format!(
        "a server without an API key accepts the hosts localhost and 127.0.0.1, not {name:?}; see --allow-host"
    );
    Problem::forbidden("foreign-host", detail).into_response()
}

/// Refuses requests from pages of other origins, except those that CORS permits.
pub(super) fn csrf(
    origins: &[CorsOrigin],
) -> CsrfLayer<impl FnMut(ProtectionError) -> Response + Clone + Send + Sync + use<>> {
    let mut layer = CsrfLayer::new();
    for origin in origins {
        if let CorsOrigin::One(value) = origin
            && let Ok(text) = value.to_str()
        {
            layer = match layer.clone().add_trusted_origin(text) {
                Ok(added) => added,
                // An origin that cannot be parsed is not trusted.
                Err(_) => layer,
            };
        }
    }
    layer.with_rejection_response(|_| {
        Problem::forbidden("foreign-origin", "the origin is not one of --cors-origin").into_response()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loopback_hosts_are_trusted_and_others_only_if_listed() {
        let hosts = TrustedHosts::from(vec!["Studio.lan".to_owned()]);
        let trusts = |host: &str| hosts.trusts(&host.parse().unwrap());
        for own in ["localhost", "LOCALHOST:7878", "127.0.0.1:1", "127.8.8.8", "[::1]:7878", "studio.lan:80"]
        {
            assert!(trusts(own), "{own}");
        }
        for foreign in ["evil.example", "127.0.0.1.evil.example:7878", "localhost.evil.example", "192.0.2.1"]
        {
            assert!(!trusts(foreign), "{foreign}");
        }
    }
}
