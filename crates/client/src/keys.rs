//! API keys and signed URLs.

use reqwest::Method;

use crate::connection::{Client, json};
use crate::error::Result;
use relume_api::keys::{CreatedKey, KeyView, NewKey, RevokedKey};
use relume_api::signed_urls::{NewSignedUrl, SignedUrl};
use relume_api::{KeyId, List};

impl Client {
    /// Creates an API key. Only this response contains it.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn create_key(&self, key: &NewKey) -> Result<CreatedKey> {
        json(self.request(Method::POST, "/v1/keys")?.json(key)).await
    }

    /// The newest API keys.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn keys(&self) -> Result<List<KeyView>> {
        json(self.request(Method::GET, "/v1/keys")?).await
    }

    /// Revokes an API key and the keys created with it.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn revoke_key(&self, id: &KeyId) -> Result<RevokedKey> {
        json(self.request(Method::POST, &format!("/v1/keys/{id}/revoke"))?).await
    }

    /// Signs the URL of a thumbnail, of a model's file or of a job's events, for clients that cannot send a key.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn sign_url(&self, url: &NewSignedUrl) -> Result<SignedUrl> {
        json(self.request(Method::POST, "/v1/signed-urls")?.json(url)).await
    }
}
