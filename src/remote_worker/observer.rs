//! Who is told what a worker does.

use std::sync::Arc;

use relume_api::jobs::JobProgress;
use relume_api::work::Task;

/// What a worker does.
#[derive(Debug, Clone, Copy)]
pub enum WorkerEvent<'a> {
    /// It begins to work on a job.
    Claimed(&'a Task),
    /// The training goes on.
    Progress(&'a JobProgress),
    /// Something to look out for.
    Warning(&'a str),
    /// The model is published.
    Published,
    /// The job has failed.
    Failed(&'a str),
    /// The job is in the queue again.
    Released,
    /// The job was cancelled.
    Cancelled,
}

/// Who is told what a worker does.
pub type Observer = Arc<dyn Fn(WorkerEvent<'_>) + Send + Sync>;
