//! What a worker says of its jobs: lines of the log for people, lines of progress for programs.

use std::sync::{Arc, Mutex, PoisonError};

use crate::api::jobs::JobProgress;
use crate::cli::progress::{Progress, ProgressKind, Step};
use crate::farm::{Observer, Told};

/// Tells whoever reads `kind`.
pub(super) fn teller(kind: ProgressKind) -> Observer {
    if kind == ProgressKind::Human {
        return Arc::new(log);
    }
    // Made anew for each job.
    let progress: Mutex<Option<Progress>> = Mutex::default();
    Arc::new(move |told| {
        let mut progress = progress.lock().unwrap_or_else(PoisonError::into_inner);
        if matches!(told, Told::Claimed(_)) || progress.is_none() {
            *progress = Progress::new(kind).ok();
        }
        if let Some(progress) = progress.as_mut() {
            say(progress, told);
        }
    })
}

fn log(told: Told<'_>) {
    match told {
        Told::Claimed(task) => tracing::info!(job = %task.job, attempt = task.attempt, "took a job"),
        Told::Progress(progress) => tracing::debug!(step = progress.step, total = progress.total, "trains"),
        Told::Warning(message) => tracing::warn!("{message}"),
        Told::Published => tracing::info!("published the model"),
        Told::Failed(detail) => tracing::warn!(detail, "the job failed"),
        Told::Released => tracing::info!("gave the job back"),
        Told::Cancelled => tracing::info!("the job was cancelled"),
    }
}

fn say(progress: &mut Progress, told: Told<'_>) {
    match told {
        Told::Claimed(task) => progress.status(&format!("job {}, attempt {}", task.job, task.attempt)),
        Told::Progress(report) => match step(report) {
            Some(step) => progress.step(&step),
            None => progress.status(report.message.as_deref().unwrap_or("working")),
        },
        Told::Warning(message) => progress.warning(message),
        Told::Published => progress.done("the model, which is published"),
        Told::Failed(detail) => progress.fail(detail),
        Told::Released => progress.stopped("gave the job back"),
        Told::Cancelled => progress.stopped("the job was cancelled"),
    }
}

/// A report of a step, if it is one.
fn step(report: &JobProgress) -> Option<Step> {
    Some(Step {
        step: u32::try_from(report.step).ok()?,
        total: u32::try_from(report.total).ok()?,
        loss: report.loss?,
        psnr: report.psnr?,
        gaussians: usize::try_from(report.gaussians?).ok()?,
        eta_seconds: report.eta_seconds,
    })
}
