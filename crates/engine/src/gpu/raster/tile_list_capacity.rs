//! Capacity of a view's tile lists. Only the device knows the needed size, so the host allocates for the needs of earlier
//! views, and a view that needs more is drawn again.

use crate::DeviceError;
use crate::gpu::raster::memory::Raster;
use crate::gpu::raster::records::{OversizedViews, RasterCounts};

/// Initial capacity in pairs: the first number per Gaussian, at least the second.
const INITIAL_CAPACITY: (usize, usize) = (4, 1 << 14);
/// The lists shrink when their capacity exceeds the first number times the pairs of each view, for the second number of
/// consecutive views.
const SHRINK_LIMITS: (usize, u32) = (8, 256);

/// The device's status of a view's lists (`shaders/tile_capacity.wgsl`).
#[derive(Debug, Clone, Copy)]
pub(super) struct TileListStatus {
    is_short: bool,
    visible: usize,
    pairs: u64,
}

impl TileListStatus {
    /// From the elements of [`Raster::list_status`]; missing elements mean complete lists.
    fn new(words: &[u32]) -> Self {
        let word = |i: usize| words.get(i).copied().unwrap_or(0);
        Self {
            is_short: word(1) != 0,
            visible: word(4) as usize,
            pairs: u64::from(word(3)) << 32 | u64::from(word(2)),
        }
    }
}

impl Raster {
    /// Applies the status of a view's lists. Returns false when the lists were too short: the view and everything recorded
    /// since are wrong; they can be recorded again, with the memory that this call provides.
    ///
    /// # Errors
    /// [`DeviceError::TooLarge`] with the numbers when the view has more (splat, tile) pairs than one binding holds.
    pub fn apply_list_status(&mut self, list_status: &[u32]) -> Result<bool, DeviceError> {
        let list_status = TileListStatus::new(list_status);
        if list_status.is_short {
            self.gpu.write(&self.list_status, 1, &[0]);
        }
        self.check_instances(list_status.pairs)?;
        let pairs = list_status.pairs as usize;
        self.last = RasterCounts { visible: list_status.visible, instances: pairs };
        if list_status.is_short {
            self.capacity = (pairs + pairs / 4).max(self.capacity).min(self.max_instances());
        }
        self.shrink_if_oversized(pairs);
        Ok(!list_status.is_short)
    }

    /// Reduces the capacity for the next views where many consecutive views needed much less.
    fn shrink_if_oversized(&mut self, pairs: usize) {
        let (times, views) = SHRINK_LIMITS;
        if self.capacity / times <= pairs.max(INITIAL_CAPACITY.1) {
            self.oversized = OversizedViews::default();
            return;
        }
        let OversizedViews { count, most } = &mut self.oversized;
        (*count, *most) = (*count + 1, pairs.max(*most));
        if *count == views {
            self.capacity = 2 * (*most).max(INITIAL_CAPACITY.1);
            self.oversized = OversizedViews::default();
        }
    }

    /// Reduces the capacity for the next views to the need of the last one; returns false where it already is that.
    pub(super) fn shrink_to_fit(&mut self) -> bool {
        let least = self.last.instances.max(INITIAL_CAPACITY.1);
        let is_oversized = self.capacity > least;
        self.capacity = self.capacity.min(least);
        is_oversized
    }

    /// Capacity, in pairs, of the lists of the next view of `n` Gaussians.
    pub(super) fn capacity_for(&mut self, n: usize) -> usize {
        if self.capacity == 0 {
            self.capacity = (INITIAL_CAPACITY.0 * n).max(INITIAL_CAPACITY.1);
        }
        self.capacity = self.capacity.min(self.max_instances());
        self.capacity
    }

    /// Sets the capacity of the next views' lists, in pairs.
    #[cfg(test)]
    pub(in crate::gpu) fn set_capacity(&mut self, capacity: usize) {
        self.capacity = capacity;
    }

    /// Capacity of the next view's lists, in pairs.
    #[cfg(test)]
    pub(super) fn capacity(&self) -> usize {
        self.capacity
    }

    /// Status of the last view's lists.
    #[cfg(test)]
    pub(in crate::gpu) fn list_status(&self) -> &crate::gpu::Buffer<u32> {
        &self.list_status
    }

    /// Maximum number of pairs in one binding. Indices have 32 bits, with space for a workgroup beyond the end.
    fn max_instances(&self) -> usize {
        let most = self.gpu.report().max_binding.min(self.gpu.report().max_buffer);
        // Memory is allocated in multiples of 16 bytes.
        (most / 16 * 4).min(u64::from(u32::MAX) - 4096) as usize
    }

    pub(super) fn check_instances(&self, pairs: u64) -> Result<(), DeviceError> {
        if pairs <= self.max_instances() as u64 {
            return Ok(());
        }
        let most = self.gpu.report().max_binding.min(self.gpu.report().max_buffer);
        let what = format!("the tile lists of a view with {pairs} pairs of splat and tile");
        Err(DeviceError::TooLarge { what, needs: pairs.saturating_mul(4), most })
    }
}
