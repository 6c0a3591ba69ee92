//! The peak memory of this process, including memory that its allocator has not returned.

/// Measures from [`PeakMemory::begin`] on, if the operating system supports it.
pub(super) struct PeakMemory;

impl PeakMemory {
    /// Resets the peak.
    pub(super) fn begin() -> Self {
        // Without the permission, the peak covers the whole run.
        #[cfg(target_os = "linux")]
        if let Err(error) = std::fs::write("/proc/self/clear_refs", "5") {
            eprintln!("cannot reset the peak memory, so it covers the whole run: {error}");
        }
        Self
    }

    /// The peak in MiB; `None` if the operating system does not report it.
    pub(super) fn mebibytes(&self) -> Option<u64> {
        peak_kibibytes(&std::fs::read_to_string("/proc/self/status").ok()?).map(|kibibytes| kibibytes / 1024)
    }
}

/// The peak, KiB, in the text of `/proc/self/status`.
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
