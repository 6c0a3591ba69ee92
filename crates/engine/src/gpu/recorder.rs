//! Recording of dispatches, clears and copies, submitted together.

use std::ops::Range;
use std::time::Instant;

use crate::DeviceError;
use crate::gpu::bind_groups::{BindKey, Bound};
use crate::gpu::buffer::Buffer;
use crate::gpu::device::{Gpu, UNIFORM_BYTES};
use crate::gpu::lock::locked;
use crate::gpu::readback::{ReadbackCopies, ReadbackTicket, Submission};
use crate::gpu::shaders::Kernel;

/// Maximum number of workgroups in one dimension of a dispatch.
const MAX_WORKGROUPS: u64 = 65_535;
/// Maximum number of timed stages per submission.
const MAX_STAGES: u32 = 128;

/// Workgroups of a dispatch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Groups {
    /// Enough workgroups for this number of invocations, folded into two dimensions (`invocation_ix` of `index.wgsl`).
    Linear(usize),
    /// This number of workgroups, folded into two dimensions (`workgroup_ix` of `index.wgsl`).
    Workgroups(usize),
    /// Columns and rows, each at most 65,535.
    Grid(u32, u32),
}

impl Groups {
    /// Dispatch dimensions for workgroups of `size` invocations.
    fn dimensions(self, size: [u32; 3]) -> [u32; 2] {
        let folded = |groups: u64| {
            let columns = groups.min(MAX_WORKGROUPS);
            [columns as u32, groups.div_ceil(columns.max(1)).min(MAX_WORKGROUPS) as u32]
        };
        match self {
            Self::Linear(n) => folded((n as u64).div_ceil(u64::from(size.iter().product::<u32>().max(1)))),
            Self::Workgroups(n) => folded(n as u64),
            Self::Grid(x, y) => [x, y],
        }
    }
}

/// One binding of a dispatch.
pub enum Bind<'a> {
    /// A buffer, the size of its elements in bytes (so that `arrayLength` counts these), and the number of its memory block.
    Buffer(&'a wgpu::Buffer, u64, u64),
    /// The bytes of a uniform struct.
    Uniform(Vec<u8>),
}

impl<'a, T> From<&'a Buffer<T>> for Bind<'a> {
    fn from(buffer: &'a Buffer<T>) -> Self {
        Self::Buffer(buffer.raw(), buffer.bytes(), buffer.number())
    }
}

impl Bind<'_> {
    /// Its entry in a bind group. A uniform lies in `uniforms`, at an offset that each dispatch gives.
    fn entry<'b>(&'b self, binding: u32, uniforms: &'b wgpu::Buffer) -> wgpu::BindGroupEntry<'b> {
        let (buffer, bytes) = match self {
            Self::Buffer(buffer, bytes, _) => (*buffer, *bytes),
            Self::Uniform(bytes) => (uniforms, bytes.len() as u64),
        };
        let size = std::num::NonZero::new(bytes);
        let resource = wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset: 0, size });
        wgpu::BindGroupEntry { binding, resource }
    }

    fn bound(&self) -> Bound {
        match self {
            Self::Buffer(_, bytes, memory) => Bound::Memory(*memory, *bytes),
            Self::Uniform(bytes) => Bound::Uniform(bytes.len() as u64),
        }
    }
}

/// A uniform struct as a binding.
pub fn uniform<T: bytemuck::Pod>(value: &T) -> Bind<'static> {
    Bind::Uniform(bytemuck::bytes_of(value).to_vec())
}

/// A recording of work for the device, in order; [`Recorder::submit`] submits it.
pub struct Recorder<'g> {
    gpu: &'g Gpu,
    encoder: wgpu::CommandEncoder,
    pass: Option<wgpu::ComputePass<'static>>,
    uniforms: Vec<u8>,
    stage: &'static str,
    queries: Option<(wgpu::QuerySet, Vec<&'static str>)>,
    work: Vec<(&'static str, u64, u64)>,
    dispatches: u32,
    fetches: ReadbackCopies,
}

impl Gpu {
    /// Starts recording work.
    pub fn record(&self) -> Recorder<'_> {
        Recorder::new(self)
    }
}

