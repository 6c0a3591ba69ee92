//! Bearer API keys and the rule about where a server without any may listen.

use std::net::SocketAddr;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::{StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

use crate::api::Problem;

/// The accepted keys, as hashes: the keys themselves are not stored.
#[derive(Clone, Default)]
pub struct ApiKeys {
    hashes: Arc<[[u8; 32]]>,
}

impl ApiKeys {
    /// Accepts bearers of any of `keys`; without keys, everyone.
    pub fn new<S: AsRef<str>>(keys: impl IntoIterator<Item = S>) -> Self {
        let hashes = keys.into_iter().map(|k| Sha256::digest(k.as_ref().trim()).into()).collect();
        Self { hashes }
    }

    /// True when everyone is accepted.
    pub fn is_open(&self) -> bool {
        self.hashes.is_empty()
    }

    /// Compares with every hash, whichever matches, so that the time it takes does not depend on the key.
    fn admits(&self, key: &str) -> bool {
        let presented: [u8; 32] = Sha256::digest(key).into();
        let found = self.hashes.iter().fold(subtle::Choice::from(0), |any, h| any | h.ct_eq(&presented));
        found.into()
    }

    /// Whether a server with these keys may listen at `address`.
    pub fn may_listen(&self, address: SocketAddr) -> bool {
        address.ip().is_loopback() || !self.is_open()
    }
}

/// Refuses requests without an accepted key. Health checks and the API description are open to all.
pub(super) async fn authenticate(State(keys): State<ApiKeys>, request: Request, next: Next) -> Response {
    let open = matches!(request.uri().path(), "/healthz" | "/readyz" | "/v1/openapi.json");
    if open || keys.is_open() || bearer(&request).is_some_and(|key| keys.admits(key)) {
        return next.run(request).await;
    }
    Problem::new(StatusCode::UNAUTHORIZED, "unauthorized", "An API key is needed")
        .detail("send Authorization: Bearer <key>")
        .into_response()
}

fn bearer(request: &Request) -> Option<&str> {
    let value = request.headers().get(header::AUTHORIZATION)?.to_str().ok()?;
    let (scheme, key) = value.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| key.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_known_key_is_admitted() {
        let keys = ApiKeys::new(["first", "second"]);
        assert!(keys.admits("second") && !keys.admits("secon") && !keys.admits(""));
    }

    #[test]
    fn without_a_key_only_loopback_is_served() {
        let (open, locked) = (ApiKeys::default(), ApiKeys::new(["k"]));
        let local = "127.0.0.1:80".parse().unwrap();
        let world = "0.0.0.0:80".parse().unwrap();
        assert!(open.may_listen(local) && !open.may_listen(world) && locked.may_listen(world));
    }
}
