//! The format of an API key: `rlm_`, its identifier, `_`, 256 random bits; all in lower-case hex, so that scanners can find
//! leaked keys. The server stores only a hash of the key. A plain hash is sufficient for this number of random bits.

use sha2::{Digest, Sha256};

use crate::store::StoreError;
use crate::store::hash::hex;
use relume_api::KeyId;

const PREFIX: &str = "rlm_";

/// An API key as its bearer sends it.
pub struct KeyToken {
    /// Identifier.
    pub id: KeyId,
    /// Hash of the whole key, lower-case hex.
    pub sha256: String,
}

impl KeyToken {
    /// Creates a key. The returned text is not stored anywhere.
    ///
    /// # Errors
    /// If the operating system provides no random bits.
    pub fn mint() -> Result<(Self, String), StoreError> {
        let (mut id, mut secret) = ([0u8; 8], [0u8; 32]);
        for bytes in [&mut id[..], &mut secret[..]] {
            getrandom::fill(bytes).map_err(std::io::Error::from)?;
        }
        let text = format!("{PREFIX}{}_{}", hex(&id), hex(&secret));
        Ok((Self { id: hex(&id).into(), sha256: hex(&Sha256::digest(&text)) }, text))
    }

    /// Parses a key; `None` if the text does not have the format of a key.
    pub fn parse(text: &str) -> Option<Self> {
        let (id, secret) = text.strip_prefix(PREFIX)?.split_once('_')?;
        let is_hex = |text: &str, digits: usize| {
            text.len() == digits && text.bytes().all(|c| c.is_ascii_digit() || (b'a'..=b'f').contains(&c))
        };
        let good = is_hex(id, 16) && is_hex(secret, 64);
        good.then(|| Self { id: id.into(), sha256: hex(&Sha256::digest(text)) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_tokens_parse_back_and_are_unique() {
        let (made, text) = KeyToken::mint().unwrap();
        let read = KeyToken::parse(&text).unwrap();
        assert_eq!((read.id.as_str(), &read.sha256), (made.id.as_str(), &made.sha256));
        assert!(!text.contains(&made.sha256));
        let (other, other_text) = KeyToken::mint().unwrap();
        assert!(other.id != made.id && other_text[21..] != text[21..]);
        let last = if text.ends_with('0') { "1" } else { "0" };
        let changed = format!("{}{last}", &text[..text.len() - 1]);
        assert_ne!(KeyToken::parse(&changed).unwrap().sha256, made.sha256);
        for odd in ["", "rlm_", "rlm_a_b", &text[1..], &text[..text.len() - 1], &text.to_uppercase()] {
            assert!(KeyToken::parse(odd).is_none(), "{odd}");
        }
    }
}