impl<'g> Recorder<'g> {
    fn new(gpu: &'g Gpu) -> Self {
        gpu.forget_freed();
        let device = &gpu.inner.device;
        let queries = locked(&gpu.inner.timings).is_some().then(|| {
            let descriptor = wgpu::QuerySetDescriptor {
                label: Some("stages"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * MAX_STAGES,
            };
            (device.create_query_set(&descriptor), Vec::new())
        });
        let encoder = device.create_command_encoder(&Default::default());
        Self {
            gpu,
            encoder,
            pass: None,
            uniforms: Vec::new(),
            stage: "other",
            queries,
            work: Vec::new(),
            dispatches: 0,
            fetches: ReadbackCopies::default(),
        }
    }

    /// The device of the recording.
    pub fn gpu(&self) -> &'g Gpu {
        self.gpu
    }

    /// Starts a stage with this name, for [`Gpu::timings`].
    pub fn stage(&mut self, name: &'static str) {
        if self.stage != name {
            self.stage = name;
            if self.queries.is_some() {
                self.pass = None;
            }
        }
    }

    /// Adds to the minimum bytes and operations of the current stage, for the comparison with the device's limits.
    pub fn work(&mut self, bytes: u64, flops: u64) {
        if self.queries.is_some() {
            self.work.push((self.stage, bytes, flops));
        }
    }

