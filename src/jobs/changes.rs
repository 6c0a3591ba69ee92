//! Notifications of changed jobs: to those who wait for any job, and to the listeners of one job.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::watch;

use relume_api::JobId;

/// The receivers of notifications. A change of one job does not wake the listeners of other jobs.
pub(super) struct JobChanges {
    any: watch::Sender<()>,
    by_job: Mutex<HashMap<JobId, watch::Sender<()>>>,
}

impl JobChanges {
    pub(super) fn new() -> Self {
        Self { any: watch::Sender::new(()), by_job: Mutex::default() }
    }

    /// Notifies of changes of any job.
    pub(super) fn subscribe(&self) -> watch::Receiver<()> {
        self.any.subscribe()
    }

    /// Notifies of changes of one job.
    pub(super) fn subscribe_to(&self, job: &JobId) -> watch::Receiver<()> {
        let mut by_job = self.lock();
        by_job.retain(|_, listeners| listeners.receiver_count() > 0);
        by_job.entry(job.clone()).or_insert_with(|| watch::Sender::new(())).subscribe()
    }

    /// `job` has changed.
    pub(super) fn announce(&self, job: &JobId) {
        self.any.send_replace(());
        if let Some(listeners) = self.lock().get(job) {
            listeners.send_replace(());
        }
    }

    /// Any job may have changed.
    pub(super) fn announce_all(&self) {
        self.any.send_replace(());
        for listeners in self.lock().values() {
            listeners.send_replace(());
        }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<JobId, watch::Sender<()>>> {
        self.by_job.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_wakes_only_the_listeners_of_its_job() {
        let changes = JobChanges::new();
        let [first, second] = ["first", "second"].map(|id| JobId::from(id.to_owned()));
        let (any, one, same, other) = (
            changes.subscribe(),
            changes.subscribe_to(&first),
            changes.subscribe_to(&first),
            changes.subscribe_to(&second),
        );
        changes.announce(&first);
        let woken = [&any, &one, &same, &other].map(|listener| listener.has_changed().unwrap());
        assert_eq!(woken, [true, true, true, false]);
        changes.announce_all();
        assert!(other.has_changed().unwrap(), "the control: a change of an unknown job wakes all");
    }

    #[test]
    fn jobs_without_listeners_are_forgotten() {
        let changes = JobChanges::new();
        let [first, second] = ["first", "second"].map(|id| JobId::from(id.to_owned()));
        drop(changes.subscribe_to(&first));
        let _second = changes.subscribe_to(&second);
        assert_eq!(changes.lock().keys().collect::<Vec<_>>(), [&second]);
    }
}
