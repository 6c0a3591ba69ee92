//! Reports the progress of a training, to a person or as lines for programs.

use std::io::Write;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};

use crate::cli::error::CommandResult;

/// Minimum interval between lines for programs, except for the first and the last step.
const EVERY: Duration = Duration::from_secs(1);

/// The format of progress reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum ProgressKind {
    /// A progress bar on a terminal, otherwise about 20 lines, on standard error.
    Human,
    /// One JSON object per line on standard output.
    Json,
    /// Lines of Open Job Description on standard output.
    Openjd,
}

/// The result of one step.
#[derive(Debug, Clone, Copy)]
pub(super) struct StepProgress {
    /// Completed steps.
    pub step: u32,
    /// Total steps.
    pub total: u32,
    /// The value of the objective.
    pub loss: f64,
    /// PSNR on the photograph of the step, dB.
    pub psnr: f64,
    /// Current number of Gaussians.
    pub gaussians: usize,
    /// Expected seconds to the end, if known.
    pub eta_seconds: Option<f64>,
}

/// Reports the progress of one training.
pub(super) struct ProgressReporter {
    kind: ProgressKind,
    bar: ProgressBar,
    printed: Option<Instant>,
}

impl ProgressReporter {
    /// Creates a reporter and prints nothing.
    pub(super) fn new(kind: ProgressKind) -> CommandResult<Self> {
        let bar = if kind == ProgressKind::Human { ProgressBar::new(0) } else { ProgressBar::hidden() };
        let style = "{bar:32} {pos}/{len}  {msg}";
        bar.set_style(ProgressStyle::with_template(style)?);
        Ok(Self { kind, bar, printed: None })
    }

    /// Reports a completed step.
    pub(super) fn step(&mut self, step: &StepProgress) {
        if self.kind == ProgressKind::Human {
            return self.step_for_people(step);
        }
        let now = Instant::now();
        let is_due = self.printed.is_none_or(|printed| now - printed >= EVERY);
        if !is_due && step.step < step.total {
            return;
        }
        self.printed = Some(now);
        match self.kind {
            ProgressKind::Json => print(&step_line(step).to_string()),
            _ => {
                let percent = 100.0 * f64::from(step.step) / f64::from(step.total.max(1));
                let left = time_left(step).map_or(String::new(), |left| format!(", {left}"));
                print(&format!("openjd_progress: {:.1}", percent.min(100.0)));
                print(&format!(
                    "openjd_status: step {} of {}: {}{left}",
                    step.step,
                    step.total,
                    summary(step)
                ));
            }
        }
    }

    fn step_for_people(&self, step: &StepProgress) {
        let bar = &self.bar;
        // Without a terminal the bar is hidden: about 20 lines are printed instead.
        if bar.is_hidden() && step.step.is_multiple_of((step.total / 20).max(1)) {
            eprintln!("step {}/{}  {}", step.step, step.total, for_people(step));
        }
        bar.set_length(u64::from(step.total));
        bar.set_position(u64::from(step.step));
        bar.set_message(for_people(step));
    }

    /// Reports the current activity.
    pub(super) fn status(&self, text: &str) {
        self.say("status", text);
    }

    /// Reports a warning.
    pub(super) fn warning(&self, text: &str) {
        match self.kind {
            ProgressKind::Human => self.bar.suspend(|| eprintln!("warning: {text}")),
            ProgressKind::Json => print(&json!({ "event": "warning", "text": text }).to_string()),
            ProgressKind::Openjd => print(&format!("openjd_status: warning: {}", one_line(text))),
        }
    }

    /// Reports that the training was stopped before its end and that its progress is saved.
    pub(super) fn stopped(&self, text: &str) {
        self.say("stopped", text);
    }

    /// Reports a failure. For people the caller prints the error on standard error.
    pub(super) fn fail(&self, text: &str) {
        match self.kind {
            ProgressKind::Human => {}
            ProgressKind::Json => print(&json!({ "event": "failed", "error": text }).to_string()),
            ProgressKind::Openjd => print(&format!("openjd_fail: {}", one_line(text))),
        }
    }

