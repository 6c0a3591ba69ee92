//! Identifies callers by the keys of the configuration and of the database.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use subtle::ConstantTimeEq;

use crate::jobs::Clock;
use crate::server::auth::ApiKeys;
use crate::server::caller::{CONFIGURED, Caller, NO_KEY};
use crate::store::{KeyRecord, KeyToken, Store, StoreError, hex};
use relume_api::keys::Scope;
use relume_api::{KeyId, TenantId};

/// The use of a key is recorded at most once in this time.
const RECORD_INTERVAL_MS: i64 = 60_000;

/// All keys of a server.
pub(super) struct Keyring {
    configured: ApiKeys,
    store: Store,
    clock: Arc<dyn Clock>,
    /// True after any key was seen. Keys are never removed, so a running server does not become open.
    has_keys: AtomicBool,
    /// Time of the last recorded use of each key.
    recorded_uses: Mutex<HashMap<KeyId, i64>>,
}

impl Keyring {
    pub(super) fn new(configured: ApiKeys, store: Store, clock: Arc<dyn Clock>) -> Self {
        let has_keys = AtomicBool::new(!configured.is_empty());
        Self { configured, store, clock, has_keys, recorded_uses: Mutex::default() }
    }

    /// Whether callers without a key are permitted: until the first key is created.
    pub(super) async fn is_open(&self) -> Result<bool, StoreError> {
        if !self.has_keys.load(Ordering::Relaxed) && self.store.any_key().await? {
            self.has_keys.store(true, Ordering::Relaxed);
        }
        Ok(!self.has_keys.load(Ordering::Relaxed))
    }

    /// The caller with this key, or without a key.
    pub(super) async fn caller(&self, key: Option<&str>) -> Result<Option<Caller>, StoreError> {
        if let Some(index) = key.and_then(|key| self.configured.index(key)) {
            return Ok(self.configured(index));
        }
        if let Some(token) = key.and_then(KeyToken::parse)
            && let Some(record) = self.store.key_of_caller(&token.id).await?
        {
            let now_ms = self.clock.now_ms();
            let same: bool = record.secret_sha256.as_bytes().ct_eq(token.sha256.as_bytes()).into();
            return Ok((same && record.is_valid(now_ms)).then(|| {
                self.record_use(&record.id, record.last_used_ms, now_ms);
                stored(record)
            }));
        }
        Ok(self.is_open().await?.then(Caller::without_key))
    }

    /// The owner of the key with this identifier, if the key is valid.
    pub(super) async fn bearer_of(&self, id: &str) -> Result<Option<Caller>, StoreError> {
        if let Some(number) = id.strip_prefix(CONFIGURED) {
            let index = number.parse().ok().and_then(|number: usize| number.checked_sub(1));
            return Ok(index.and_then(|index| self.configured(index)));
        }
        if id == NO_KEY {
            return Ok(self.is_open().await?.then(Caller::without_key));
        }
        let (found, now_ms) = (self.store.key_of_caller(&id.into()).await?, self.clock.now_ms());
        Ok(found.filter(|record| record.is_valid(now_ms)).map(stored))
    }

    /// Records the use of a signed URL as a use of its key.
    pub(super) fn record_signed_use(&self, caller: &Caller) {
        if caller.has_stored_key() {
            self.record_use(&caller.key, None, self.clock.now_ms());
        }
    }

    pub(super) fn now_ms(&self) -> i64 {
        self.clock.now_ms()
    }

    /// The owner of a key from the configuration.
    fn configured(&self, index: usize) -> Option<Caller> {
        Some(Caller {
            tenant: TenantId::of_operator(),
            scopes: Scope::ALL.to_vec(),
            key: format!("{CONFIGURED}{}", index + 1).into(),
            key_hash: hex(self.configured.hash(index)?),
            expires_ms: None,
            has_key: true,
            signed_under: None,
        })
    }

    /// Records the use of a key, at most once a minute and in the background.
    fn record_use(&self, id: &KeyId, last_used_ms: Option<i64>, now_ms: i64) {
        let mut recorded_uses = self.recorded_uses.lock().unwrap_or_else(PoisonError::into_inner);
        let last = recorded_uses.get(id).copied().max(last_used_ms);
        if last.is_some_and(|last| now_ms - last < RECORD_INTERVAL_MS) {
            return;
        }
        recorded_uses.insert(id.clone(), now_ms);
        let (store, id) = (self.store.clone(), id.clone());
        tokio::spawn(async move {
            if let Err(error) = store.record_key_use(&id, now_ms).await {
                tracing::warn!(%error, key = %id, "cannot record the use of a key");
            }
        });
    }
}

fn stored(record: KeyRecord) -> Caller {
    Caller {
        tenant: record.tenant,
        scopes: record.scopes,
        key: record.id,
        key_hash: record.secret_sha256,
        expires_ms: record.expires_ms,
        has_key: true,
        signed_under: None,
    }
}
