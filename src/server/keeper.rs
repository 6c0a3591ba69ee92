//! Looks after what is stored: deletes what was kept for long enough and removes the files of what was deleted.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::jobs::Jobs;
use crate::store::Retention;

/// Time between two looks when nobody asks for one.
const INTERVAL: Duration = Duration::from_secs(10);
/// The same while something deleted is still in use.
const WHILE_WAITING: Duration = Duration::from_millis(500);

/// Works until `stop` is cancelled; `wake` asks for a look at once.
pub(super) async fn keep(jobs: Jobs, retention: Retention, wake: Arc<Notify>, stop: CancellationToken) {
    loop {
        let pause = match jobs.tidy(&retention).await {
            Ok(swept) if swept.waiting > 0 => WHILE_WAITING,
            Ok(_) => INTERVAL,
            Err(error) => {
                tracing::error!(%error, "what was deleted cannot be swept yet");
                INTERVAL
            }
        };
        tokio::select! {
            () = stop.cancelled() => return,
            () = wake.notified() => {}
            () = tokio::time::sleep(pause) => {}
        }
    }
}
