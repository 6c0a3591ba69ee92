//! Reports the progress of a worker's jobs: as log lines for people, as progress lines for programs.

use std::sync::{Arc, Mutex, PoisonError};

use crate::cli::progress::{ProgressKind, ProgressReporter, StepProgress};
use crate::remote_worker::{Observer, WorkerEvent};
use relume_api::jobs::JobProgress;

/// An observer that reports in the format `kind`.
pub(super) fn progress_observer(kind: ProgressKind) -> Observer {
    if kind == ProgressKind::Human {
        return Arc::new(log);
    }
    // A new reporter is created for each job.
    let progress: Mutex<Option<ProgressReporter>> = Mutex::default();
    Arc::new(move |told| {
        let mut progress = progress.lock().unwrap_or_else(PoisonError::into_inner);
        if matches!(told, WorkerEvent::Claimed(_)) || progress.is_none() {
            *progress = ProgressReporter::new(kind).ok();
        }
        if let Some(progress) = progress.as_mut() {
            say(progress, told);
        }
    })
}

fn log(told: WorkerEvent<'_>) {
    match told {
        WorkerEvent::Claimed(task) => {
            tracing::info!(job = %task.job, attempt = task.attempt, "claimed a job")
        }
        WorkerEvent::Progress(progress) => {
            tracing::debug!(step = progress.step, total = progress.total, "training")
        }
        WorkerEvent::Warning(message) => tracing::warn!("{message}"),
        WorkerEvent::Published => tracing::info!("published the model"),
        WorkerEvent::Failed(detail) => tracing::warn!(detail, "the job failed"),
        WorkerEvent::Released => tracing::info!("returned the job to the queue"),
        WorkerEvent::Cancelled => tracing::info!("the job was cancelled"),
    }
}

fn say(progress: &mut ProgressReporter, told: WorkerEvent<'_>) {
    match told {
        WorkerEvent::Claimed(task) => progress.status(&format!("job {}, attempt {}", task.job, task.attempt)),
        WorkerEvent::Progress(report) => match step(report) {
            Some(step) => progress.step(&step),
            None => progress.status(report.message.as_deref().unwrap_or("working")),
        },
        WorkerEvent::Warning(message) => progress.warning(message),
        WorkerEvent::Published => progress.done("the model; it is published", &[]),
        WorkerEvent::Failed(detail) => progress.fail(detail),
        WorkerEvent::Released => progress.stopped("returned the job to the queue"),
        WorkerEvent::Cancelled => progress.stopped("the job was cancelled"),
    }
}

/// The step of a report, if it has one.
fn step(report: &JobProgress) -> Option<StepProgress> {
    Some(StepProgress {
        step: u32::try_from(report.step).ok()?,
        total: u32::try_from(report.total).ok()?,
        loss: report.loss?,
        psnr: report.psnr?,
        gaussians: usize::try_from(report.gaussians?).ok()?,
        eta_seconds: report.eta_seconds,
    })
}
