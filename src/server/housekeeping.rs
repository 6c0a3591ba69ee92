//! What one server of a database does beside answering: it removes what was deleted, tells webhooks, makes exports, and goes on with
//! validations.

use tokio::task::JoinHandle;

use crate::server::app::Shared;
use crate::server::exports;
use crate::server::keeper::Keeper;
use crate::server::validation;
use crate::server::webhooks::Courier;
use crate::store::Retention;

/// Tasks that end when the server stops.
pub(super) struct Housekeeping {
    tasks: [(&'static str, JoinHandle<()>); 3],
}

impl Housekeeping {
    /// Starts them.
    pub(super) fn begin(app: &Shared, retention: Retention) -> Self {
        let (jobs, stop) = (app.jobs.clone(), app.stop.clone());
        let keeper = Keeper { jobs: jobs.clone(), retention, thumbnails: app.thumbnails.clone() };
        let keeping = tokio::spawn(keeper.keep(app.tidy.clone(), stop.clone()));
        let telling = tokio::spawn(Courier::new(jobs, app.webhooks).work(stop));
        let exporting = tokio::spawn(exports::work(app.clone()));
        tokio::spawn(resume(app.clone()));
        let tasks = [
            ("exports could not be given back", exporting),
            ("webhooks could not be sent to the end", telling),
            ("what was deleted could not be swept to the end", keeping),
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
async fn resume(app: Shared) {
    app.poses.tell_the_log().await;
    if let Err(error) = validation::resume(app).await {
        tracing::error!(%error, "captures that were being validated stay so until the next start");
    }
}
