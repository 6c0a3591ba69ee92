//! What is on its way to the store, of whom.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use relume_api::TenantId;

/// What is on its way, of whom.
#[derive(Debug, Clone, Default)]
pub(super) struct PendingQuota(Arc<Mutex<PendingBytes>>);

#[derive(Debug, Default)]
struct PendingBytes {
    all: u64,
    of_tenants: HashMap<TenantId, u64>,
}

impl PendingQuota {
    /// Bytes of everybody.
    pub(super) fn all(&self) -> u64 {
        self.sums().all
    }

    /// A reservation of nothing yet.
    pub(super) fn open(&self, tenant: &TenantId) -> Reservation {
        Reservation { pending_quota: self.clone(), tenant: tenant.clone(), bytes: 0 }
    }

    /// Bytes of a tenant.
    pub(super) fn of(&self, tenant: &TenantId) -> u64 {
        self.sums().of_tenants.get(tenant).copied().unwrap_or(0)
    }

    fn sums(&self) -> MutexGuard<'_, PendingBytes> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Bytes of a tenant that count as stored until this is dropped.
#[derive(Debug)]
pub struct Reservation {
    pending_quota: PendingQuota,
    tenant: TenantId,
    bytes: u64,
}

impl Reservation {
    /// Changes how many bytes are reserved.
    pub(super) fn set(&mut self, bytes: u64) {
        let mut sums = self.pending_quota.sums();
        sums.all = sums.all - self.bytes + bytes;
        let own = sums.of_tenants.entry(self.tenant.clone()).or_default();
        *own = *own - self.bytes + bytes;
        if *own == 0 {
            sums.of_tenants.remove(&self.tenant);
        }
        self.bytes = bytes;
    }

    /// Whose they are.
    pub(super) fn tenant(&self) -> &TenantId {
        &self.tenant
    }

    /// How many they are.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Gives `bytes` back.
    pub(super) fn release(&mut self, bytes: u64) {
        self.set(self.bytes.saturating_sub(bytes));
    }

    /// Gives back what is reserved beyond `bytes`.
    pub(super) fn shrink_to(&mut self, bytes: u64) {
        if bytes < self.bytes {
            self.set(bytes);
        }
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.set(0);
    }
}
