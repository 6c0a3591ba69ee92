//! How much memory the lists of a view need. Only the device knows, so that it is laid out for what earlier views needed, and a
//! view that needs more is drawn again.

use crate::DeviceError;
use crate::gpu::raster::memory::Raster;
use crate::gpu::raster::records::{RasterCounts, RoomyViews};

/// Pairs a Gaussian that the first view has memory for, and pairs that any view has.
const FIRST_ROOM: (usize, usize) = (4, 1 << 14);
/// Memory for this many times the pairs of every one of so many views in a row is too much.
const TOO_MUCH: (usize, u32) = (8, 256);

/// What the device says of a view's lists (`shaders/tile_room.wgsl`).
#[derive(Debug, Clone, Copy)]
pub(super) struct Listed {
    is_short: bool,
    visible: usize,
    pairs: u64,
}

impl Listed {
    /// From the elements of [`Raster::listed`]; nothing is short where elements are missing.
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
    pub fn settle(&mut self, listed: &[u32]) -> Result<bool, DeviceError> {
        let listed = Listed::new(listed);
        if listed.is_short {
            self.gpu.write(&self.listed, 1, &[0]);
        }
        self.check_instances(listed.pairs)?;
        let pairs = listed.pairs as usize;
        self.last = RasterCounts { visible: listed.visible, instances: pairs };
        if listed.is_short {
            self.room = (pairs + pairs / 4).max(self.room).min(self.most_instances());
        }
        self.give_back(pairs);
        Ok(!listed.is_short)
    }

    /// Lays the next views' lists out for less where many views in a row needed far less than there is.
    fn give_back(&mut self, pairs: usize) {
        let (times, views) = TOO_MUCH;
        if self.room / times <= pairs.max(FIRST_ROOM.1) {
            self.roomy = RoomyViews::default();
            return;
        }
        let RoomyViews { count, most } = &mut self.roomy;
        (*count, *most) = (*count + 1, pairs.max(*most));
        if *count == views {
            self.room = 2 * (*most).max(FIRST_ROOM.1);
            self.roomy = RoomyViews::default();
        }
    }

    /// Lays the next views' lists out for what the last one needed and no more; false where they are.
    pub(super) fn spare_nothing(&mut self) -> bool {
        let least = self.last.instances.max(FIRST_ROOM.1);
        let is_roomy = self.room > least;
        self.room = self.room.min(least);
        is_roomy
    }

    /// Pairs that the lists of the next view of `n` Gaussians hold.
    pub(super) fn room_for(&mut self, n: usize) -> usize {
        if self.room == 0 {
            self.room = (FIRST_ROOM.0 * n).max(FIRST_ROOM.1);
        }
        self.room = self.room.min(self.most_instances());
        self.room
    }

    /// Makes the next views' lists hold `room` pairs.
    #[cfg(test)]
    pub(in crate::gpu) fn set_room(&mut self, room: usize) {
        self.room = room;
    }

    /// Pairs that the next view's lists hold.
    #[cfg(test)]
    pub(super) fn room(&self) -> usize {
        self.room
    }

    /// What the lists of the last view hold.
    #[cfg(test)]
    pub(in crate::gpu) fn listed(&self) -> &crate::gpu::Buffer<u32> {
        &self.listed
    }

    /// Pairs that one binding holds. Indices are 32 bits wide, with space for a workgroup beyond the end.
    fn most_instances(&self) -> usize {
        let most = self.gpu.report().max_binding.min(self.gpu.report().max_buffer);
        // Memory comes in pieces of 16 bytes.
        (most / 16 * 4).min(u64::from(u32::MAX) - 4096) as usize
    }

    pub(super) fn check_instances(&self, pairs: u64) -> Result<(), DeviceError> {
        if pairs <= self.most_instances() as u64 {
            return Ok(());
        }
        let most = self.gpu.report().max_binding.min(self.gpu.report().max_buffer);
        let what = format!("the tile lists of a view with {pairs} pairs of splat and tile");
        Err(DeviceError::TooLarge { what, needs: pairs.saturating_mul(4), most })
    }
}
