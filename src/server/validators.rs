//! Threads that validate captures. The first validation of a tenant runs at normal priority, its further ones at low priority.

use crate::server::decoders::Decoders;
use crate::server::problem::Problem;
use crate::server::tenant_slots::TenantSlots;
use relume_api::TenantId;

/// The validating threads of both priorities.
#[derive(Clone)]
pub(super) struct Validators {
    /// For the first validation of a tenant.
    prompt: Decoders,
    /// For validations that begin while the tenant has another one, at low priority.
    bulk: Decoders,
    first: TenantSlots,
}

impl Validators {
    /// Starts the threads; `memory` as in [`Decoders::start`].
    ///
    /// # Errors
    /// When threads cannot be started.
    pub(super) fn start(memory: u64) -> std::io::Result<Self> {
        let (prompt, bulk) = (Decoders::start(memory / 2)?, Decoders::start_at_low_priority(memory / 2)?);
        Ok(Self { prompt, bulk, first: TenantSlots::new(1) })
    }

    /// Runs `work` of `tenant`, as [`Decoders::run`].
    ///
    /// # Errors
    /// As [`Decoders::run`].
    pub(super) async fn run<T: Send + 'static>(
        &self,
        tenant: &TenantId,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        match self.first.take(tenant) {
            // The slot is held until the work has ended, also if the caller no longer waits.
            Some(slot) => {
                let work = move || {
                    let _slot = slot;
                    work()
                };
                self.prompt.run(tenant, work).await
            }
            None => self.bulk.run(tenant, work).await,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn further_validations_of_a_tenant_run_at_low_priority() {
        let validators = Validators::start(1 << 30).unwrap();
        let (a, b) = (TenantId::from("a"), TenantId::from("b"));
        let name = || std::thread::current().name().unwrap_or_default().to_owned();
        let (release, held) = std::sync::mpsc::channel::<()>();
        let mut first = Box::pin(validators.run(&a, move || held.recv().map(|()| name())));
        assert!(futures::poll!(&mut first).is_pending());
        assert_eq!(validators.run(&a, name).await.unwrap(), "decoder-low-0");
        release.send(()).unwrap();
        assert_eq!(first.await.unwrap().unwrap(), "decoder-0");
        assert_eq!(validators.run(&b, name).await.unwrap(), "decoder-0", "another tenant");
        assert_eq!(validators.run(&a, name).await.unwrap(), "decoder-0", "the first one has ended");
    }
}
