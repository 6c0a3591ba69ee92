//! What a server has stored.

use reqwest::Method;

use crate::connection::{Client, json};
use crate::error::Result;
use relume_api::usage::Usage;

impl Client {
    /// What the server has stored.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn usage(&self) -> Result<Usage> {
        json(self.request(Method::GET, "/v1/usage")?).await
    }
}
