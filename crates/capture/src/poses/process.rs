//! Runs an external program without a shell, with its output in a log file and with a time limit.

use std::ffi::OsStr;
use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use super::error::PoseError;
use super::run_control::RunControl;
use crate::process_limits::ProcessLimits;

/// Interval at which a running program is checked.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Number of log lines that an error shows.
const SHOWN_LINES: usize = 8;
/// Bytes of a line that are kept; the rest of a longer line is dropped.
const MAX_LINE_BYTES: usize = 4096;

/// An external program.
pub(super) struct ExternalProgram<'a> {
    /// Name to find on PATH, or a path.
    pub name: &'a OsStr,
    /// How to install it.
    pub install: &'static str,
    /// The file to which the program's output is appended.
    pub log: &'a Path,
    /// Working directory; `None` for that of this process.
    pub folder: Option<&'a Path>,
    /// Limits on its resources.
    pub process_limits: ProcessLimits,
}

impl ExternalProgram<'_> {
    /// Runs the program until it exits. `line` is called with each line that it writes, with a short delay.
    ///
    /// # Errors
    /// [`PoseError`] if the program is not installed, fails, exceeds the time limit or is cancelled. It is no longer
    /// running then.
    pub(super) fn run(
        &self,
        arguments: &[&OsStr],
        run_control: &mut RunControl<'_>,
        line: &mut dyn FnMut(&str, &mut RunControl<'_>),
    ) -> Result<(), PoseError> {
        let io = PoseError::io;
        self.process_limits.kill_leftover();
        let log = OpenOptions::new().create(true).append(true).open(self.log).map_err(io(self.log))?;
        let mut output = LogTail::after_the_end(self.log).map_err(io(self.log))?;
        let (for_out, for_errors) = (log.try_clone().map_err(io(self.log))?, log);
        let mut command = Command::new(self.name);
        command.args(arguments).stdin(Stdio::null()).stdout(for_out).stderr(for_errors);
        if let Some(folder) = self.folder {
            command.current_dir(folder);
        }
        // COLMAP with a user interface requires a display for all commands unless this is set.
        command.env("QT_QPA_PLATFORM", "offscreen");
        let spawned = command.spawn().map_err(|error| match error.kind() {
            ErrorKind::NotFound => {
                PoseError::NotInstalled { program: self.name.display().to_string(), install: self.install }
            }
            _ => PoseError::Io { file: PathBuf::from(self.name), source: error },
        })?;
        let mut running = RunningProcess { child: spawned, process_limits: &self.process_limits };
        self.process_limits.apply_to(&running.child).map_err(io(Path::new(self.name)))?;
        let status = loop {
            let status = running.child.try_wait().map_err(io(Path::new(self.name)))?;
            output.read(&mut |text| line(text, run_control)).map_err(io(self.log))?;
            if let Some(status) = status {
                break status;
            }
            if (run_control.is_cancelled)() {
                return Err(PoseError::Cancelled);
            }
            if run_control.is_over() {
                let (program, log) = (self.command_text(arguments), self.log.to_owned());
                return Err(PoseError::TimedOut { program, minutes: run_control.minutes(), log });
            }
            std::thread::sleep(POLL_INTERVAL);
        };
        match status.success() {
            true => Ok(()),
            false => Err(PoseError::Failed {
                program: self.command_text(arguments),
                status: status.to_string(),
                end: output.last_lines.join("\n"),
                log: self.log.to_owned(),
            }),
        }
    }

    /// Name of the program and its command.
    fn command_text(&self, arguments: &[&OsStr]) -> String {
        let command = arguments.first().filter(|a| !a.to_string_lossy().starts_with('-'));
        let command = command.map_or(String::new(), |c| format!(" {}", c.display()));
        format!("{}{command}", self.name.display())
    }
}

/// A running program, killed on drop.
struct RunningProcess<'a> {
    child: Child,
    process_limits: &'a ProcessLimits,
}

impl Drop for RunningProcess<'_> {
    fn drop(&mut self) {
        // Both calls fail only if the program has already exited.
        let _ = self.child.kill();
        let _ = self.child.wait();
        self.process_limits.forget();
    }
}

/// Reads the lines that are appended to a file.
struct LogTail {
    file: File,
    unfinished: Vec<u8>,
    last_lines: Vec<String>,
}

