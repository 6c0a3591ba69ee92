//! The memory available to this process.

use sysinfo::{MemoryRefreshKind, RefreshKind, System};

/// Bytes assumed where the system does not state its memory, as Linux without `/proc`.
const UNSTATED: u64 = 4 << 30;

/// Bytes available to this process: the minimum of the machine, the container and the control group (`MemoryMax` of a systemd
/// unit).
pub(super) fn memory() -> u64 {
    let memory = RefreshKind::nothing().with_memory(MemoryRefreshKind::nothing().with_ram());
    let system = System::new_with_specifics(memory);
    let machine = Some(system.total_memory()).filter(|bytes| *bytes > 0);
    // The limits of a container cannot be asked for without the memory of the machine.
    let container = machine.and_then(|_| system.cgroup_limits()).map(|limits| limits.total_memory);
    [container, relume_train::cgroup_limit()]
        .into_iter()
        .flatten()
        .fold(machine.unwrap_or(UNSTATED), u64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn detected_machine_memory_is_plausible() {
        assert!(memory() > 1 << 20);
    }
}
