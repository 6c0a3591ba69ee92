//! Bind groups, kept from one recording to the next: a step binds the same memory as the one before.

use std::collections::HashMap;
use std::sync::Mutex;

use crate::gpu::lock::locked;
use crate::gpu::shaders::Kernel;

/// Bind groups kept at most; beyond that all are made anew.
const MAX_BIND_GROUPS: usize = 4096;

/// What a bind group binds, in the order of its bindings.
#[derive(Debug, PartialEq, Eq, Hash)]
pub(super) struct BindKey {
    pub(super) kernel: &'static str,
    pub(super) bound: Vec<Bound>,
}

/// One binding of a bind group.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Bound {
    /// Bytes of a piece of memory, by its number.
    Memory(u64, u64),
    /// A struct of this many bytes in the shared uniforms, at an offset that is given with each dispatch.
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
    /// The bind group of `key`, made by `make` where there is none.
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

    /// Forgets the groups that bind memory which nobody has a handle on any more: they would keep it.
    pub(super) fn forget(&self, freed: &[u64]) {
        if !freed.is_empty() {
            locked(&self.0).retain(|key, _| !freed.iter().any(|memory| key.binds(*memory)));
        }
    }

    /// Bind groups that are kept.
    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        locked(&self.0).len()
    }
}
