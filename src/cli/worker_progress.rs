//! What a worker says of its jobs: lines of the log for people, lines of progress for programs.

use std::sync::{Arc, Mutex, PoisonError};

use crate::cli::progress::{ProgressKind, ProgressReporter, StepProgress};
use crate::remote_worker::{Observer, WorkerEvent};
use relume_api::jobs::JobProgress;

/// Tells whoever reads `kind`.
pub(super) fn progress_observer(kind: ProgressKind) -> Observer {
    if kind == ProgressKind::Human {
        return Arc::new(log);
    }
    // Made anew for each job.
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
        WorkerEvent::Claimed(task) => tracing::info!(job = %task.job, attempt = task.attempt, "took a job"),
        WorkerEvent::Progress(progress) => {
            tracing::debug!(step = progress.step, total = progress.total, "trains")
        }
        WorkerEvent::Warning(message) => tracing::warn!("{message}"),
        WorkerEvent::Published => tracing::info!("published the model"),
        WorkerEvent::Failed(detail) => tracing::warn!(detail, "the job failed"),
        WorkerEvent::Released => tracing::info!("gave the job back"),
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
        WorkerEvent::Published => progress.done("the model, which is published"),
        WorkerEvent::Failed(detail) => progress.fail(detail),
        WorkerEvent::Released => progress.stopped("gave the job back"),
        WorkerEvent::Cancelled => progress.stopped("the job was cancelled"),
    }
}

/// A report of a step, if it is one.
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
