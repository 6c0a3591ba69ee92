//! Tasks that only the first server of a database runs: garbage collection, webhooks, exports, and interrupted validations.

use std::time::Instant;

use tokio::task::JoinHandle;

use crate::server::app::AppState;
use crate::server::garbage_collector::GarbageCollector;
use crate::server::retention_pace::{RetentionPace, RetentionPacer};
use crate::server::webhooks::WebhookDispatcher;
use crate::server::{capture_creation, exports};
use crate::store::Retention;

/// Tasks that end when the server stops.
pub(super) struct BackgroundTasks {
    tasks: [(&'static str, JoinHandle<()>); 3],
}

impl BackgroundTasks {
    /// Starts the tasks.
    pub(super) fn begin(app: &AppState, retention: Retention, pace: RetentionPace) -> Self {
        let (jobs, stop) = (app.jobs.clone(), app.stop.clone());
        let pacer = RetentionPacer::new(pace, Instant::now());
        let garbage_collector =
            GarbageCollector { jobs: jobs.clone(), retention, pacer, thumbnails: app.thumbnails.clone() };
        let gc_task = tokio::spawn(garbage_collector.run(app.gc_wake.clone(), stop.clone()));
        let webhook_task = tokio::spawn(WebhookDispatcher::new(jobs, app.webhooks).run(stop));
        let export_task = tokio::spawn(exports::work(app.clone()));
        tokio::spawn(resume(app.clone()));
        let tasks = [
            ("the export task panicked", export_task),
            ("the webhook task panicked", webhook_task),
            ("the garbage collector panicked", gc_task),
        ];
        Self { tasks }
    }

    /// Waits for the end of the tasks.
    pub(super) async fn end(self) {
        for (otherwise, task) in self.tasks {
            if task.await.is_err() {
                tracing::error!("{otherwise}");
            }
        }
    }
}

/// Continues the validations that a terminated server had begun.
async fn resume(app: AppState) {
    app.poses.log_availability().await;
    if let Err(error) = capture_creation::resume(app).await {
        tracing::error!(%error, "cannot resume the validation of captures; the next start resumes it");
    }
}
