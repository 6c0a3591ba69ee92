//! Runs an external program without a shell, with its output in a log file and with a time limit.

use std::ffi::OsStr;
use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
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
        #[cfg(unix)]
        if self.process_limits.has_own_group() {
            std::os::unix::process::CommandExt::process_group(&mut command, 0);
        }
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
            output.limit(self.log).map_err(io(self.log))?;
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
        // All calls fail only if the program has already exited.
        self.process_limits.kill_group(&mut self.child);
        let _ = self.child.kill();
        let _ = self.child.wait();
        self.process_limits.forget();
    }
}

/// Size beyond which the middle of a log is removed, bytes.
const MAX_LOG_BYTES: u64 = 4 << 20;
/// Bytes that then remain at its start and at its end.
const KEPT_LOG_BYTES: u64 = 1 << 20;

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
        file.seek(SeekFrom::End(0))?;
        Ok(Self { file, unfinished: Vec::new(), last_lines: Vec::new() })
    }

    /// Removes the middle of a log that is too long, after it was read. The program appends, so its next output follows the end;
    /// output during the removal can be lost.
    fn limit(&mut self, path: &Path) -> std::io::Result<()> {
        let length = self.file.metadata()?.len();
        if length <= MAX_LOG_BYTES {
            return Ok(());
        }
        let mut file = OpenOptions::new().read(true).write(true).open(path)?;
        let mut end = Vec::new();
        file.seek(SeekFrom::Start(length - KEPT_LOG_BYTES))?;
        (&mut file).take(KEPT_LOG_BYTES).read_to_end(&mut end)?;
        let omitted = length - 2 * KEPT_LOG_BYTES;
        file.set_len(KEPT_LOG_BYTES)?;
        file.seek(SeekFrom::End(0))?;
        write!(file, "\n... {omitted} bytes omitted by relume ...\n")?;
        file.write_all(&end)?;
        self.file.seek(SeekFrom::End(0)).map(drop)
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
    fn a_long_log_keeps_its_first_and_last_part() {
        let (ended, lines, log) =
            run("echo first; yes 0123456789abcdef | head -c 12000000; echo; echo last", LONG, false);
        ended.unwrap();
        assert!(log.len() as u64 <= MAX_LOG_BYTES, "{} bytes", log.len());
        assert!(
            log.starts_with("earlier\nfirst\n0123") && log.ends_with("\nlast\n"),
            "{}",
            &log[log.len() - 40..]
        );
        assert!(log.contains(" bytes omitted by relume ...\n"));
        assert_eq!(lines.last().map(String::as_str), Some("last"), "the control: every line is reported");
        let (_, _, short) = run("echo one", LONG, false);
        assert_eq!(short, "earlier\none\n", "the control: a short log is kept whole");
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_children_of_a_cancelled_program_are_killed_too() {
        let folder = tempfile::TempDir::new().unwrap();
        let log = folder.path().join("x.log");
        for has_own_group in [true, false] {
            let marker = has_own_group.then(|| folder.path().join("process"));
            let program = ExternalProgram {
                name: "sh".as_ref(),
                install: "get it",
                log: &log,
                folder: None,
                process_limits: ProcessLimits { marker, ..ProcessLimits::default() },
            };
            std::fs::write(&log, "").unwrap();
            let child = || std::fs::read_to_string(&log).unwrap().lines().next().map(str::to_owned);
            let is_cancelled = || child().is_some();
            let mut ignored = |_| {};
            let mut run_control = RunControl::new(LONG, &mut ignored, &is_cancelled);
            let script = "sleep 300 & echo $!; wait";
            let ended = program.run(&["-c".as_ref(), script.as_ref()], &mut run_control, &mut |_, _| {});
            assert!(matches!(ended, Err(PoseError::Cancelled)), "{ended:?}");
            let pid = child().unwrap();
            let state = || std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
            // A killed process may be a zombie until its new parent waits for it.
            let is_gone = || state().is_empty() || state().contains(") Z ");
            let gone = (0..200).any(|_| {
                std::thread::sleep(Duration::from_millis(10));
                is_gone()
            });
            assert_eq!(gone, has_own_group, "the control: without a group the child of the program survives");
            if !gone {
                Command::new("kill").args(["-9", &pid]).status().unwrap();
            }
        }
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
