//! The most memory that this process held at once. What its allocator has not given back counts.

/// Measures from when it is begun, where the system tells.
pub(super) struct PeakMemory;

impl PeakMemory {
    /// Forgets what was held before.
    pub(super) fn begin() -> Self {
        // Without the right to do so the peak is that of the whole run.
        #[cfg(target_os = "linux")]
        if let Err(error) = std::fs::write("/proc/self/clear_refs", "5") {
            eprintln!("the peak of memory is that of the whole run: {error}");
        }
        Self
    }

    /// Mebibytes at the peak; `None` where the system does not tell.
    pub(super) fn mebibytes(&self) -> Option<u64> {
        peak_kibibytes(&std::fs::read_to_string("/proc/self/status").ok()?).map(|kibibytes| kibibytes / 1024)
    }
}

/// The peak in the text of `/proc/self/status`.
fn peak_kibibytes(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix("kB")?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peak_memory_is_read_from_the_vmhwm_line() {
        assert_eq!(peak_kibibytes("VmPeak:\t  9 kB\nVmHWM:\t   2048 kB\nVmRSS:\t 5 kB\n"), Some(2048));
        assert_eq!(peak_kibibytes("VmPeak:\t  9 kB\n"), None);
    }
}
