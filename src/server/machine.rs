//! How much memory this process may take.

use std::path::Path;

use sysinfo::{MemoryRefreshKind, RefreshKind, System};

/// Where control groups of version 2 are.
const CONTROL_GROUPS: &str = "/sys/fs/cgroup";

/// Bytes that this process may take: of the machine, the container or its control group (`MemoryMax` of a systemd unit), whichever
/// is least.
pub(super) fn memory() -> u64 {
    let memory = RefreshKind::nothing().with_memory(MemoryRefreshKind::nothing().with_ram());
    let system = System::new_with_specifics(memory);
    let container = system.cgroup_limits().map(|limits| limits.total_memory);
    let own = std::fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    let group = limit(Path::new(CONTROL_GROUPS), &own);
    [container, group].into_iter().flatten().fold(system.total_memory(), u64::min)
}

/// The least limit of the control group that `own` (the text of `/proc/self/cgroup`) names, and of those around it.
fn limit(root: &Path, own: &str) -> Option<u64> {
    // "0::" is version 2; its path begins at the root of the groups.
    let path = own.lines().find_map(|line| line.strip_prefix("0::/"))?;
    let groups = Path::new(path).ancestors();
    // "max" is none.
    let bytes =
        |group: &Path| std::fs::read_to_string(root.join(group).join("memory.max")).ok()?.trim().parse().ok();
    groups.filter_map(bytes).min()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_limit_of_a_process_and_of_what_it_is_in_counts() {
        let root = tempfile::TempDir::new().unwrap();
        let unit = root.path().join("system.slice/relume.service");
        std::fs::create_dir_all(&unit).unwrap();
        let own = "9:name=systemd:/other\n0::/system.slice/relume.service\n";
        assert_eq!(limit(root.path(), own), None);
        std::fs::write(unit.join("memory.max"), "2147483648\n").unwrap();
        std::fs::write(root.path().join("system.slice/memory.max"), "max\n").unwrap();
        assert_eq!(limit(root.path(), own), Some(2 << 30));
        std::fs::write(root.path().join("system.slice/memory.max"), "1073741824\n").unwrap();
        assert_eq!(limit(root.path(), own), Some(1 << 30));
        assert_eq!(
            limit(root.path(), "9:memory:/system.slice/relume.service\n"),
            None,
            "version 1 has other files"
        );
    }

    #[test]
    fn there_is_some_memory() {
        assert!(memory() > 1 << 20);
    }
}
