//! What one server of a database does beside answering: it removes what was deleted, tells webhooks, makes exports, and goes on with
//! validations.

use tokio::task::JoinHandle;

use crate::server::app::AppState;
use crate::server::exports;
use crate::server::garbage_collector::GarbageCollector;
use crate::server::validation;
use crate::server::webhooks::WebhookDispatcher;
use crate::store::Retention;

/// Tasks that end when the server stops.
pub(super) struct BackgroundTasks {
    tasks: [(&'static str, JoinHandle<()>); 3],
}

impl BackgroundTasks {
    /// Starts them.
    pub(super) fn begin(app: &AppState, retention: Retention) -> Self {
        let (jobs, stop) = (app.jobs.clone(), app.stop.clone());
        let garbage_collector =
            GarbageCollector { jobs: jobs.clone(), retention, thumbnails: app.thumbnails.clone() };
        let gc_task = tokio::spawn(garbage_collector.run(app.gc_wake.clone(), stop.clone()));
        let webhook_task = tokio::spawn(WebhookDispatcher::new(jobs, app.webhooks).run(stop));
        let export_task = tokio::spawn(exports::work(app.clone()));
        tokio::spawn(resume(app.clone()));
        let tasks = [
            ("exports could not be given back", export_task),
            ("webhooks could not be sent to the end", webhook_task),
            ("what was deleted could not be swept to the end", gc_task),
        ];
        Self { tasks }
    }

    /// Waits for their end.
    pub(super) async fn end(self) {
        for (otherwise, task) in self.tasks {
            if task.await.is_err() {
                tracing::error!("{otherwise}");
            }
        }
    }
}

/// Goes on with what was being validated when a server ended.
async fn resume(app: AppState) {
    app.poses.log_availability().await;
    if let Err(error) = validation::resume(app).await {
        tracing::error!(%error, "captures that were being validated stay so until the next start");
    }
}