    /// Reports success; `wrote` names the file or model that was written, and `summary` has sentences on its quality.
    pub(super) fn done(&self, wrote: &str, summary: &[String]) {
        match self.kind {
            ProgressKind::Human => {
                self.bar.finish();
                eprintln!("wrote {wrote}");
                summary.iter().for_each(|line| eprintln!("{line}"));
            }
            ProgressKind::Json => print(&done_line(wrote, summary).to_string()),
            ProgressKind::Openjd => {
                print("openjd_progress: 100.0");
                summary.iter().for_each(|line| print(&format!("openjd_status: {}", one_line(line))));
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

/// The line of a step. Values that are not finite are `null`.
fn step_line(step: &StepProgress) -> Value {
    let rounded = |value: f64, parts: f64| (value * parts).round() / parts;
    json!({
        "event": "step",
        "step": step.step,
        "total": step.total,
        "loss": rounded(step.loss, 1e6),
        "psnr": rounded(step.psnr, 1e3),
        "gaussians": step.gaussians,
        "eta_seconds": step.eta_seconds.map(|eta| rounded(eta, 10.0)),
    })
}

/// The last line. Without a summary it has no such field.
fn done_line(wrote: &str, summary: &[String]) -> Value {
    let mut line = json!({ "event": "done", "wrote": wrote });
    if !summary.is_empty() {
        line["summary"] = summary.into();
    }
    line
}

fn summary(step: &StepProgress) -> String {
    format!("loss {:.4}  PSNR {:.2} dB  {} Gaussians", step.loss, step.psnr, step.gaussians)
}

/// The figures of a step, and the expected time to the end if there is one.
fn for_people(step: &StepProgress) -> String {
    time_left(step).map_or_else(|| summary(step), |left| format!("{left}  {}", summary(step)))
}

/// The expected time to the end, in words: seconds below two minutes, then minutes, then hours.
fn time_left(step: &StepProgress) -> Option<String> {
    let seconds = step.eta_seconds.filter(|seconds| seconds.is_finite())?.max(0.0);
    Some(match seconds {
        ..120.0 => format!("{seconds:.0} s left"),
        ..7200.0 => format!("{:.0} min left", seconds / 60.0),
        _ => format!("{:.1} h left", seconds / 3600.0),
    })
}

/// A message of the protocol must be one line.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A closed standard output does not end a training.
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
            eta_seconds: Some(1.52),
        };
        let line = json!({ "event": "step", "step": 3, "total": 9, "loss": 0.123_457, "psnr": null,
            "gaussians": 64, "eta_seconds": 1.5 });
        assert_eq!(step_line(&step), line);
        let unknown = StepProgress { eta_seconds: None, ..step };
        assert_eq!(step_line(&unknown)["eta_seconds"], Value::Null);
        assert!(for_people(&step).starts_with("2 s left  loss"), "{}", for_people(&step));
        assert!(for_people(&unknown).starts_with("loss"), "{}", for_people(&unknown));
    }

    #[test]
    fn time_left_has_a_unit_that_suits_its_size() {
        let step = StepProgress { step: 1, total: 9, loss: 0.0, psnr: 0.0, gaussians: 1, eta_seconds: None };
        let of = |seconds| time_left(&StepProgress { eta_seconds: Some(seconds), ..step });
        for (seconds, words) in
            [(-1.0, "0 s"), (119.0, "119 s"), (121.0, "2 min"), (3600.0, "60 min"), (9000.0, "2.5 h")]
        {
            assert_eq!(of(seconds), Some(format!("{words} left")));
        }
        assert_eq!(of(f64::NAN), None);
        assert_eq!(time_left(&step), None);
    }

    #[test]
    fn done_line_has_a_summary_only_if_there_is_one() {
        assert_eq!(done_line("m", &[]), json!({ "event": "done", "wrote": "m" }));
        let lines = ["a".to_owned(), "b".to_owned()];
        assert_eq!(done_line("m", &lines)["summary"], json!(["a", "b"]));
    }

    #[test]
    fn messages_are_written_on_one_line() {
        assert_eq!(one_line("no space\n  on the disk\r\n"), "no space on the disk");
    }
}
