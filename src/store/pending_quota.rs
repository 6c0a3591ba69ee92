//! The bytes of pending uploads, per tenant.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use relume_api::TenantId;

/// The bytes of pending uploads, per tenant.
#[derive(Debug, Clone, Default)]
pub(super) struct PendingQuota(Arc<Mutex<PendingBytes>>);

#[derive(Debug, Default)]
struct PendingBytes {
    all: u64,
    of_tenants: HashMap<TenantId, u64>,
}

impl PendingQuota {
    /// Bytes of all tenants.
    pub(super) fn all(&self) -> u64 {
        self.sums().all
    }

    /// Opens an empty reservation.
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

    /// The tenant.
    pub(super) fn tenant(&self) -> &TenantId {
        &self.tenant
    }

    /// The number of reserved bytes.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Releases `bytes`.
    pub(super) fn release(&mut self, bytes: u64) {
        self.set(self.bytes.saturating_sub(bytes));
    }

    /// Releases the bytes beyond `bytes`.
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
