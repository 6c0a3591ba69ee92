//! Signatures of messages: HMAC-SHA-256 over the identifier, the time of the attempt and the bytes, separated by dots.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;

/// Number of random bytes of a secret.
const BYTES: usize = 32;

/// A new secret.
///
/// # Errors
/// When the operating system provides no random bits.
pub(super) fn fresh_secret() -> std::io::Result<Vec<u8>> {
    let mut secret = vec![0u8; BYTES];
    getrandom::fill(&mut secret)?;
    Ok(secret)
}

/// A secret in the form for its owner.
pub(super) fn encode_secret(secret: &[u8]) -> String {
    format!("whsec_{}", STANDARD.encode(secret))
}

/// The header `webhook-signature`: a signature by each secret, separated by spaces.
pub(super) fn sign<'a>(
    secrets: impl Iterator<Item = &'a [u8]>,
    id: &str,
    seconds: i64,
    body: &str,
) -> Option<String> {
    let signatures: Option<Vec<String>> =
        secrets.map(|secret| signature(secret, id, seconds, body)).collect();
    signatures.map(|signatures| signatures.join(" "))
}

fn signature(secret: &[u8], id: &str, seconds: i64, body: &str) -> Option<String> {
    let mut mac = Hmac::<Sha256>::new_from_slice(secret).ok()?;
    mac.update(format!("{id}.{seconds}.{body}").as_bytes());
    Some(format!("v1,{}", STANDARD.encode(mac.finalize().into_bytes())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_secret_adds_one_signature() {
        let both = sign([b"new".as_slice(), b"old"].into_iter(), "id", 1, "{}").unwrap();
        let alone = |secret: &'static [u8]| sign(std::iter::once(secret), "id", 1, "{}").unwrap();
        assert_eq!(both, format!("{} {}", alone(b"new"), alone(b"old")));
    }

    #[test]
    fn signature_matches_the_standard_webhooks_example() {
        let secret = STANDARD.decode("MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw").unwrap();
        let signed =
            signature(&secret, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1_614_265_330, r#"{"test": 2432232314}"#);
        assert_eq!(signed.unwrap(), "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
        assert_eq!(encode_secret(&secret), "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw");
        assert_ne!(fresh_secret().unwrap(), fresh_secret().unwrap());
    }
}
