//! A lock that tenants take in turns.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::oneshot;

use crate::server::tenant_queue::TenantQueue;
use relume_api::TenantId;

/// A lock for one holder. Whoever waits for it waits for at most one holder of every other tenant.
#[derive(Clone, Default)]
pub(super) struct TenantTurns(Arc<Mutex<TurnState>>);

#[derive(Default)]
struct TurnState {
    is_taken: bool,
    waiting: TenantQueue<oneshot::Sender<Turn>>,
}

/// The lock, held until this is dropped.
pub(super) struct Turn(TenantTurns);

impl TenantTurns {
    /// Waits for the turn of `tenant`. A caller that stops waiting loses its place.
    pub(super) async fn turn(&self, tenant: &TenantId) -> Turn {
        loop {
            let turn = {
                let mut state = self.state();
                if !state.is_taken {
                    state.is_taken = true;
                    return Turn(self.clone());
                }
                let (sender, turn) = oneshot::channel();
                state.waiting.push(tenant, sender);
                turn
            };
            // The sender is dropped only after it has sent the turn.
            if let Ok(turn) = turn.await {
                return turn;
            }
        }
    }

    fn state(&self) -> MutexGuard<'_, TurnState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        let mut state = self.0.state();
        let next = std::iter::from_fn(|| state.waiting.pop()).find(|sender| !sender.is_closed());
        state.is_taken = next.is_some();
        drop(state);
        if let Some(next) = next {
            // If the receiver has stopped waiting since, dropping the turn gives it to the next.
            drop(next.send(Turn(self.0.clone())));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn tenants_take_turns_and_callers_that_left_are_skipped() {
        let turns = TenantTurns::default();
        let (a, b) = (TenantId::from("a"), TenantId::from("b"));
        let order = Mutex::new(Vec::new());
        let held = turns.turn(&a).await;
        let take = async |name: &'static str, tenant| {
            let _turn = turns.turn(tenant).await;
            order.lock().unwrap().push(name);
        };
        let callers = [("a1", &a), ("a2", &a), ("a3", &a), ("b1", &b)];
        let mut waiting: Vec<_> = callers.map(|(name, tenant)| Box::pin(take(name, tenant))).into();
        // The first poll queues a caller.
        for caller in &mut waiting {
            assert!(futures::poll!(caller).is_pending());
        }
        drop(waiting.remove(1));
        drop(held);
        futures::future::join_all(waiting).await;
        assert_eq!(*order.lock().unwrap(), ["a1", "b1", "a3"]);
        assert!(!turns.state().is_taken, "the lock is free after the last turn");
    }
}
