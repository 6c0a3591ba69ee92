//! How much memory this process may take.

use sysinfo::{MemoryRefreshKind, RefreshKind, System};

/// Bytes that this process may take: of the machine, the container or its control group (`MemoryMax` of a systemd unit), whichever
/// is least.
pub(super) fn memory() -> u64 {
    let memory = RefreshKind::nothing().with_memory(MemoryRefreshKind::nothing().with_ram());
    let system = System::new_with_specifics(memory);
    let container = system.cgroup_limits().map(|limits| limits.total_memory);
    [container, relume_train::cgroup_limit()].into_iter().flatten().fold(system.total_memory(), u64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn detected_machine_memory_is_plausible() {
        assert!(memory() > 1 << 20);
    }
}
