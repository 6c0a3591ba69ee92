//! Readback from the device: ranges of buffers, copied after the work that fills them. A thread waits for its own submission
//! alone, not for later submissions of others.

use std::marker::PhantomData;
use std::ops::Range;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use bytemuck::Pod;

use crate::DeviceError;
use crate::gpu::buffer::Buffer;
use crate::gpu::device::{DEVICE_TIMEOUT_S, Gpu};
use crate::gpu::lock::locked;

/// Maximum size of the pool of staging buffers, bytes.
const MAX_POOLED_BYTES: u64 = 256 << 20;
/// Size of the smallest staging buffer, bytes.
const MIN_STAGING_BYTES: u64 = 4096;
/// Alignment of a range in a staging buffer, bytes.
const ALIGNMENT: u64 = 16;

/// Ticket for a range of a buffer that a submission copies to the host.
#[derive(Debug)]
pub struct ReadbackTicket<T> {
    /// First byte in the staging buffer.
    start: usize,
    len: usize,
    element: PhantomData<fn() -> T>,
}

/// Copies at the end of a recording.
#[derive(Default)]
pub(super) struct ReadbackCopies {
    copies: Vec<(wgpu::Buffer, Range<u64>, u64)>,
    bytes: u64,
}

impl ReadbackCopies {
    /// Adds elements of a buffer; elements beyond its end are skipped.
    pub(super) fn add<T>(&mut self, buffer: &Buffer<T>, range: Range<usize>) -> ReadbackTicket<T> {
        let range = range.start.min(buffer.len())..range.end.min(buffer.len());
        if range.is_empty() {
            return ReadbackTicket { start: 0, len: 0, element: PhantomData };
        }
        let (first, end) = (range.start * size_of::<T>(), range.end * size_of::<T>());
        // Copies have a unit of four bytes.
        let copied = (first / 4 * 4) as u64..end.next_multiple_of(4) as u64;
        let at = self.bytes.next_multiple_of(ALIGNMENT);
        self.bytes = at + copied.end - copied.start;
        self.copies.push((buffer.raw().clone(), copied, at));
        ReadbackTicket { start: at as usize + first % 4, len: range.len(), element: PhantomData }
    }

    /// Records the copies; returns their staging buffer, if there are any.
    ///
    /// # Errors
    /// [`DeviceError::OutOfMemory`] when there is no memory for it.
    pub(super) fn record(
        self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
    ) -> Result<Option<Staging>, DeviceError> {
        if self.copies.is_empty() {
            return Ok(None);
        }
        let buffer = gpu.staging(self.bytes)?;
        for (from, range, at) in &self.copies {
            encoder.copy_buffer_to_buffer(from, range.start, &buffer, *at, range.end - range.start);
        }
        Ok(Some(Staging { buffer, bytes: self.bytes }))
    }
}

/// A staging buffer with pending copies.
pub(super) struct Staging {
    buffer: wgpu::Buffer,
    bytes: u64,
}

/// Submitted work.
pub struct Submission {
    gpu: Gpu,
    index: wgpu::SubmissionIndex,
    /// Number among the submissions of the device.
    number: u64,
    fetched: Option<(Staging, Receiver<Result<(), wgpu::BufferAsyncError>>)>,
}

impl Submission {
    /// The submission `index`, whose data is copied to `staging`.
    pub(super) fn new(
        gpu: &Gpu,
        index: wgpu::SubmissionIndex,
        number: u64,
        staging: Option<Staging>,
    ) -> Self {
        let fetched = staging.map(|staging| {
            let (sender, receiver) = channel();
            staging.buffer.map_async(wgpu::MapMode::Read, ..staging.bytes, move |result| {
                let _ = sender.send(result);
            });
            (staging, receiver)
        });
        Self { gpu: gpu.clone(), index, number, fetched }
    }

    /// Waits until the device has completed it; does not wait for later submissions.
    ///
    /// # Errors
    /// As [`Gpu::wait`].
    pub fn wait(&self) -> Result<(), DeviceError> {
        self.gpu.wait_for(Some(self.index.clone()))?;
        self.gpu.inner.counters.completed.fetch_max(self.number, Ordering::Relaxed);
        Ok(())
    }

    /// Waits as [`Self::wait`] and returns its data.
    ///
    /// # Errors
    /// Errors of the device.
    pub fn wait_for_data(self) -> Result<ReadbackData, DeviceError> {
        self.wait()?;
        let gpu = self.gpu;
        let Some((staging, mapped)) = self.fetched else { return Ok(ReadbackData { gpu, staging: None }) };
        // The callback may run in another waiting thread, shortly after this thread's wait ends.
        match mapped.recv_timeout(Duration::from_secs(DEVICE_TIMEOUT_S)) {
            Ok(Ok(())) => Ok(ReadbackData { gpu, staging: Some(staging) }),
            other => Err(gpu.failure(format!("a buffer could not be read: {other:?}"))),
        }
    }
}

