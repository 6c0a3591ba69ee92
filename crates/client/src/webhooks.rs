//! Webhooks.

use reqwest::Method;

use crate::connection::{Client, checked, json};
use crate::error::Result;
use relume_api::webhooks::{CreatedWebhook, DeliveryView, NewWebhook, WebhookChange, WebhookView};
use relume_api::{DeliveryId, List, WebhookId};

impl Client {
    /// Creates a webhook. Only this response contains its secret.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn create_webhook(&self, webhook: &NewWebhook) -> Result<CreatedWebhook> {
        json(self.request(Method::POST, "/v1/webhooks")?.json(webhook)).await
    }

    /// The newest webhooks.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn webhooks(&self) -> Result<List<WebhookView>> {
        json(self.request(Method::GET, "/v1/webhooks")?).await
    }

    /// A webhook.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn webhook(&self, id: &WebhookId) -> Result<WebhookView> {
        json(self.request(Method::GET, &format!("/v1/webhooks/{id}"))?).await
    }

    /// Changes a webhook.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn change_webhook(&self, id: &WebhookId, change: &WebhookChange) -> Result<WebhookView> {
        json(self.request(Method::PATCH, &format!("/v1/webhooks/{id}"))?.json(change)).await
    }

    /// Replaces the secret of a webhook. Only this response contains the new secret. The previous secret also signs
    /// for 24 hours.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn rotate_webhook_secret(&self, id: &WebhookId) -> Result<CreatedWebhook> {
        json(self.request(Method::POST, &format!("/v1/webhooks/{id}/rotate-secret"))?).await
    }

    /// Deletes a webhook and its deliveries.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn delete_webhook(&self, id: &WebhookId) -> Result<()> {
        checked(self.request(Method::DELETE, &format!("/v1/webhooks/{id}"))?).await.map(drop)
    }

    /// The newest deliveries to a webhook, sent or pending.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn deliveries(&self, id: &WebhookId) -> Result<List<DeliveryView>> {
        json(self.request(Method::GET, &format!("/v1/webhooks/{id}/deliveries"))?).await
    }

    /// Sends a delivery to a webhook again.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn replay_delivery(&self, id: &WebhookId, delivery: &DeliveryId) -> Result<DeliveryView> {
        json(self.request(Method::POST, &format!("/v1/webhooks/{id}/deliveries/{delivery}/replay"))?).await
    }
}
