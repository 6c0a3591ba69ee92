//! The policy for fetching captures.

use std::str::FromStr;
use std::time::Duration;

use crate::server::outbound::OutboundTarget;

/// The policy for fetching captures.
#[derive(Debug, Clone)]
pub struct FetchPolicy {
    /// The permitted origins. All others are refused.
    pub origins: Vec<FetchOrigin>,
    /// Whether their addresses may be private.
    pub allow_private: bool,
    /// Timeout from the request to the last byte.
    pub timeout: Duration,
    /// Timeout without new bytes.
    pub stall: Duration,
}

impl Default for FetchPolicy {
    fn default() -> Self {
        let (timeout, stall) = (Duration::from_secs(3600), Duration::from_secs(30));
        Self { origins: Vec::new(), allow_private: false, timeout, stall }
    }
}

/// A scheme, a host and a port, e.g. `https://scans.example.org`. With `http://` the transfer is neither encrypted nor protected
/// against changes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FetchOrigin {
    is_https: bool,
    host: String,
    port: u16,
}

impl FetchOrigin {
    /// The origin of a URL.
    pub(super) fn of(target: &OutboundTarget) -> Self {
        Self { is_https: target.is_https, host: target.host.to_ascii_lowercase(), port: target.port }
    }
}

impl FromStr for FetchOrigin {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let target = OutboundTarget::parse(text, true).map_err(|why| format!("{text:?} {why}"))?;
        match text.trim_end_matches('/').matches('/').count() {
            2 if !text.contains('?') => Ok(Self::of(&target)),
            _ => Err(format!("{text:?} must be an origin like https://scans.example.org, without a path")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fetch_origins_are_compared_by_scheme_host_and_port() {
        let origin = |text: &str| text.parse::<FetchOrigin>();
        let of = |url: &str| FetchOrigin::of(&OutboundTarget::parse(url, true).unwrap());
        assert_eq!(origin("https://a.example"), Ok(of("https://A.example:443/x/y.zip?z=1")));
        assert_eq!(origin("http://127.0.0.1:9000/"), Ok(of("http://127.0.0.1:9000/x")));
        for other in
            ["http://a.example/", "https://b.a.example/", "https://a.example:8443/", "https://a.example.org/"]
        {
            assert_ne!(origin("https://a.example"), Ok(of(other)), "{other}");
        }
        for wrong in [
            "a.example",
            "https://a.example/path",
            "https://a.example?x",
            "ftp://a.example",
            "https://u@a.example",
            "",
        ] {
            assert!(origin(wrong).is_err(), "{wrong}");
        }
    }
}
