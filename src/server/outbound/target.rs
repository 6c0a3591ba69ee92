//! Validation of outbound targets: an absolute URL with a public address.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

use axum::http::Uri;

const LONGEST: usize = 2048;

/// A parsed URL.
#[derive(Debug, PartialEq, Eq)]
pub(in crate::server) struct OutboundTarget {
    pub(in crate::server) is_https: bool,
    /// A name or an address without brackets.
    pub(in crate::server) host: String,
    pub(in crate::server) port: u16,
    /// Host and port as written.
    pub(in crate::server) authority: String,
    /// Path and query.
    pub(in crate::server) path: String,
}

impl OutboundTarget {
    /// # Errors
    /// The reason why the URL is invalid.
    pub(in crate::server) fn parse(url: &str, allow_http: bool) -> Result<Self, String> {
        let is_whole = |url: &&str| url.len() <= LONGEST && !url.contains('#');
        let uri: Option<Uri> = Some(url).filter(is_whole).and_then(|url| url.parse().ok());
        let uri = uri.ok_or("must be a URL of at most 2048 characters without a fragment")?;
        let is_https = match uri.scheme_str() {
            Some("https") => true,
            Some("http") if allow_http => false,
            _ => return Err("must begin with https://".to_owned()),
        };
        let (authority, host) = uri.authority().map(|a| (a.as_str(), a.host())).ok_or("has no host")?;
        if authority.contains('@') {
            return Err("must not contain a user name".to_owned());
        }
        let host = host.trim_start_matches('[').trim_end_matches(']');
        let port = match uri.port() {
            Some(port) => port.as_u16(),
            // The port is not a number.
            None if authority.trim_end_matches(']').rsplit(']').next().is_some_and(|a| a.contains(':')) => {
                host.parse::<Ipv6Addr>().map_err(|_| "has an invalid port")?;
                if is_https { 443 } else { 80 }
            }
            None if is_https => 443,
            None => 80,
        };
        if host.is_empty() || port == 0 {
            return Err("has no host, or port 0".to_owned());
        }
        let path = uri.path_and_query().map_or("/", |path| path.as_str());
        let path = if path.starts_with('/') { path.to_owned() } else { format!("/{path}") };
        Ok(Self { is_https, host: host.to_owned(), port, authority: authority.to_owned(), path })
    }

    /// Resolves the host once. Only the returned addresses may be connected to.
    ///
    /// # Errors
    /// If there are none, or if one of them is not public. The error does not distinguish the cases, so that it reveals no
    /// internal names.
    pub(in crate::server) async fn addresses(&self, allow_private: bool) -> Result<Vec<SocketAddr>, String> {
        let resolve = async |host: &str, port| {
            tokio::net::lookup_host((host, port)).await.map(Iterator::collect).unwrap_or_default()
        };
        self.addresses_by(resolve, allow_private).await
    }

    /// As [`Self::addresses`], with the resolver of names.
    async fn addresses_by(
        &self,
        resolve: impl AsyncFnOnce(&str, u16) -> Vec<SocketAddr>,
        allow_private: bool,
    ) -> Result<Vec<SocketAddr>, String> {
        let found = match self.host.parse::<IpAddr>() {
            Ok(address) => vec![(address, self.port).into()],
            Err(_) => resolve(&self.host, self.port).await,
        };
        let is_good = |address: &SocketAddr| allow_private || is_public(address.ip());
        if !found.is_empty() && found.iter().all(is_good) {
            return Ok(found);
        }
        Err("its host has no public address".to_owned())
    }
}

/// Whether an address belongs to the public internet: the complement of IANA's special-purpose registries.
fn is_public(address: IpAddr) -> bool {
    match address {
        IpAddr::V4(address) => is_public_v4(address),
        IpAddr::V6(address) => is_public_v6(address),
    }
}

fn is_public_v4(address: Ipv4Addr) -> bool {
    let [a, b, c, _] = address.octets();
    let special = match a {
        0 | 10 | 127 | 224.. => true,
        100 => (64..128).contains(&b),
        169 => b == 254,
        172 => (16..32).contains(&b),
        192 => matches!((b, c), (0, 0 | 2) | (88, 99) | (168, _)),
        198 => matches!(b, 18 | 19) || (b, c) == (51, 100),
        203 => (b, c) == (0, 113),
        _ => false,
    };
    !special
}

