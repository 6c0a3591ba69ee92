//! Signatures of URLs: HMAC-SHA-256 over the path and query as written, the key of the caller, and the expiry time.
//!
//! A signed URL ends with `key=ID&expires=SECONDS&signature=HEX`, in this order. The part before is compared byte by byte.

use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;
use subtle::ConstantTimeEq;

use crate::server::caller::Caller;
use crate::store::hex;
use relume_api::{ExportId, JobId, ModelId};

/// Parameters that a signature adds to a URL.
const RESERVED: [&str; 3] = ["key", "expires", "signature"];

/// The resource of a URL that may be signed. All are `GET` requests that pages let the browser make.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum SignedResource {
    /// A thumbnail of a model, its stream for viewers, or a light for it.
    Picture(ModelId),
    /// A file of a model.
    File(ModelId, String),
    /// The file of an export.
    Export(ExportId),
    /// The events of a job.
    Events(JobId),
    /// The page that shows a model. Its signature also permits the pictures of the model.
    Share(ModelId),
}

impl SignedResource {
    /// The resource of a path, if URLs of it may be signed.
    pub(super) fn of(path: &str) -> Option<Self> {
        if let Some(id) = path.strip_prefix("/share/") {
            return (!id.contains('/')).then(|| Self::Share(id.into()));
        }
        let parts: Vec<&str> = path.strip_prefix("/v1/")?.split('/').collect();
        match *parts.as_slice() {
            ["models", id, "thumbnail" | "stream" | "light"] => Some(Self::Picture(id.into())),
            ["models", id, "files", name] => Some(Self::File(id.into(), name.to_owned())),
            ["exports", id, "file"] => Some(Self::Export(id.into())),
            ["jobs", id, "events"] => Some(Self::Events(id.into())),
            _ => None,
        }
    }
}

/// The parsed query of a signed URL.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct SignedQuery<'a> {
    /// The query that was signed.
    pub(super) query: Option<&'a str>,
    /// The identifier of the key of the caller who signed.
    pub(super) key: &'a str,
    /// Expiry time, seconds since 1970 UTC.
    pub(super) expires: i64,
    signature: &'a str,
}

impl<'a> SignedQuery<'a> {
    /// Whether a query has a signature, valid or not.
    pub(super) fn is_present(query: Option<&str>) -> bool {
        names(query).any(|name| name == "signature")
    }

    pub(super) fn parse(query: Option<&'a str>) -> Option<Self> {
        let (rest, signature) = query?.rsplit_once("&signature=")?;
        let (rest, expires) = rest.rsplit_once("&expires=")?;
        let (query, key) = match rest.rsplit_once("&key=") {
            Some((query, key)) => (Some(query), key),
            None => (None, rest.strip_prefix("key=")?),
        };
        let seconds: i64 = expires.parse().ok()?;
        // The number must have the form in which it was signed, without + or leading zeros.
        (seconds.to_string() == expires).then_some(Self { query, key, expires: seconds, signature })
    }

    /// Whether the signature is that of `caller` for this path. The comparison takes constant time.
    pub(super) fn is_valid_for(&self, caller: &Caller, secret: &[u8], path: &str) -> bool {
        let expected = signature(secret, caller, path, self.query, self.expires);
        let same = |good: String| good.as_bytes().ct_eq(self.signature.as_bytes()).into();
        self.key == caller.key.as_str() && expected.is_some_and(same)
    }
}

/// Path and query with a signature; `None` if the query contains a reserved parameter.
pub(super) fn sign(
    caller: &Caller,
    secret: &[u8],
    path: &str,
    query: Option<&str>,
    expires: i64,
) -> Option<String> {
    if names(query).any(|name| RESERVED.contains(&name)) {
        return None;
    }
    let signature = signature(secret, caller, path, query, expires)?;
    let before = query.map_or_else(String::new, |query| format!("{query}&"));
    Some(format!("{path}?{before}key={}&expires={expires}&signature={signature}", caller.key))
}

