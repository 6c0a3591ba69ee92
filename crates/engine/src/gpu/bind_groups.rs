//! Cache of bind groups: successive steps bind the same memory.

use std::collections::HashMap;
use std::sync::Mutex;

use crate::gpu::lock::locked;
use crate::gpu::shaders::Kernel;

/// Maximum number of cached bind groups; a full cache is cleared.
const MAX_BIND_GROUPS: usize = 4096;

/// Key of a bind group: its resources, in the order of its bindings.
#[derive(Debug, PartialEq, Eq, Hash)]
pub(super) struct BindKey {
    pub(super) kernel: &'static str,
    pub(super) bound: Vec<Bound>,
}

/// One binding of a bind group.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Bound {
    /// A memory block by its number, and its size in bytes.
    Memory(u64, u64),
    /// A struct of this size in bytes in the shared uniforms; each dispatch gives its offset.
    Uniform(u64),
}

impl BindKey {
    pub(super) fn new(kernel: &'static Kernel, bound: Vec<Bound>) -> Self {
        Self { kernel: kernel.name, bound }
    }

    fn binds(&self, memory: u64) -> bool {
        self.bound.iter().any(|bound| matches!(bound, Bound::Memory(number, _) if *number == memory))
    }
}

/// The bind groups of a device.
#[derive(Default)]
pub(super) struct BindGroups(Mutex<HashMap<BindKey, wgpu::BindGroup>>);

impl BindGroups {
    /// The bind group of `key`; `make` creates a missing one.
    pub(super) fn get(&self, key: BindKey, make: impl FnOnce() -> wgpu::BindGroup) -> wgpu::BindGroup {
        let mut groups = locked(&self.0);
        if let Some(group) = groups.get(&key) {
            return group.clone();
        }
        if groups.len() >= MAX_BIND_GROUPS {
            groups.clear();
        }
        groups.entry(key).or_insert_with(make).clone()
    }

    /// Drops the groups that bind freed memory, which they would keep allocated.
    pub(super) fn forget(&self, freed: &[u64]) {
        if !freed.is_empty() {
            locked(&self.0).retain(|key, _| !freed.iter().any(|memory| key.binds(*memory)));
        }
    }

    /// Number of cached bind groups.
    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        locked(&self.0).len()
    }
}