    /// Dispatches `kernel` with `bindings` 0, 1, 2, ...; a dispatch without workgroups is skipped.
    pub fn dispatch(&mut self, kernel: &'static Kernel, groups: Groups, bindings: &[Bind<'_>]) {
        debug_assert_eq!(bindings.len(), kernel.bindings.len(), "bindings of {}", kernel.name);
        let [x, y] = groups.dimensions(kernel.workgroup);
        if x == 0 || y == 0 {
            return;
        }
        let pipeline = self.gpu.pipeline(kernel);
        let (group, offsets) = self.bind(kernel, &pipeline.layout, bindings);
        let pass = self.compute_pass();
        pass.set_pipeline(&pipeline.pipeline);
        pass.set_bind_group(0, &group, &offsets);
        pass.dispatch_workgroups(x, y, 1);
        self.dispatches += 1;
    }

    /// The bind group of `bindings`, and the offsets of its uniforms.
    fn bind(
        &mut self,
        kernel: &'static Kernel,
        layout: &wgpu::BindGroupLayout,
        bindings: &[Bind<'_>],
    ) -> (wgpu::BindGroup, Vec<u32>) {
        let gpu = self.gpu;
        let offsets = self.place(bindings);
        let make = |uniforms: &wgpu::Buffer| {
            let entries: Vec<_> = bindings.iter().zip(0..).map(|(bind, i)| bind.entry(i, uniforms)).collect();
            let descriptor =
                wgpu::BindGroupDescriptor { label: Some(kernel.name), layout, entries: &entries };
            gpu.inner.device.create_bind_group(&descriptor)
        };
        match offsets {
            Ok(offsets) => {
                let bound = bindings.iter().map(Bind::bound).collect();
                let key = BindKey::new(kernel, bound);
                (gpu.inner.bind_groups.get(key, || make(&gpu.inner.uniforms)), offsets)
            }
            Err((buffer, offsets)) => (make(&buffer), offsets),
        }
    }

    /// Zeroes a buffer.
    pub fn clear<T>(&mut self, buffer: &Buffer<T>) {
        self.pass = None;
        self.encoder.clear_buffer(buffer.raw(), 0, None);
    }

    /// Copies `len` elements of four bytes or a multiple of them.
    pub fn copy<T>(
        &mut self,
        from: &Buffer<T>,
        from_offset: usize,
        to: &Buffer<T>,
        to_offset: usize,
        len: usize,
    ) {
        let len = len.min(from.len().saturating_sub(from_offset)).min(to.len().saturating_sub(to_offset));
        if len == 0 {
            return;
        }
        self.pass = None;
        let bytes = |n: usize| (n * size_of::<T>()) as u64;
        let (source, target) = (bytes(from_offset), bytes(to_offset));
        self.encoder.copy_buffer_to_buffer(from.raw(), source, to.raw(), target, bytes(len));
    }

    /// Requests a copy of elements of a buffer to the host, in their state at the end of the recording. Elements beyond the
    /// end are skipped.
    pub fn fetch<T>(&mut self, buffer: &Buffer<T>, range: Range<usize>) -> ReadbackTicket<T> {
        self.fetches.add(buffer, range)
    }

    /// Submits everything to the device.
    ///
    /// # Errors
    /// Errors of the device, from this or from earlier work.
    pub fn submit(mut self) -> Result<Submission, DeviceError> {
        // The span measures the submission by the host; the device continues after it.
        let _span = tracing::debug_span!("kernels", dispatches = self.dispatches).entered();
        self.pass = None;
        let inner = &self.gpu.inner;
        // Recordings of other threads share the uniforms.
        let submitting = locked(&inner.submitting);
        if !self.uniforms.is_empty() {
            inner.queue.write_buffer(&inner.uniforms, 0, &self.uniforms);
        }
        let resolved = self.queries.take().filter(|(_, names)| !names.is_empty()).map(|(set, names)| {
            let count = 2 * names.len() as u32;
            let usage = wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC;
            let descriptor = wgpu::BufferDescriptor {
                label: Some("stage times"),
                size: u64::from(count) * 8,
                usage,
                mapped_at_creation: false,
            };
            let buffer = inner.device.create_buffer(&descriptor);
            self.encoder.resolve_query_set(&set, 0..count, &buffer, 0);
            (Buffer::<u64>::new(buffer, count as usize, &Default::default()), names)
        });
        let staging = std::mem::take(&mut self.fetches).record(self.gpu, &mut self.encoder)?;
        let (commands, start) = (self.encoder.finish(), Instant::now());
        let index = inner.queue.submit([commands]);
        let number = inner.counters.submit(self.dispatches, start.elapsed());
        drop(submitting);
        let submission = Submission::new(self.gpu, index, number, staging);
        if let Some((buffer, names)) = resolved {
            let ticks = self.gpu.read(&buffer, 0..buffer.len())?;
            let period = f64::from(inner.queue.get_timestamp_period()) * 1e-6;
            if let Some(timings) = locked(&inner.timings).as_mut() {
                for (name, bytes, flops) in &self.work {
                    timings.add(name, [0.0, *bytes as f64, *flops as f64]);
                }
                for (name, pair) in names.iter().zip(ticks.as_chunks::<2>().0) {
                    timings.add(name, [pair[1].saturating_sub(pair[0]) as f64 * period, 0.0, 0.0]);
                }
            }
        }
        self.gpu.healthy()?;
        Ok(submission)
    }

    /// Appends the uniforms among `bindings` to this recording's uniforms and returns their offsets. When the shared buffer is
    /// full, they go to a separate buffer, which is returned as well.
    fn place(&mut self, bindings: &[Bind<'_>]) -> Result<Vec<u32>, (wgpu::Buffer, Vec<u32>)> {
        let inner = &self.gpu.inner;
        let structs = || {
            bindings.iter().filter_map(|bind| match bind {
                Bind::Uniform(bytes) => Some(bytes),
                Bind::Buffer(..) => None,
            })
        };
        let append = |all: &mut Vec<u8>| -> Vec<u32> {
            structs()
                .map(|bytes| {
                    let offset = all.len().next_multiple_of(inner.uniform_align as usize);
                    all.resize(offset, 0);
                    all.extend_from_slice(bytes);
                    offset as u32
                })
                .collect()
        };
        let most: u64 = structs().map(|bytes| bytes.len() as u64 + inner.uniform_align).sum();
        if self.uniforms.len() as u64 + most <= UNIFORM_BYTES {
            return Ok(append(&mut self.uniforms));
        }
        // The recording has more uniforms than the shared buffer holds.
        let mut own = Vec::new();
        let offsets = append(&mut own);
        let buffer = inner.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("uniforms of one dispatch"),
            size: own.len().next_multiple_of(16) as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        inner.queue.write_buffer(&buffer, 0, &own);
        Err((buffer, offsets))
    }

    fn compute_pass(&mut self) -> &mut wgpu::ComputePass<'static> {
        let Self { encoder, queries, stage, pass, .. } = self;
        pass.get_or_insert_with(|| {
            let timed = queries.as_mut().filter(|(_, names)| (names.len() as u32) < MAX_STAGES);
            let timestamp_writes = timed.map(|(set, names)| {
                names.push(stage);
                let first = 2 * (names.len() as u32 - 1);
                wgpu::ComputePassTimestampWrites {
                    query_set: &*set,
                    beginning_of_pass_write_index: Some(first),
                    end_of_pass_write_index: Some(first + 1),
                }
            });
            let descriptor = wgpu::ComputePassDescriptor { label: Some(stage), timestamp_writes };
            encoder.begin_compute_pass(&descriptor).forget_lifetime()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_dispatches_are_folded_into_two_dimensions() {
        let size = [256, 1, 1];
        assert_eq!(Groups::Linear(0).dimensions(size)[0], 0);
        assert_eq!(Groups::Linear(257).dimensions(size), [2, 1]);
        let [x, y] = Groups::Linear(65_536 * 256).dimensions(size);
        assert!(x == 65_535 && y == 2);
        assert_eq!(Groups::Grid(3, 4).dimensions([16, 16, 1]), [3, 4]);
    }
}