/// The parameter names of a query.
fn names(query: Option<&str>) -> impl Iterator<Item = &str> {
    query.into_iter().flat_map(|q| q.split('&')).map(|pair| pair.split('=').next().unwrap_or_default())
}

/// Signs one line for each value; no value can contain a line break. The hash of the key is included, so that the signature
/// becomes invalid with the key itself and not only with its identifier.
fn signature(
    secret: &[u8],
    caller: &Caller,
    path: &str,
    query: Option<&str>,
    expires: i64,
) -> Option<String> {
    let query = query.map_or_else(String::new, |query| format!("?{query}"));
    let text = format!(
        "relume signed url 1\nGET\n{path}\n{query}\n{}\n{}\n{}\n{expires}",
        caller.tenant, caller.key, caller.key_hash
    );
    let mut mac = Hmac::<Sha256>::new_from_slice(secret).ok()?;
    mac.update(text.as_bytes());
    Some(hex(&mac.finalize().into_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn caller(tenant: &str, key: &str, hash: &str) -> Caller {
        Caller { tenant: tenant.into(), key: key.into(), key_hash: hash.into(), ..Caller::without_key() }
    }

    #[test]
    fn any_change_to_a_signed_url_invalidates_it() {
        let me = caller("t", "k", "h");
        let path = "/v1/models/m/thumbnail";
        for query in [None, Some("size=16"), Some("size=16&env=a%20b"), Some("")] {
            let url = sign(&me, b"secret", path, query, 100).unwrap();
            let (signed_path, rest) = url.split_once('?').unwrap();
            let signed = SignedQuery::parse(Some(rest)).unwrap();
            assert_eq!((signed_path, signed.query, signed.key, signed.expires), (path, query, "k", 100));
            assert!(signed.is_valid_for(&me, b"secret", path), "{url}");
            for other in [caller("u", "k", "h"), caller("t", "l", "h"), caller("t", "k", "i")] {
                assert!(!signed.is_valid_for(&other, b"secret", path), "{other:?}");
            }
            assert!(!signed.is_valid_for(&me, b"Secret", path));
            assert!(!signed.is_valid_for(&me, b"secret", "/v1/models/n/thumbnail"));
            // Every byte matters.
            for at in 0..rest.len() {
                let mut changed = rest.as_bytes().to_vec();
                changed[at] = if changed[at] == b'1' { b'2' } else { b'1' };
                let changed = String::from_utf8(changed).unwrap();
                let good =
                    SignedQuery::parse(Some(&changed)).is_some_and(|s| s.is_valid_for(&me, b"secret", path));
                assert!(!good, "{changed}");
            }
            for changed in [
                format!("a=1&{rest}"),
                format!("{rest}&a=1"),
                format!("&{rest}"),
                rest.replace("=100", "=+100"),
                rest.replace("=100", "=0100"),
            ] {
                let good =
                    SignedQuery::parse(Some(&changed)).is_some_and(|s| s.is_valid_for(&me, b"secret", path));
                assert!(!good, "{changed}");
            }
        }
        for query in ["key=a", "a=1&expires=3", "signature=", "signature"] {
            assert_eq!(sign(&me, b"secret", path, Some(query), 100), None, "{query}");
        }
    }

    #[test]
    fn only_browser_loadable_resources_can_be_signed() {
        assert_eq!(SignedResource::of("/v1/models/m/thumbnail"), Some(SignedResource::Picture("m".into())));
        assert_eq!(
            SignedResource::of("/v1/models/m/files/a.b"),
            Some(SignedResource::File("m".into(), "a.b".into()))
        );
        assert_eq!(SignedResource::of("/v1/jobs/j/events"), Some(SignedResource::Events("j".into())));
        assert_eq!(SignedResource::of("/v1/exports/e/file"), Some(SignedResource::Export("e".into())));
        for other in [
            "/v1/exports/e",
            "/v1/models/m",
            "/v1/models/m/render",
            "/v1/jobs",
            "/v1/jobs/j/cancel",
            "/v1/keys/k",
            "/metrics",
        ] {
            assert_eq!(SignedResource::of(other), None, "{other}");
        }
    }
}