/// Allocated space, 2000::/3, except tunnels to other addresses and documentation prefixes. IPv4-mapped addresses are outside of
/// it.
fn is_public_v6(address: Ipv6Addr) -> bool {
    let [a, b, ..] = address.segments();
    let is_given_out = a & 0xe000 == 0x2000;
    let special = match a {
        0x2001 => b < 0x0200 || b == 0x0db8,
        0x2002 => true,
        0x3fff => b < 0x1000,
        _ => false,
    };
    is_given_out && !special
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_name_with_a_private_address_is_refused_entirely() {
        let target = OutboundTarget::parse("https://example.org/", false).unwrap();
        let addresses = |texts: &[&str]| -> Vec<SocketAddr> {
            texts.iter().map(|text| (text.parse::<IpAddr>().unwrap(), 443).into()).collect()
        };
        let resolved = async |texts: &[&str], allow_private| {
            let resolve = async |host: &str, port| {
                assert_eq!((host, port), ("example.org", 443));
                addresses(texts)
            };
            target.addresses_by(resolve, allow_private).await
        };
        let public = ["93.184.216.34", "2606:4700::1"];
        assert_eq!(resolved(&public, false).await, Ok(addresses(&public)), "the control");
        for private in ["10.0.0.1", "127.0.0.1", "169.254.169.254", "::1", "fd00::1", "::ffff:10.0.0.1"] {
            for mixed in [[public[0], private], [private, public[0]], [public[1], private]] {
                let refused = resolved(&mixed, false).await.unwrap_err();
                assert_eq!(refused, "its host has no public address", "{mixed:?}");
                assert_eq!(
                    resolved(&mixed, true).await,
                    Ok(addresses(&mixed)),
                    "private addresses are permitted"
                );
            }
        }
        assert!(resolved(&[], true).await.is_err(), "a name without addresses");
    }

    #[test]
    fn outbound_urls_are_parsed_or_refused() {
        let target = OutboundTarget::parse("https://example.org/a?b=c", false).unwrap();
        assert_eq!((target.host.as_str(), target.port, target.path.as_str()), ("example.org", 443, "/a?b=c"));
        let target = OutboundTarget::parse("https://example.org:8443", false).unwrap();
        assert_eq!(
            (target.port, target.authority.as_str(), target.path.as_str()),
            (8443, "example.org:8443", "/")
        );
        let target = OutboundTarget::parse("https://example.org?a=b", false).unwrap();
        assert_eq!(target.path, "/?a=b");
        for (url, port) in [("https://[2606:4700::1]/", 443), ("https://[2606:4700::1]:8443/", 8443)] {
            let target = OutboundTarget::parse(url, false).unwrap();
            assert_eq!((target.host.as_str(), target.port), ("2606:4700::1", port));
        }
        for wrong in [
            "",
            "example.org",
            "/path",
            "http://example.org",
            "ftp://example.org",
            "file:///etc/passwd",
            "https://",
            "https:///path",
            "https://user@example.org",
            "https://user:word@example.org",
            "https://example.org/#part",
            "https://example.org:0/",
            "https://example.org:99999/",
            "https://example.org:port/",
            "https://exa mple.org/",
            "https://example.org/\r\nhost: other",
            &format!("https://example.org/{}", "a".repeat(2048)),
        ] {
            assert!(OutboundTarget::parse(wrong, false).is_err(), "{wrong}");
        }
        assert!(!OutboundTarget::parse("http://example.org", true).unwrap().is_https);
    }

    #[test]
    fn private_and_reserved_addresses_are_not_public() {
        let public = |text: &str| is_public(text.parse().unwrap_or_else(|_| panic!("{text}")));
        for address in [
            "0.0.0.0",
            "0.1.2.3",
            "10.0.0.1",
            "100.64.0.1",
            "100.127.255.255",
            "127.0.0.1",
            "127.255.0.1",
            "169.254.169.254",
            "172.16.0.1",
            "172.31.255.255",
            "192.0.0.8",
            "192.0.2.1",
            "192.88.99.1",
            "192.168.1.1",
            "198.18.0.1",
            "198.19.255.255",
            "198.51.100.1",
            "203.0.113.1",
            "224.0.0.1",
            "239.255.255.255",
            "240.0.0.1",
            "255.255.255.255",
            "::",
            "::1",
            "::127.0.0.1",
            "::ffff:127.0.0.1",
            "::ffff:8.8.8.8",
            "64:ff9b::7f00:1",
            "64:ff9b:1::1",
            "100::1",
            "2001::1",
            "2001:10::1",
            "2001:db8::1",
            "2002:7f00:1::1",
            "3fff::1",
            "5f00::1",
            "fc00::1",
            "fd12:3456::1",
            "fe80::1",
            "fec0::1",
            "ff02::1",
        ] {
            assert!(!public(address), "{address}");
        }
        for address in [
            "1.1.1.1",
            "8.8.8.8",
            "9.255.255.255",
            "100.63.255.255",
            "100.128.0.0",
            "172.15.255.255",
            "172.32.0.0",
            "192.0.1.1",
            "192.167.255.255",
            "198.17.255.255",
            "223.255.255.255",
            "2606:4700:4700::1111",
            "2a00:1450::1",
            "2001:4860:4860::8888",
        ] {
            assert!(public(address), "{address}");
        }
    }

    #[tokio::test]
    async fn private_host_is_refused_in_every_notation() {
        for host in ["127.0.0.1", "localhost", "[::1]", "[::ffff:127.0.0.1]", "0x7f.1", "2130706433", "0"] {
            let target = OutboundTarget::parse(&format!("https://{host}/"), false).unwrap();
            assert!(target.addresses(false).await.is_err(), "{host}");
        }
        let target = OutboundTarget::parse("https://localhost:9/", false).unwrap();
        let found = target.addresses(true).await.unwrap();
        assert!(found.iter().all(|a| a.ip().is_loopback() && a.port() == 9), "the control: {found:?}");
        let target = OutboundTarget::parse("https://8.8.8.8/", false).unwrap();
        assert_eq!(target.addresses(false).await.unwrap(), ["8.8.8.8:443".parse().unwrap()]);
    }
}
