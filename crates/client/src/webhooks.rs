//! Webhooks.

use reqwest::Method;

use crate::connection::{Client, checked, json};
use crate::error::Result;
use relume_api::webhooks::{CreatedWebhook, DeliveryView, NewWebhook, WebhookChange, WebhookView};
use relume_api::{DeliveryId, List, WebhookId};

impl Client {
    /// Makes a webhook; the answer is the only one that has its secret.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn create_webhook(&self, webhook: &NewWebhook) -> Result<CreatedWebhook> {
        json(self.request(Method::POST, "/v1/webhooks")?.json(webhook)).await
    }

    /// The newest webhooks.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn webhooks(&self) -> Result<List<WebhookView>> {
        json(self.request(Method::GET, "/v1/webhooks")?).await
    }

    /// A webhook.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn webhook(&self, id: &WebhookId) -> Result<WebhookView> {
        json(self.request(Method::GET, &format!("/v1/webhooks/{id}"))?).await
    }

    /// Changes a webhook.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn change_webhook(&self, id: &WebhookId, change: &WebhookChange) -> Result<WebhookView> {
        json(self.request(Method::PATCH, &format!("/v1/webhooks/{id}"))?.json(change)).await
    }

    /// Gives a webhook a new secret; the answer is the only one that has it. The one before signs beside it for 24 hours.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn rotate_webhook_secret(&self, id: &WebhookId) -> Result<CreatedWebhook> {
        json(self.request(Method::POST, &format!("/v1/webhooks/{id}/rotate-secret"))?).await
    }

    /// Deletes a webhook with its deliveries.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn delete_webhook(&self, id: &WebhookId) -> Result<()> {
        checked(self.request(Method::DELETE, &format!("/v1/webhooks/{id}"))?).await.map(drop)
    }

    /// The newest messages to a webhook, sent or waiting.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn deliveries(&self, id: &WebhookId) -> Result<List<DeliveryView>> {
        json(self.request(Method::GET, &format!("/v1/webhooks/{id}/deliveries"))?).await
    }

    /// Sends a message to a webhook again.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn replay_delivery(&self, id: &WebhookId, delivery: &DeliveryId) -> Result<DeliveryView> {
        json(self.request(Method::POST, &format!("/v1/webhooks/{id}/deliveries/{delivery}/replay"))?).await
    }
}
