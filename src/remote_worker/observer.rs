//! Observers of a worker's activity.

use std::sync::Arc;

use relume_api::jobs::JobProgress;
use relume_api::work::Task;

/// An event of a worker.
#[derive(Debug, Clone, Copy)]
pub enum WorkerEvent<'a> {
    /// It has claimed a job.
    Claimed(&'a Task),
    /// Progress of the training.
    Progress(&'a JobProgress),
    /// A warning.
    Warning(&'a str),
    /// The model is published.
    Published,
    /// The job has failed.
    Failed(&'a str),
    /// The job was returned to the queue.
    Released,
    /// The job was cancelled.
    Cancelled,
}

/// A callback for the events of a worker.
pub type Observer = Arc<dyn Fn(WorkerEvent<'_>) + Send + Sync>;
