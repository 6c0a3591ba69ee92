//! Keys from the configuration of the server, and the rule for listening without keys.

use std::net::SocketAddr;
use std::sync::Arc;

use sha2::{Digest, Sha256};
use subtle::{ConditionallySelectable, ConstantTimeEq};

/// Keys that are accepted in addition to those in the database. Only their hashes are kept.
#[derive(Clone, Default)]
pub struct ApiKeys {
    hashes: Arc<[[u8; 32]]>,
}

impl ApiKeys {
    /// Accepts the given keys.
    pub fn new<S: AsRef<str>>(keys: impl IntoIterator<Item = S>) -> Self {
        let hashes = keys.into_iter().map(|k| Sha256::digest(k.as_ref().trim()).into()).collect();
        Self { hashes }
    }

    /// Whether there are no keys.
    pub fn is_empty(&self) -> bool {
        self.hashes.is_empty()
    }

    /// The hash of the key with this index.
    pub(super) fn hash(&self, index: usize) -> Option<&[u8; 32]> {
        self.hashes.get(index)
    }

    /// The index of a key. Compares with every hash, so that the time does not depend on the key.
    pub(super) fn index(&self, key: &str) -> Option<usize> {
        let presented: [u8; 32] = Sha256::digest(key).into();
        let mut found = u64::MAX;
        for (index, hash) in (0u64..).zip(self.hashes.iter()) {
            found.conditional_assign(&index, hash.ct_eq(&presented));
        }
        usize::try_from(found).ok().filter(|index| *index < self.hashes.len())
    }
}

/// Whether a server may listen on `address`.
pub(super) fn may_listen(address: SocketAddr, has_keys: bool) -> bool {
    address.ip().is_loopback() || has_keys
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_known_key_is_admitted() {
        let keys = ApiKeys::new(["first", "second"]);
        assert_eq!(["first", "second", "secon", ""].map(|k| keys.index(k)), [Some(0), Some(1), None, None]);
        assert_eq!(ApiKeys::default().index("first"), None);
    }

    #[test]
    fn without_a_key_only_loopback_addresses_may_listen() {
        let (local, world) = ("127.0.0.1:80".parse().unwrap(), "0.0.0.0:80".parse().unwrap());
        assert!(may_listen(local, false) && !may_listen(world, false) && may_listen(world, true));
    }
}
