//! API keys and signed URLs.

use reqwest::Method;

use crate::connection::{Client, json};
use crate::error::Result;
use relume_api::keys::{CreatedKey, KeyView, NewKey, RevokedKey};
use relume_api::signed_urls::{NewSignedUrl, SignedUrl};
use relume_api::{KeyId, List};

impl Client {
    /// Makes an API key; the answer is the only one that has it.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn create_key(&self, key: &NewKey) -> Result<CreatedKey> {
        json(self.request(Method::POST, "/v1/keys")?.json(key)).await
    }

    /// The newest API keys.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn keys(&self) -> Result<List<KeyView>> {
        json(self.request(Method::GET, "/v1/keys")?).await
    }

    /// Revokes an API key and those that it made.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn revoke_key(&self, id: &KeyId) -> Result<RevokedKey> {
        json(self.request(Method::POST, &format!("/v1/keys/{id}/revoke"))?).await
    }

    /// Signs the URL of a thumbnail, of a model's file or of a job's events, for what cannot send a key.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn sign_url(&self, url: &NewSignedUrl) -> Result<SignedUrl> {
        json(self.request(Method::POST, "/v1/signed-urls")?.json(url)).await
    }
}