/// Data of a submission, in memory that the device wrote.
pub struct ReadbackData {
    gpu: Gpu,
    staging: Option<Staging>,
}

impl ReadbackData {
    /// Calls `look` with the elements of a ticket of this submission.
    ///
    /// # Errors
    /// Errors of the device.
    pub fn with<T: Pod, R>(
        &self,
        ticket: &ReadbackTicket<T>,
        look: impl FnOnce(&[T]) -> R,
    ) -> Result<R, DeviceError> {
        let Some(staging) = self.staging.as_ref().filter(|_| ticket.len > 0) else { return Ok(look(&[])) };
        let mapped =
            staging.buffer.get_mapped_range(..staging.bytes).map_err(|e| self.gpu.failure(e.to_string()))?;
        let bytes = mapped.get(ticket.start..ticket.start + ticket.len * size_of::<T>());
        let elements = bytes.and_then(|bytes| bytemuck::try_cast_slice(bytes).ok());
        let elements = elements
            .ok_or_else(|| DeviceError::Misuse("a ticket of another submission was shown".to_owned()))?;
        let seen = look(elements);
        self.gpu.healthy()?;
        Ok(seen)
    }

    /// The elements of a ticket of this submission.
    ///
    /// # Errors
    /// As [`Self::with`].
    pub fn read<T: Pod>(&self, ticket: &ReadbackTicket<T>) -> Result<Vec<T>, DeviceError> {
        self.with(ticket, <[T]>::to_vec)
    }
}

impl Drop for ReadbackData {
    fn drop(&mut self) {
        let Some(staging) = self.staging.take() else { return };
        staging.buffer.unmap();
        let mut kept = locked(&self.gpu.inner.staging);
        kept.push(staging.buffer);
        // The least recently used buffers are freed.
        while kept.iter().map(wgpu::Buffer::size).sum::<u64>() > MAX_POOLED_BYTES {
            kept.remove(0);
        }
    }
}

/// Limits a thread to two incomplete submissions.
#[derive(Default)]
pub struct InFlightLimit(Option<Submission>);

impl InFlightLimit {
    /// Waits for the previous submission and keeps this one.
    ///
    /// # Errors
    /// As [`Submission::wait`].
    pub fn follow(&mut self, submission: Submission) -> Result<(), DeviceError> {
        match self.0.replace(submission) {
            Some(earlier) => earlier.wait(),
            None => Ok(()),
        }
    }

    /// Waits for the last submission.
    ///
    /// # Errors
    /// As [`Submission::wait`].
    pub fn finish(&mut self) -> Result<(), DeviceError> {
        self.0.take().map_or(Ok(()), |last| last.wait())
    }
}

impl Gpu {
    /// Copies elements to the host and waits for the device.
    ///
    /// # Errors
    /// Errors of the device.
    pub fn read<T: Pod>(&self, buffer: &Buffer<T>, range: Range<usize>) -> Result<Vec<T>, DeviceError> {
        self.healthy()?;
        let mut recorder = self.record();
        let ticket = recorder.fetch(buffer, range);
        if ticket.len == 0 {
            return Ok(Vec::new());
        }
        recorder.submit()?.wait_for_data()?.read(&ticket)
    }

    /// The smallest sufficient staging buffer of the pool, or a new one.
    fn staging(&self, bytes: u64) -> Result<wgpu::Buffer, DeviceError> {
        let mut kept = locked(&self.inner.staging);
        let fitting = (0..kept.len()).filter(|&i| kept[i].size() >= bytes).min_by_key(|&i| kept[i].size());
        if let Some(i) = fitting {
            return Ok(kept.remove(i));
        }
        drop(kept);
        let most = self.inner.report.max_buffer;
        if bytes > most {
            return Err(DeviceError::TooLarge {
                what: "the read-back buffer".to_owned(),
                needs: bytes,
                most,
            });
        }
        let scope = self.inner.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let buffer = self.inner.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("staging"),
            size: bytes.next_power_of_two().max(MIN_STAGING_BYTES).min(most),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        match pollster::block_on(scope.pop()) {
            Some(_) => Err(DeviceError::OutOfMemory { what: "the read-back buffer".to_owned(), bytes }),
            None => Ok(buffer),
        }
    }
}
