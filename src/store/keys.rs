//! API keys. Rows are never removed: a revoked key still identifies a past caller, and a server that once had a key does not
//! become open again.

use std::path::Path;

use sqlx::types::Json;

use crate::store::database::{self, DatabaseFile, DatabaseServer, DatabaseUrl};
use crate::store::{KeyRecord, KeyToken, Page, Store, StoreError, sql};
use relume_api::keys::Scope;
use relume_api::{KeyId, TenantId};

/// An API key to create.
#[derive(Debug, Clone)]
pub struct NewKeyRecord {
    /// Descriptive name.
    pub name: String,
    /// The tenant.
    pub tenant: TenantId,
    /// The permitted scopes.
    pub scopes: Vec<Scope>,
    /// Expiry time.
    pub expires_ms: Option<i64>,
    /// The key of the creator. If that key is revoked, this one is revoked as well.
    pub made_by: Option<KeyId>,
}

impl Store {
    /// Creates a key. The returned text is the key for its bearer; the server stores only its hash.
    ///
    /// # Errors
    /// [`StoreError::KeyRevoked`] if the key of the creator is revoked. When the database fails, or the operating system provides
    /// no random bits.
    pub async fn create_key(
        &self,
        key: &NewKeyRecord,
        now_ms: i64,
    ) -> Result<(KeyRecord, String), StoreError> {
        let (token, text) = KeyToken::mint()?;
        let mut tx = self.write().await?;
        let stored = sql::query_as(
            "INSERT INTO keys (id, name, tenant, scopes, secret_sha256, created_ms, expires_ms, made_by)
             SELECT $1, $2, $3, $4, $5, $6, $7, $8
             WHERE $8 IS NULL OR EXISTS (SELECT 1 FROM keys WHERE id = $8 AND revoked_ms IS NULL)
             RETURNING *",
        )
        .bind(&token.id)
        .bind(&key.name)
        .bind(&key.tenant)
        .bind(Json(&key.scopes))
        .bind(&token.sha256)
        .bind(now_ms)
        .bind(key.expires_ms)
        .bind(&key.made_by)
        .fetch_optional(&mut tx)
        .await?
        .ok_or(StoreError::KeyRevoked)?;
        tx.commit().await?;
        Ok((stored, text))
    }

    /// A key of any tenant by identifier, to identify a caller.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn key_of_caller(&self, id: &KeyId) -> Result<Option<KeyRecord>, StoreError> {
        self.key(None, id).await
    }

    /// A key of the tenant `of`, or of any tenant if `None`.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn key(&self, of: Option<&TenantId>, id: &KeyId) -> Result<Option<KeyRecord>, StoreError> {
        let query = sql::query_as("SELECT * FROM keys WHERE id = $1 AND ($2 IS NULL OR tenant = $2)");
        Ok(query.bind(id).bind(of).fetch_optional(self.pool()).await?)
    }

    /// Keys of the tenant `of`, or of all tenants if `None`, newest first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn keys(&self, of: Option<&TenantId>, page: &Page) -> Result<Vec<KeyRecord>, StoreError> {
        let query = sql::query_as(
            "SELECT * FROM keys
             WHERE ($1 IS NULL OR (created_ms, id) < ($4, $1))
               AND ($2 IS NULL OR tenant = $2)
             ORDER BY created_ms DESC, id DESC LIMIT $3",
        );
        let query = query.bind(page.id()).bind(of).bind(i64::from(page.limit)).bind(page.at());
        Ok(query.fetch_all(self.pool()).await?)
    }

    /// Revokes a key of the tenant `of`, or of any tenant if `None`, and all keys that were created with it. The answer contains
    /// their identifiers. Keys that are already revoked are not changed.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn revoke_key(
        &self,
        of: Option<&TenantId>,
        id: &KeyId,
        now_ms: i64,
    ) -> Result<Option<(KeyRecord, Vec<KeyId>)>, StoreError> {
        let mut tx = self.write().await?;
        let query = sql::query_as(
            "UPDATE keys SET revoked_ms = COALESCE(revoked_ms, $3)
             WHERE id = $1 AND ($2 IS NULL OR tenant = $2) RETURNING *",
        );
        let key = query.bind(id).bind(of).bind(now_ms).fetch_optional(&mut tx).await?;
        let Some(key) = key else { return Ok(None) };
        let query = sql::query_scalar(
            "WITH RECURSIVE came (id) AS (
                 SELECT id FROM keys WHERE made_by = $1
                 UNION SELECT keys.id FROM keys JOIN came ON keys.made_by = came.id)
             UPDATE keys SET revoked_ms = COALESCE(revoked_ms, $2)
             WHERE id IN (SELECT id FROM came) RETURNING id",
        );
        let mut took_along: Vec<KeyId> = query.bind(id).bind(now_ms).fetch_all(&mut tx).await?;
        took_along.sort();
        tx.commit().await?;
        Ok(Some((key, took_along)))
    }

    /// Records the use of a key.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn record_key_use(&self, id: &KeyId, now_ms: i64) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        let query = sql::query("UPDATE keys SET last_used_ms = $2 WHERE id = $1");
        query.bind(id).bind(now_ms).execute(&mut tx).await?;
        Ok(tx.commit().await?)
    }

    /// Whether any key was ever created.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn any_key(&self) -> Result<bool, StoreError> {
        Ok(sql::query_scalar(ANY).fetch_one(self.pool()).await?)
    }
}

const ANY: &str = "SELECT EXISTS (SELECT 1 FROM keys)";

/// As [`Store::any_key`], for a data directory or a database server that is not opened as a store and not changed.
///
/// # Errors
/// When an existing database cannot be read.
pub async fn has_keys(root: &Path, database: Option<&DatabaseUrl>) -> Result<bool, StoreError> {
    if let Some(url) = database {
        return DatabaseServer::has(url, "keys", ANY).await;
    }
    if !root.join(database::FILE).exists() {
        return Ok(false);
    }
    let pool = DatabaseFile::open_read_only(root).await?;
    let table = "SELECT EXISTS (SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'keys')";
    let found = async {
        let there: bool = sql::query_scalar(table).fetch_one(&pool).await?;
        if there { sql::query_scalar(ANY).fetch_one(&pool).await } else { Ok(false) }
    };
    let found = found.await;
    pool.close().await;
    Ok(found?)
}
