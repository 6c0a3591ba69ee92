//! The activity of a connection: idle, receiving the head of a request, or answering.

use std::sync::Arc;

use tokio::sync::watch;
use tokio::time::Instant;

use crate::server::connections::ConnectionLimits;

/// The activity of a connection.
pub(super) struct Activity(watch::Sender<ActivityState>);

#[derive(Debug, Clone, Copy)]
struct ActivityState {
    /// Number of requests that are being answered.
    requests: u32,
    /// Whether a part of a request's head has arrived.
    in_head: bool,
    /// Time at which this part began to arrive, or at which the connection became idle.
    since: Instant,
}

impl ActivityState {
    fn deadline(&self, limits: &ConnectionLimits) -> Option<Instant> {
        let allowed = if self.in_head { limits.head } else { limits.idle };
        (self.requests == 0).then(|| self.since + allowed)
    }
}

impl Activity {
    /// A new connection.
    pub(super) fn new() -> Arc<Self> {
        Arc::new(Self(watch::Sender::new(ActivityState {
            requests: 0,
            in_head: false,
            since: Instant::now(),
        })))
    }

    /// Records received bytes. Between requests they begin the head of the next one.
    pub(super) fn received(&self) {
        self.0.send_if_modified(|state| {
            let begins = state.requests == 0 && !state.in_head;
            if begins {
                *state = ActivityState { in_head: true, since: Instant::now(), ..*state };
            }
            begins
        });
    }

    /// Records a complete head. The connection is busy until the result is dropped.
    pub(super) fn begin(self: &Arc<Self>) -> Busy {
        self.0.send_modify(|state| {
            *state = ActivityState { requests: state.requests + 1, in_head: false, ..*state }
        });
        Busy(self.clone())
    }

    /// The time since which the server has nothing to answer on this connection; `None` while it has.
    pub(super) fn waiting_since(&self) -> Option<Instant> {
        let state = *self.0.borrow();
        (state.requests == 0).then_some(state.since)
    }

    /// Resolves when the connection has been idle, or receiving a head, for too long.
    pub(super) async fn overdue(&self, limits: &ConnectionLimits) {
        let mut changes = self.0.subscribe();
        loop {
            let deadline = changes.borrow_and_update().deadline(limits);
            let passed = async {
                match deadline {
                    Some(deadline) => tokio::time::sleep_until(deadline).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! { () = passed => return, _ = changes.changed() => {} }
        }
    }
}

/// A request that is being answered.
pub(super) struct Busy(Arc<Activity>);

impl Drop for Busy {
    fn drop(&mut self) {
        self.0.0.send_modify(|state| {
            *state = ActivityState { requests: state.requests - 1, in_head: false, since: Instant::now() };
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    const LIMITS: ConnectionLimits = ConnectionLimits {
        connections: 1,
        per_address: 1,
        head: Duration::from_secs(2),
        idle: Duration::from_secs(10),
        body: Duration::ZERO,
        body_rate: 0,
        write: Duration::ZERO,
    };

    /// Seconds until the connection is overdue, with a simulated clock.
    async fn seconds(activity: &Activity) -> u64 {
        let begin = Instant::now();
        activity.overdue(&LIMITS).await;
        begin.elapsed().as_secs()
    }

    #[tokio::test(start_paused = true)]
    async fn partial_heads_time_out_sooner_than_idle_connections() {
        let quiet = Activity::new();
        assert_eq!(seconds(&quiet).await, 10);
        let sending = Activity::new();
        sending.received();
        tokio::time::advance(Duration::from_secs(1)).await;
        sending.received();
        assert_eq!(seconds(&sending).await, 1);
    }

    #[tokio::test(start_paused = true)]
    async fn idle_timeout_is_paused_while_a_request_is_handled() {
        let activity = Activity::new();
        activity.received();
        let busy = activity.begin();
        assert!(activity.waiting_since().is_none());
        let hour = tokio::time::timeout(Duration::from_secs(3600), activity.overdue(&LIMITS)).await;
        assert!(hour.is_err());
        drop(busy);
        assert_eq!(seconds(&activity).await, 10);
    }
}