impl LogTail {
    /// Starts after the current end of the file.
    fn after_the_end(path: &Path) -> std::io::Result<Self> {
        let mut file = File::open(path)?;
        std::io::Seek::seek(&mut file, std::io::SeekFrom::End(0))?;
        Ok(Self { file, unfinished: Vec::new(), last_lines: Vec::new() })
    }

    /// Calls `line` for each line completed since the last call, and keeps the last few.
    fn read(&mut self, line: &mut dyn FnMut(&str)) -> std::io::Result<()> {
        let mut buffer = [0; 8192];
        loop {
            let bytes = self.file.read(&mut buffer)?;
            if bytes == 0 {
                return Ok(());
            }
            // Progress bars end lines with a carriage return.
            for &byte in &buffer[..bytes] {
                if !matches!(byte, b'\n' | b'\r') {
                    if self.unfinished.len() < MAX_LINE_BYTES {
                        self.unfinished.push(byte);
                    }
                    continue;
                }
                let text = String::from_utf8_lossy(&self.unfinished).trim().to_owned();
                self.unfinished.clear();
                if !text.is_empty() {
                    line(&text);
                    if self.last_lines.len() == SHOWN_LINES {
                        self.last_lines.remove(0);
                    }
                    self.last_lines.push(text);
                }
            }
        }
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use super::*;

    /// The result of `sh -c script`, the lines that it wrote, and its log.
    fn run(script: &str, limit: Duration, cancelled: bool) -> (Result<(), PoseError>, Vec<String>, String) {
        let folder = tempfile::TempDir::new().unwrap();
        let log = folder.path().join("x.log");
        std::fs::write(&log, "earlier\n").unwrap();
        let program = ExternalProgram {
            name: "sh".as_ref(),
            install: "get it",
            log: &log,
            folder: None,
            process_limits: ProcessLimits::default(),
        };
        let (mut ignored, mut lines) = (|_| {}, Vec::new());
        let is_cancelled = || cancelled;
        let mut run_control = RunControl::new(limit, &mut ignored, &is_cancelled);
        let ended = program.run(&["-c".as_ref(), script.as_ref()], &mut run_control, &mut |line, _| {
            lines.push(line.to_owned());
        });
        (ended, lines, std::fs::read_to_string(&log).unwrap())
    }

    const LONG: Duration = Duration::from_secs(600);

    #[test]
    fn program_output_is_reported_and_appended_to_the_log() {
        let (ended, lines, log) = run("echo one; echo two >&2; printf 'three\\rfour\\n'", LONG, false);
        ended.unwrap();
        assert_eq!(lines, ["one", "two", "three", "four"]);
        assert_eq!(log, "earlier\none\ntwo\nthree\rfour\n");
    }

    #[test]
    fn failed_program_gives_an_error_with_its_last_output() {
        let (ended, ..) = run("seq 20; echo no memory; exit 3", LONG, false);
        let Err(PoseError::Failed { end, status, .. }) = ended else { panic!("{ended:?}") };
        assert!(end.ends_with("20\nno memory") && !end.contains("\n12\n") && status.contains('3'), "{end}");
        assert!(matches!(run("kill -9 $$", LONG, false).0, Err(PoseError::Failed { .. })));
    }

    #[test]
    fn program_is_killed_after_timeout_or_cancellation() {
        let runs = |pid: &str| {
            Command::new("sh").args(["-c", &format!("kill -0 {pid}")]).status().unwrap().success()
        };
        let (ended, _, log) = run("echo $$; exec sleep 300", Duration::from_millis(500), false);
        assert!(matches!(ended, Err(PoseError::TimedOut { minutes: 1, .. })), "{ended:?}");
        let pid = log.lines().nth(1).unwrap();
        assert!(!runs(pid), "{pid} is still running");
        assert!(matches!(run("exec sleep 300", LONG, true).0, Err(PoseError::Cancelled)));
        assert!(runs("$$"), "the control: a running process");
    }

    #[test]
    fn missing_program_gives_an_error_with_install_advice() {
        let folder = tempfile::TempDir::new().unwrap();
        let log = folder.path().join("x.log");
        let program = ExternalProgram {
            name: "no-such-program".as_ref(),
            install: "get it",
            log: &log,
            folder: None,
            process_limits: ProcessLimits::default(),
        };
        let mut ignored = |_| {};
        let mut run_control = RunControl::new(LONG, &mut ignored, &|| false);
        let error = program.run(&[], &mut run_control, &mut |_, _| {}).unwrap_err().to_string();
        assert!(error.contains("no-such-program") && error.contains("get it"), "{error}");
    }
}
