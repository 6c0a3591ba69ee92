//! How many requests of one kind a tenant has in progress, so that no tenant takes every place.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::extract::{Request, State};
use axum::http::StatusCode;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::api::{Problem, TenantId};
use crate::server::caller::Caller;

/// The places of each tenant.
#[derive(Clone)]
pub(super) struct Places {
    each: usize,
    taken: Arc<Mutex<HashMap<TenantId, usize>>>,
}

/// A place until this is dropped.
struct Place {
    places: Places,
    tenant: TenantId,
}

impl Places {
    /// At most `each` requests of each tenant.
    pub(super) fn new(each: usize) -> Self {
        Self { each, taken: Arc::default() }
    }

    fn take(&self, tenant: &TenantId) -> Option<Place> {
        let mut taken = self.taken();
        let count = taken.entry(tenant.clone()).or_default();
        if *count >= self.each {
            return None;
        }
        *count += 1;
        drop(taken);
        Some(Place { places: self.clone(), tenant: tenant.clone() })
    }

    fn taken(&self) -> MutexGuard<'_, HashMap<TenantId, usize>> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut taken = self.places.taken();
        if let Some(count) = taken.get_mut(&self.tenant) {
            *count -= 1;
            if *count == 0 {
                taken.remove(&self.tenant);
            }
        }
    }
}

/// Turns a request away when its tenant has as many in progress as it may. On a server without keys everybody is one tenant, and
/// the bound of all is the only one.
pub(super) async fn share(State(places): State<Places>, request: Request, next: Next) -> Response {
    let tenant = request.extensions().get::<Caller>().filter(|caller| caller.has_key);
    let Some(tenant) = tenant.map(|caller| caller.tenant.clone()) else { return next.run(request).await };
    match places.take(&tenant) {
        Some(_place) => next.run(request).await,
        None => {
            let title = "Too many requests of this kind are in progress";
            let detail =
                format!("your tenant has {} of them in progress, which is all it may have", places.each);
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
    fn a_tenant_takes_its_own_places_and_gives_them_back() {
        let places = Places::new(2);
        let (a, b) = (TenantId::from("a"), TenantId::from("b"));
        let held = [places.take(&a), places.take(&a)];
        assert!(held.iter().all(Option::is_some) && places.take(&a).is_none());
        let other = places.take(&b);
        assert!(other.is_some());
        drop(held);
        assert!(places.take(&a).is_some());
        drop(other);
        assert!(places.taken().is_empty(), "nothing is kept of tenants that have none");
    }
}
