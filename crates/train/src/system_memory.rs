//! Memory available to this process.

use std::path::Path;

/// Root of the control groups of version 2.
const CONTROL_GROUPS: &str = "/sys/fs/cgroup";

/// Bytes of memory available to this process: the available memory of the machine, limited by the control groups.
/// `None` if neither can be read.
pub fn available_memory() -> Option<u64> {
    [of_machine("MemAvailable:"), cgroup_limit()].into_iter().flatten().min()
}

/// Bytes of memory available to this process if no other process ran: the memory of the machine, limited by the
/// control groups. `None` if neither can be read.
pub fn total_memory() -> Option<u64> {
    [of_machine("MemTotal:"), cgroup_limit()].into_iter().flatten().min()
}

/// A value from `/proc/meminfo`, bytes.
fn of_machine(name: &str) -> Option<u64> {
    bytes_of(&std::fs::read_to_string("/proc/meminfo").ok()?, name)
}

/// The least memory limit, bytes, of this process's control group (`MemoryMax` of a systemd unit, the limit of a
/// container) and its ancestors; `None` without a limit.
pub fn cgroup_limit() -> Option<u64> {
    let own = std::fs::read_to_string("/proc/self/cgroup").ok()?;
    cgroup_limit_of(Path::new(CONTROL_GROUPS), &own)
}

/// The least limit of the control group in `own` (the text of `/proc/self/cgroup`) and its ancestors.
fn cgroup_limit_of(root: &Path, own: &str) -> Option<u64> {
    // "0::" is version 2; the path is relative to the root of the groups.
    let path = own.lines().find_map(|line| line.strip_prefix("0::/"))?;
    let groups = Path::new(path).ancestors();
    // "max" means no limit.
    let bytes =
        |group: &Path| std::fs::read_to_string(root.join(group).join("memory.max")).ok()?.trim().parse().ok();
    groups.filter_map(bytes).min()
}

/// The value `name` in the text of `/proc/meminfo`, bytes.
fn bytes_of(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smallest_memory_limit_of_all_parent_cgroups_applies() {
        let root = tempfile::TempDir::new().unwrap();
        let unit = root.path().join("system.slice/relume.service");
        std::fs::create_dir_all(&unit).unwrap();
        let own = "9:name=systemd:/other\n0::/system.slice/relume.service\n";
        assert_eq!(cgroup_limit_of(root.path(), own), None);
        std::fs::write(unit.join("memory.max"), "2147483648\n").unwrap();
        std::fs::write(root.path().join("system.slice/memory.max"), "max\n").unwrap();
        assert_eq!(cgroup_limit_of(root.path(), own), Some(2 << 30));
        std::fs::write(root.path().join("system.slice/memory.max"), "1073741824\n").unwrap();
        assert_eq!(cgroup_limit_of(root.path(), own), Some(1 << 30));
        let version_1 = "9:memory:/system.slice/relume.service\n";
        assert_eq!(cgroup_limit_of(root.path(), version_1), None, "version 1 has other files");
    }

    #[test]
    fn available_memory_is_parsed_from_meminfo() {
        let text = "MemTotal:       24661284 kB\nMemFree:  1 kB\nMemAvailable:   19531250 kB\n";
        let left_of = |text: &str| bytes_of(text, "MemAvailable:");
        assert_eq!(left_of(text), Some(20_000_000_000));
        assert_eq!(bytes_of(text, "MemTotal:"), Some(24_661_284 * 1024));
        assert_eq!(left_of("MemTotal: 24661284 kB\n"), None);
        assert_eq!(left_of("MemAvailable: many\n"), None);
    }
}
