//! Resource limits of an external program, and a marker file with which the next run kills a program left by a killed
//! process.

use std::path::PathBuf;
#[cfg(not(target_os = "linux"))]
use std::process::Child;

/// Limits of an external program. They are enforced only on Linux.
#[derive(Debug, Default)]
pub(crate) struct ProcessLimits {
    /// Limit on memory, bytes; `None` for no limit.
    pub memory: Option<u64>,
    /// Limit on the size of a file that it writes, bytes; `None` for no limit.
    pub file_bytes: Option<u64>,
    /// Whether the program runs at low CPU priority.
    pub low_priority: bool,
    /// A file with the id of the running program. If this process is killed, the next run kills the program it left.
    /// Such a program has its own process group.
    pub marker: Option<PathBuf>,
}

#[cfg(target_os = "linux")]
mod linux {
    use std::process::Child;

    use rustix::process::{Pid, Resource, Rlimit, Signal};

    use super::ProcessLimits;

    /// Nice value of a program at low priority, of at most 19.
    const NICE: i32 = 10;

    impl ProcessLimits {
        /// Applies the limits to a program that was just started.
        pub(crate) fn apply_to(&self, child: &Child) -> std::io::Result<()> {
            let Some(pid) = Pid::from_raw(child.id().cast_signed()) else { return Ok(()) };
            if let Some(marker) = &self.marker {
                std::fs::write(marker, child.id().to_string())?;
            }
            // A program that has already exited needs no limits.
            if self.low_priority {
                let _ = rustix::process::setpriority_process(Some(pid), NICE);
            }
            for (resource, limit) in [(Resource::Data, self.memory), (Resource::Fsize, self.file_bytes)] {
                if limit.is_some() {
                    let limit = Rlimit { current: limit, maximum: limit };
                    let _ = rustix::process::prlimit(Some(pid), resource, limit);
                }
            }
            Ok(())
        }

        /// Kills the group of a program that [`Self::has_own_group`] and has not exited: the program and its children.
        pub(crate) fn kill_group(&self, child: &mut Child) {
            // The identifier of a program that has been waited for may belong to another process.
            let runs = matches!(child.try_wait(), Ok(None));
            if let (true, true, Some(pid)) =
                (self.has_own_group(), runs, Pid::from_raw(child.id().cast_signed()))
            {
                let _ = rustix::process::kill_process_group(pid, Signal::KILL);
            }
        }

        /// Kills the program that an earlier process left running, if the process in the marker still has the
        /// marker's folder in its command line.
        pub(crate) fn kill_leftover(&self) {
            let named = || {
                let marker = self.marker.as_ref()?;
                let pid: i32 = std::fs::read_to_string(marker).ok()?.trim().parse().ok()?;
                let command = std::fs::read(format!("/proc/{pid}/cmdline")).ok()?;
                let folder = marker.parent()?.to_str()?;
                String::from_utf8_lossy(&command).contains(folder).then(|| Pid::from_raw(pid)).flatten()
            };
            if let Some(pid) = named() {
                let _ = rustix::process::kill_process_group(pid, Signal::KILL);
                let _ = rustix::process::kill_process(pid, Signal::KILL);
                while rustix::process::test_kill_process(pid).is_ok() && named() == Some(pid) {
                    std::thread::sleep(std::time::Duration::from_millis(20));
                }
            }
            self.forget();
        }
    }
}

#[cfg(not(target_os = "linux"))]
impl ProcessLimits {
    /// Applies the limits to a program: unsupported on this system.
    pub(crate) fn apply_to(&self, _: &Child) -> std::io::Result<()> {
        let _ = (self.memory, self.file_bytes, self.low_priority);
        Ok(())
    }

    /// Kills the group of a program: unsupported on this system.
    pub(crate) fn kill_group(&self, _: &mut Child) {}

    /// Kills the program that an earlier process left: unsupported on this system.
    pub(crate) fn kill_leftover(&self) {}
}

impl ProcessLimits {
    /// Whether the program gets a process group of its own, so that its children can be killed with it. Without a marker, on the
    /// command line, the program stays in the group of this process, so that an interrupt at the terminal reaches it.
    pub(crate) fn has_own_group(&self) -> bool {
        self.marker.is_some()
    }

    /// Removes the marker of a program that has exited.
    pub(crate) fn forget(&self) {
        if let Some(marker) = &self.marker {
            let _ = std::fs::remove_file(marker);
        }
    }
}

#[cfg(test)]
#[cfg(target_os = "linux")]
mod tests {
    use std::path::Path;
    use std::process::{Command, Stdio};
    use std::time::Duration;

    use super::*;

    /// The lines that `sh -c script` writes under these limits.
    fn said(process_limits: &ProcessLimits, script: &str) -> Vec<String> {
        let child = Command::new("sh").args(["-c", script]).stdout(Stdio::piped()).spawn().unwrap();
        process_limits.apply_to(&child).unwrap();
        let output = child.wait_with_output().unwrap();
        String::from_utf8(output.stdout).unwrap().lines().map(str::to_owned).collect()
    }

    #[test]
    fn program_runs_with_a_memory_limit_and_lower_priority() {
        // The limits are applied right after the start.
        let script = "sleep 0.5; ulimit -d; nice; ulimit -f";
        let process_limits = ProcessLimits {
            memory: Some(64 << 20),
            file_bytes: Some(1 << 20),
            low_priority: true,
            marker: None,
        };
        let held = said(&process_limits, script);
        let free = said(&ProcessLimits::default(), script);
        assert_eq!((held[0].as_str(), held[2].as_str()), ("65536", "2048"), "KiB, and blocks of 512 bytes");
        assert!(held.iter().zip(&free).all(|(held, free)| held != free), "the control");
        let nice = |lines: &[String]| lines[1].parse::<i32>().unwrap();
        assert_eq!(nice(&held), (nice(&free) + 10).min(19));
    }

    /// Starts a program that runs until it is killed. Returns once `argument` is visible in its command line: a
    /// parent continues before the kernel has written the command line of its child.
    fn start_looping(argument: &Path) -> std::process::Child {
        let script = ["-c", "while :; do sleep 0.1; done"];
        let child = Command::new("sh").args(script).arg(argument).spawn().unwrap();
        let command_line = format!("/proc/{}/cmdline", child.id());
        let is_named = || {
            String::from_utf8_lossy(&std::fs::read(&command_line).unwrap())
                .contains(argument.to_str().unwrap())
        };
        while !is_named() {
            std::thread::sleep(Duration::from_millis(1));
        }
        child
    }

    #[test]
    fn leftover_process_is_killed_and_other_processes_are_not() {
        let folder = tempfile::TempDir::new().unwrap();
        let marker = folder.path().join("process");
        for (argument, is_ours) in [(folder.path(), true), (Path::new("/elsewhere"), false)] {
            let mut child = start_looping(argument);
            std::fs::write(&marker, child.id().to_string()).unwrap();
            let reaped = std::thread::scope(|scope| {
                let process_limits =
                    ProcessLimits { marker: Some(marker.clone()), ..ProcessLimits::default() };
                let ending = scope.spawn(move || process_limits.kill_leftover());
                // A process that has exited exists until its parent, here the test, waits for it.
                let polls = if is_ours { 3000 } else { 50 };
                let reaped = (0..polls).any(|_| {
                    std::thread::sleep(Duration::from_millis(10));
                    child.try_wait().unwrap().is_some()
                });
                ending.join().unwrap();
                reaped
            });
            assert_eq!(reaped, is_ours, "{}", argument.display());
            assert!(!marker.exists());
            child.kill().ok();
            child.wait().unwrap();
        }
    }
}
