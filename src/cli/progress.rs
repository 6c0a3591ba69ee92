//! How a training says where it stands: to a person, or in lines that programs read.

use std::io::Write;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};

use crate::cli::error::CommandResult;

/// Lines for programs come no more often, but for the first and the last step.
const EVERY: Duration = Duration::from_secs(1);

/// Who reads it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum ProgressKind {
    /// A bar on a terminal, twenty lines elsewhere, on standard error.
    Human,
    /// A JSON object a line on standard output.
    Json,
    /// Lines of Open Job Description on standard output.
    Openjd,
}

/// What one step came to.
#[derive(Debug, Clone, Copy)]
pub(super) struct StepProgress {
    /// Steps done.
    pub step: u32,
    /// Steps in all.
    pub total: u32,
    /// The objective.
    pub loss: f64,
    /// PSNR on the step's photograph, dB.
    pub psnr: f64,
    /// Gaussians now.
    pub gaussians: usize,
    /// Expected time to the end; estimated by the pace so far where absent.
    pub eta_seconds: Option<f64>,
}

/// The progress of one training.
pub(super) struct ProgressReporter {
    kind: ProgressKind,
    bar: ProgressBar,
    /// The first step that was shown, and when.
    first: Option<(u32, Instant)>,
    printed: Option<Instant>,
}

impl ProgressReporter {
    /// Says nothing yet.
    pub(super) fn new(kind: ProgressKind) -> CommandResult<Self> {
        let bar = if kind == ProgressKind::Human { ProgressBar::new(0) } else { ProgressBar::hidden() };
        let style = "{bar:32} {pos}/{len} {per_sec:>12} eta {eta:>4}  {msg}";
        bar.set_style(ProgressStyle::with_template(style)?);
        Ok(Self { kind, bar, first: None, printed: None })
    }

    /// A step was done.
    pub(super) fn step(&mut self, step: &StepProgress) {
        if self.kind == ProgressKind::Human {
            return self.step_for_people(step);
        }
        let now = Instant::now();
        let (from, since) = *self.first.get_or_insert((step.step, now));
        let is_due = self.printed.is_none_or(|printed| now - printed >= EVERY);
        if !is_due && step.step < step.total {
            return;
        }
        self.printed = Some(now);
        let pace = (now - since).as_secs_f64() / f64::from(step.step.saturating_sub(from).max(1));
        let left = f64::from(step.total.saturating_sub(step.step));
        let eta = step.eta_seconds.or_else(|| (step.step > from).then_some(pace * left));
        match self.kind {
            ProgressKind::Json => print(&step_line(step, eta).to_string()),
            _ => {
                let percent = 100.0 * f64::from(step.step) / f64::from(step.total.max(1));
                let eta = eta.map_or(String::new(), |eta| format!(", {eta:.0} s left"));
                print(&format!("openjd_progress: {:.1}", percent.min(100.0)));
                print(&format!(
                    "openjd_status: step {} of {}: {}{eta}",
                    step.step,
                    step.total,
                    summary(step)
                ));
            }
        }
    }

    fn step_for_people(&self, step: &StepProgress) {
        let bar = &self.bar;
        // Without a terminal there is no bar: twenty lines go to the log instead.
        if bar.is_hidden() && step.step.is_multiple_of((step.total / 20).max(1)) {
            eprintln!("step {}/{}  {}", step.step, step.total, summary(step));
        }
        bar.set_length(u64::from(step.total));
        bar.set_position(u64::from(step.step));
        bar.set_message(summary(step));
    }

    /// What is being done now.
    pub(super) fn status(&self, text: &str) {
        self.say("status", text);
    }

    /// Something that the user should know.
    pub(super) fn warning(&self, text: &str) {
        match self.kind {
            ProgressKind::Human => self.bar.suspend(|| eprintln!("warning: {text}")),
            ProgressKind::Json => print(&json!({ "event": "warning", "text": text }).to_string()),
            ProgressKind::Openjd => print(&format!("openjd_status: warning: {}", one_line(text))),
        }
    }

    /// It was stopped before its end, and what was done is kept.
    pub(super) fn stopped(&self, text: &str) {
        self.say("stopped", text);
    }

    /// It has failed. People are told by the caller, with the error on standard error.
    pub(super) fn fail(&self, text: &str) {
        match self.kind {
            ProgressKind::Human => {}
            ProgressKind::Json => print(&json!({ "event": "failed", "error": text }).to_string()),
            ProgressKind::Openjd => print(&format!("openjd_fail: {}", one_line(text))),
        }
    }

    /// It is done; `wrote` names the file or the model that came of it.
    pub(super) fn done(&self, wrote: &str) {
        match self.kind {
            ProgressKind::Human => {
                self.bar.finish();
                eprintln!("wrote {wrote}");
            }
            ProgressKind::Json => print(&json!({ "event": "done", "wrote": wrote }).to_string()),
            ProgressKind::Openjd => {
                print("openjd_progress: 100.0");
                print(&format!("openjd_status: wrote {}", one_line(wrote)));
            }
        }
    }

    fn say(&self, event: &str, text: &str) {
        match self.kind {
            ProgressKind::Human => self.bar.suspend(|| eprintln!("{text}")),
            ProgressKind::Json => print(&json!({ "event": event, "text": text }).to_string()),
            ProgressKind::Openjd => print(&format!("openjd_status: {}", one_line(text))),
        }
    }
}

/// The line of a step; what is not a number is `null`.
fn step_line(step: &StepProgress, eta: Option<f64>) -> Value {
    let rounded = |value: f64, parts: f64| (value * parts).round() / parts;
    json!({
        "event": "step",
        "step": step.step,
        "total": step.total,
        "loss": rounded(step.loss, 1e6),
        "psnr": rounded(step.psnr, 1e3),
        "gaussians": step.gaussians,
        "eta_seconds": eta.map(|eta| rounded(eta, 10.0)),
    })
}

fn summary(step: &StepProgress) -> String {
    format!("loss {:.4}  PSNR {:.2} dB  {} Gaussians", step.loss, step.psnr, step.gaussians)
}

/// A message of the protocol ends with its line.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A reader that has gone does not end a training.
fn print(line: &str) {
    let _ = writeln!(std::io::stdout(), "{line}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_step_has_null_for_numbers_that_are_not_finite() {
        let step = StepProgress {
            step: 3,
            total: 9,
            loss: 0.123_456_78,
            psnr: f64::NAN,
            gaussians: 64,
            eta_seconds: None,
        };
        let line = json!({ "event": "step", "step": 3, "total": 9, "loss": 0.123_457, "psnr": null,
            "gaussians": 64, "eta_seconds": 1.5 });
        assert_eq!(step_line(&step, Some(1.52)), line);
        assert_eq!(step_line(&step, None)["eta_seconds"], Value::Null);
    }

    #[test]
    fn messages_are_written_on_one_line() {
        assert_eq!(one_line("no room\n  on the disk\r\n"), "no room on the disk");
    }
}
