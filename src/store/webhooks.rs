//! Webhooks of tenants. Secrets are stored in plain text, because the server signs with them.

use sqlx::FromRow;
use sqlx::types::Json;

use crate::store::page::paginated;
use crate::store::{Page, Store, StoreError, sql};
use relume_api::webhooks::{WebhookChange, WebhookEvent};
use relume_api::{KeyId, TenantId, WebhookId};

/// Maximum number of webhooks of a tenant.
const MAX_WEBHOOKS: i64 = 16;

/// A webhook.
#[derive(Clone, FromRow)]
pub struct WebhookRecord {
    /// Identifier.
    pub id: WebhookId,
    /// The tenant.
    pub tenant: TenantId,
    /// The URL to which messages are sent.
    pub url: String,
    /// The subscribed events.
    #[sqlx(json)]
    pub events: Vec<WebhookEvent>,
    /// Descriptive name.
    pub name: Option<String>,
    /// The secret that signs its messages.
    pub secret: Vec<u8>,
    /// The former secret, which also signs until `former_until_ms`.
    pub former_secret: Option<Vec<u8>>,
    /// End of the validity of the former secret.
    pub former_until_ms: Option<i64>,
    /// The key of the creator.
    pub made_by: Option<KeyId>,
    /// Time of creation.
    pub created_ms: i64,
    /// Whether messages are sent.
    pub enabled: bool,
    /// Time of the first failure since the last successful delivery, if the last attempt failed.
    pub failing_since_ms: Option<i64>,
    /// Time at which the server disabled the webhook.
    pub switched_off_ms: Option<i64>,
    /// Reason why the server disabled the webhook.
    pub switched_off_because: Option<String>,
}

paginated!(WebhookRecord: created_ms);

impl WebhookRecord {
    /// The secrets that sign at `now_ms`: the current one and, while it is valid, the former one.
    pub fn secrets(&self, now_ms: i64) -> impl Iterator<Item = &[u8]> {
        let former = self.former_until_ms.is_some_and(|until| now_ms < until);
        let former = self.former_secret.as_deref().filter(|_| former);
        std::iter::once(self.secret.as_slice()).chain(former)
    }
}

/// Omits the secrets.
impl std::fmt::Debug for WebhookRecord {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut shown = f.debug_struct("WebhookRecord");
        shown
            .field("id", &self.id)
            .field("tenant", &self.tenant)
            .field("url", &self.url)
            .finish_non_exhaustive()
    }
}

impl Store {
    /// Creates a webhook.
    ///
    /// # Errors
    /// [`StoreError::TooManyWebhooks`] if the tenant has reached its limit. When the database fails.
    pub async fn create_webhook(&self, webhook: &WebhookRecord) -> Result<WebhookRecord, StoreError> {
        let mut tx = self.write().await?;
        let made = sql::query_as(
            "INSERT INTO webhooks (id, tenant, url, events, name, secret, made_by, created_ms, enabled)
             SELECT $1, $2, $3, $4, $5, $6, $7, $8, $9
             WHERE (SELECT COUNT(*) FROM webhooks WHERE tenant = $2) < $10 RETURNING *",
        )
        .bind(&webhook.id)
        .bind(&webhook.tenant)
        .bind(&webhook.url)
        .bind(Json(&webhook.events))
        .bind(&webhook.name)
        .bind(&webhook.secret)
        .bind(&webhook.made_by)
        .bind(webhook.created_ms)
        .bind(webhook.enabled)
        .bind(MAX_WEBHOOKS)
        .fetch_optional(&mut tx)
        .await?
        .ok_or(StoreError::TooManyWebhooks { most: MAX_WEBHOOKS })?;
        tx.commit().await?;
        Ok(made)
    }

    /// A webhook of a tenant by identifier.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn webhook(
        &self,
        tenant: &TenantId,
        id: &WebhookId,
    ) -> Result<Option<WebhookRecord>, StoreError> {
        let query = sql::query_as("SELECT * FROM webhooks WHERE id = $1 AND tenant = $2");
        Ok(query.bind(id).bind(tenant).fetch_optional(self.pool()).await?)
    }

    /// Webhooks of a tenant, newest first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn webhooks(&self, tenant: &TenantId, page: &Page) -> Result<Vec<WebhookRecord>, StoreError> {
        let query = sql::query_as(
            "SELECT * FROM webhooks
             WHERE tenant = $2
               AND ($1 IS NULL OR (created_ms, id) < ($4, $1))
             ORDER BY created_ms DESC, id DESC LIMIT $3",
        );
        let query = query.bind(page.id()).bind(tenant).bind(i64::from(page.limit)).bind(page.at());
        Ok(query.fetch_all(self.pool()).await?)
    }

    /// Changes a webhook of a tenant. Enabling a webhook clears its recorded failures.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn change_webhook(
        &self,
        tenant: &TenantId,
        id: &WebhookId,
        change: &WebhookChange,
    ) -> Result<Option<WebhookRecord>, StoreError> {
        let mut tx = self.write().await?;
        let changed = sql::query_as(
            "UPDATE webhooks SET url = COALESCE($3, url), events = COALESCE($4, events),
                 name = COALESCE($5, name), enabled = COALESCE($6, enabled),
                 failing_since_ms = CASE WHEN $6 THEN NULL ELSE failing_since_ms END,
                 switched_off_ms = CASE WHEN $6 THEN NULL ELSE switched_off_ms END,
                 switched_off_because = CASE WHEN $6 THEN NULL ELSE switched_off_because END
             WHERE id = $1 AND tenant = $2 RETURNING *",
        )
        .bind(id)
        .bind(tenant)
        .bind(&change.url)
        .bind(change.events.as_ref().map(Json))
        .bind(&change.name)
        .bind(change.enabled)
        .fetch_optional(&mut tx)
        .await?;
        tx.commit().await?;
        Ok(changed)
    }

    /// Replaces the secret of a webhook of a tenant. The current secret also signs until `former_until_ms`.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn rotate_webhook_secret(
        &self,
        tenant: &TenantId,
        id: &WebhookId,
        secret: &[u8],
        former_until_ms: i64,
    ) -> Result<Option<WebhookRecord>, StoreError> {
        let mut tx = self.write().await?;
        let rotated = sql::query_as(
            "UPDATE webhooks SET former_secret = secret, former_until_ms = $4, secret = $3
             WHERE id = $1 AND tenant = $2 RETURNING *",
        );
        let rotated = rotated.bind(id).bind(tenant).bind(secret).bind(former_until_ms);
        let rotated = rotated.fetch_optional(&mut tx).await?;
        tx.commit().await?;
        Ok(rotated)
    }

    /// Deletes a webhook of a tenant and its deliveries; `false` if it does not exist.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn delete_webhook(&self, tenant: &TenantId, id: &WebhookId) -> Result<bool, StoreError> {
        let mut tx = self.write().await?;
        let deliveries = "DELETE FROM deliveries
             WHERE webhook_id = (SELECT id FROM webhooks WHERE id = $1 AND tenant = $2)";
        sql::query(deliveries).bind(id).bind(tenant).execute(&mut tx).await?;
        let query = sql::query("DELETE FROM webhooks WHERE id = $1 AND tenant = $2");
        let deleted = query.bind(id).bind(tenant).execute(&mut tx).await?;
        tx.commit().await?;
        Ok(deleted == 1)
    }
}
