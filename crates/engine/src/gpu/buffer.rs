//! Typed device memory.

use std::marker::PhantomData;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use crate::gpu::lock::locked;

/// Bytes of device memory in use and their peak.
#[derive(Debug, Default)]
pub(super) struct MemoryAccount {
    used: AtomicU64,
    peak: AtomicU64,
    /// Number of memory blocks so far.
    pieces: AtomicU64,
    /// Numbers of freed memory blocks since the last [`Self::take_freed`].
    freed: Mutex<Vec<u64>>,
}

impl MemoryAccount {
    pub(super) fn add(&self, bytes: u64) {
        let used = self.used.fetch_add(bytes, Ordering::Relaxed) + bytes;
        self.peak.fetch_max(used, Ordering::Relaxed);
    }

    /// Numbers of the memory blocks freed since the last call.
    pub(super) fn take_freed(&self) -> Vec<u64> {
        std::mem::take(&mut *locked(&self.freed))
    }

    pub(super) fn used(&self) -> u64 {
        self.used.load(Ordering::Relaxed)
    }

    pub(super) fn peak(&self) -> u64 {
        self.peak.load(Ordering::Relaxed)
    }
}

/// A block of device memory; freed with its last handle.
#[derive(Debug)]
struct Allocation {
    buffer: wgpu::Buffer,
    bytes: u64,
    number: u64,
    account: Arc<MemoryAccount>,
}

impl Drop for Allocation {
    fn drop(&mut self) {
        self.account.used.fetch_sub(self.bytes, Ordering::Relaxed);
        locked(&self.account.freed).push(self.number);
    }
}

/// `len` elements of device memory. A clone is another handle on the same memory.
#[derive(Debug)]
pub struct Buffer<T> {
    allocation: Arc<Allocation>,
    len: usize,
    element: PhantomData<fn() -> T>,
}

impl<T> Clone for Buffer<T> {
    fn clone(&self) -> Self {
        Self { allocation: self.allocation.clone(), len: self.len, element: PhantomData }
    }
}

impl<T> Buffer<T> {
    pub(super) fn new(buffer: wgpu::Buffer, len: usize, account: &Arc<MemoryAccount>) -> Self {
        let bytes = buffer.size();
        account.add(bytes);
        let number = account.pieces.fetch_add(1, Ordering::Relaxed);
        let allocation = Arc::new(Allocation { buffer, bytes, number, account: account.clone() });
        Self { allocation, len, element: PhantomData }
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.len
    }

    /// True without elements; the underlying memory is never empty.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The same memory as elements of another type, as many as fit.
    pub fn cast<U>(&self) -> Buffer<U> {
        let len = self.len * size_of::<T>() / size_of::<U>().max(1);
        Buffer { allocation: self.allocation.clone(), len, element: PhantomData }
    }

    /// Bytes to bind: those of the elements, or the whole memory of an empty buffer.
    pub(super) fn bytes(&self) -> u64 {
        if self.len == 0 {
            self.allocation.bytes
        } else {
            (self.len * size_of::<T>()).next_multiple_of(4) as u64
        }
    }

    /// Number of its memory block on the device.
    pub(super) fn number(&self) -> u64 {
        self.allocation.number
    }

    pub(super) fn raw(&self) -> &wgpu::Buffer {
        &self.allocation.buffer
    }
}
