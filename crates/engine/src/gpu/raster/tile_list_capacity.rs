//! How much memory the lists of a view need. Only the device knows, so that it is laid out for what earlier views needed, and a
//! view that needs more is drawn again.

use crate::DeviceError;
use crate::gpu::raster::memory::Raster;
use crate::gpu::raster::records::{OversizedViews, RasterCounts};

/// Pairs a Gaussian that the first view has memory for, and pairs that any view has.
const INITIAL_CAPACITY: (usize, usize) = (4, 1 << 14);
/// Memory for this many times the pairs of every one of so many views in a row is too much.
const SHRINK_LIMITS: (usize, u32) = (8, 256);

/// What the device says of a view's lists (`shaders/tile_capacity.wgsl`).
#[derive(Debug, Clone, Copy)]
pub(super) struct TileListStatus {
    is_short: bool,
    visible: usize,
    pairs: u64,
}

impl TileListStatus {
    /// From the elements of [`Raster::list_status`]; nothing is short where elements are missing.
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
    /// Takes in what came back of the lists of a view. False when memory was short: what was drawn is wrong, so is all that
    /// was recorded since, and with the memory that there is now it can be recorded again.
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

    /// Lays the next views' lists out for less where many views in a row needed far less than there is.
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

    /// Lays the next views' lists out for what the last one needed and no more; false where they are.
    pub(super) fn shrink_to_fit(&mut self) -> bool {
        let least = self.last.instances.max(INITIAL_CAPACITY.1);
        let is_oversized = self.capacity > least;
        self.capacity = self.capacity.min(least);
        is_oversized
    }

    /// Pairs that the lists of the next view of `n` Gaussians hold.
    pub(super) fn capacity_for(&mut self, n: usize) -> usize {
        if self.capacity == 0 {
            self.capacity = (INITIAL_CAPACITY.0 * n).max(INITIAL_CAPACITY.1);
        }
        self.capacity = self.capacity.min(self.max_instances());
        self.capacity
    }

    /// Makes the next views' lists hold `capacity` pairs.
    #[cfg(test)]
    pub(in crate::gpu) fn set_capacity(&mut self, capacity: usize) {
        self.capacity = capacity;
    }

    /// Pairs that the next view's lists hold.
    #[cfg(test)]
    pub(super) fn capacity(&self) -> usize {
        self.capacity
    }

    /// What the lists of the last view hold.
    #[cfg(test)]
    pub(in crate::gpu) fn list_status(&self) -> &crate::gpu::Buffer<u32> {
        &self.list_status
    }

    /// Pairs that one binding holds. Indices are 32 bits wide, with space for a workgroup beyond the end.
    fn max_instances(&self) -> usize {
        let most = self.gpu.report().max_binding.min(self.gpu.report().max_buffer);
        // Memory comes in pieces of 16 bytes.
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
