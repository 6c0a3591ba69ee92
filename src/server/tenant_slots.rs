//! Concurrency limits per tenant, so that no tenant can use all slots of a group of routes.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::extract::{Request, State};
use axum::http::StatusCode;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::server::caller::Caller;
use crate::server::problem::Problem;
use relume_api::TenantId;

/// The used slots of each tenant.
#[derive(Clone)]
pub(super) struct TenantSlots {
    per_tenant: usize,
    taken: Arc<Mutex<HashMap<TenantId, usize>>>,
}

/// A slot, held until this is dropped.
pub(super) struct TenantSlot {
    tenant_slots: TenantSlots,
    tenant: TenantId,
}

impl TenantSlots {
    /// Permits at most `per_tenant` held slots of each tenant.
    pub(super) fn new(per_tenant: usize) -> Self {
        Self { per_tenant, taken: Arc::default() }
    }

    /// Takes a slot, unless the tenant has reached its limit.
    pub(super) fn take(&self, tenant: &TenantId) -> Option<TenantSlot> {
        let mut taken = self.taken();
        let count = taken.entry(tenant.clone()).or_default();
        if *count >= self.per_tenant {
            return None;
        }
        *count += 1;
        drop(taken);
        Some(TenantSlot { tenant_slots: self.clone(), tenant: tenant.clone() })
    }

    fn taken(&self) -> MutexGuard<'_, HashMap<TenantId, usize>> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for TenantSlot {
    fn drop(&mut self) {
        let mut taken = self.tenant_slots.taken();
        if let Some(count) = taken.get_mut(&self.tenant) {
            *count -= 1;
            if *count == 0 {
                taken.remove(&self.tenant);
            }
        }
    }
}

/// Refuses a request if its tenant has reached the limit. On a server without keys all callers are one tenant, so only the limit
/// of all requests applies.
pub(super) async fn limit_per_tenant(
    State(tenant_slots): State<TenantSlots>,
    request: Request,
    next: Next,
) -> Response {
    let tenant = request.extensions().get::<Caller>().filter(|caller| caller.has_key);
    let Some(tenant) = tenant.map(|caller| caller.tenant.clone()) else { return next.run(request).await };
    match tenant_slots.take(&tenant) {
        Some(_slot) => next.run(request).await,
        None => {
            let title = "Too many requests of this kind are in progress";
            let detail = format!(
                "the tenant has reached its maximum of {} concurrent requests of this kind",
                tenant_slots.per_tenant
            );
            Problem::new(StatusCode::SERVICE_UNAVAILABLE, "busy", title)
                .detail(detail)
                .retry_after(1)
                .into_response()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tenant_slots_are_limited_separately_and_released() {
        let tenant_slots = TenantSlots::new(2);
        let (a, b) = (TenantId::from("a"), TenantId::from("b"));
        let held = [tenant_slots.take(&a), tenant_slots.take(&a)];
        assert!(held.iter().all(Option::is_some) && tenant_slots.take(&a).is_none());
        let other = tenant_slots.take(&b);
        assert!(other.is_some());
        drop(held);
        assert!(tenant_slots.take(&a).is_some());
        drop(other);
        assert!(tenant_slots.taken().is_empty(), "tenants without requests have no entry");
    }
}
