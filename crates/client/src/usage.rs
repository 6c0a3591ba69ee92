//! Storage usage.

use reqwest::Method;

use crate::connection::{Client, json};
use crate::error::Result;
use relume_api::usage::Usage;

impl Client {
    /// Storage usage of the server.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn usage(&self) -> Result<Usage> {
        json(self.request(Method::GET, "/v1/usage")?).await
    }
}
