//! An open device: memory, pipelines, and what to do when it fails.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bytemuck::Pod;

use crate::engine::AdapterReport;
use crate::engine::DeviceError;
use crate::engine::gpu::adapter::Adapters;
use crate::engine::gpu::buffer::{Buffer, MemoryAccount};
use crate::engine::gpu::shaders::{BindingKind, Kernel};
use crate::engine::gpu::timing::{StageTime, Timings};
use crate::engine::gpu::trusted;

/// How long the host waits for the device before it gives up on it, s.
const PATIENCE: u64 = 120;
/// Bytes of the buffer that one recording's uniforms share.
pub(super) const UNIFORM_BYTES: u64 = 256 << 10;
/// Bytes of the smallest buffer: an empty array is still bound as one element of any kind.
const LEAST_BYTES: u64 = 256;
/// What fresh buffers hold when garbage is asked for.
const GARBAGE: f32 = -12345.0;

/// How a device is opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GpuOptions {
    /// Bounds checks in shaders (slow); off relies on the kernels' own guards.
    pub checks: bool,
    /// Fill fresh buffers with garbage, so that nobody relies on zeroed memory.
    pub garbage: bool,
    /// Add floats by compare and exchange even where the device could do it natively.
    pub compare_exchange: bool,
    /// Bind no more than this many bytes at once, as if the device could not.
    pub most_binding: Option<u64>,
}

impl GpuOptions {
    /// Checks as `RELUME_GPU_CHECKS` (`on`, `off`) says; unset, on in debug builds only.
    pub fn from_env() -> Self {
        let checks = match std::env::var("RELUME_GPU_CHECKS").as_deref() {
            Ok("on") => true,
            Ok("off") => false,
            _ => cfg!(debug_assertions),
        };
        Self { checks, ..Self::default() }
    }
}

/// A pipeline and the layout its bind groups have.
pub(super) struct Pipeline {
    pub(super) pipeline: wgpu::ComputePipeline,
    pub(super) layout: wgpu::BindGroupLayout,
}

pub(super) struct Inner {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) report: AdapterReport,
    pub(super) uniforms: wgpu::Buffer,
    pub(super) uniform_align: u64,
    /// Held from filling the shared uniforms to the submission that reads them.
    pub(super) submitting: Mutex<()>,
    pub(super) timings: Mutex<Option<Timings>>,
    options: GpuOptions,
    pipelines: Mutex<HashMap<&'static str, Arc<Pipeline>>>,
    staging: Mutex<Option<wgpu::Buffer>>,
    memory: Arc<MemoryAccount>,
    fault: Arc<Mutex<Option<DeviceError>>>,
}

/// An open device. A clone is another handle on the same device.
#[derive(Clone)]
pub struct Gpu {
    pub(super) inner: Arc<Inner>,
}

impl std::fmt::Debug for Gpu {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Gpu").field("adapter", &self.inner.report.name).finish_non_exhaustive()
    }
}

/// A lock whose data is whole whatever happened to its last holder.
pub(super) fn locked<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Gpu {
    /// Opens adapter `index`.
    ///
    /// # Errors
    /// [`DeviceError::Unavailable`] when the driver refuses.
    pub fn open(adapters: &Adapters, index: usize, options: GpuOptions) -> Result<Self, DeviceError> {
        let (adapter, report) = adapters
            .adapter(index)
            .ok_or_else(|| DeviceError::Unavailable(format!("device: there is no gpu:{index}")))?;
        if !report.lacks.is_empty() {
            let lacks = report.lacks.join("; ");
            return Err(DeviceError::Unavailable(format!("device gpu:{index}: {lacks}")));
        }
        let wanted = wgpu::Features::SHADER_FLOAT32_ATOMIC | wgpu::Features::TIMESTAMP_QUERY;
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("relume"),
            required_features: adapter.features() & wanted,
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|e| DeviceError::Unavailable(format!("device gpu:{index}: {e}")))?;
        let fault = Arc::new(Mutex::new(None));
        watch(&device, &fault);
        let uniforms = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("uniforms"),
            size: UNIFORM_BYTES,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let uniform_align = u64::from(adapter.limits().min_uniform_buffer_offset_alignment).max(16);
        let mut report = report.clone();
        report.max_binding = report.max_binding.min(options.most_binding.unwrap_or(u64::MAX));
        let inner = Inner {
            device,
            queue,
            report,
            uniforms,
            uniform_align,
            submitting: Mutex::default(),
            timings: Mutex::new(None),
            options,
            pipelines: Mutex::default(),
            staging: Mutex::default(),
            memory: Arc::default(),
            fault,
        };
        Ok(Self { inner: Arc::new(inner) })
    }

    /// The adapter behind this device.
    pub fn report(&self) -> &AdapterReport {
        &self.inner.report
    }

    /// Bytes of device memory in use, and their peak so far.
    pub fn memory(&self) -> (u64, u64) {
        (self.inner.memory.used(), self.inner.memory.peak())
    }

    /// Fails when something went wrong on the device since it was opened.
    ///
    /// # Errors
    /// What went wrong first.
    pub fn healthy(&self) -> Result<(), DeviceError> {
        locked(&self.inner.fault).clone().map_or(Ok(()), Err)
    }

    /// Room for `len` elements, contents undefined.
    ///
    /// # Errors
    /// [`DeviceError::TooLarge`] with the numbers when one binding cannot hold it, [`DeviceError::OutOfMemory`].
    pub fn buffer<T: Pod>(&self, label: &str, len: usize) -> Result<Buffer<T>, DeviceError> {
        self.healthy()?;
        let bytes = (len as u64).saturating_mul(size_of::<T>() as u64).max(LEAST_BYTES).next_multiple_of(16);
        let most = self.inner.report.max_binding.min(self.inner.report.max_buffer);
        if bytes > most {
            return Err(DeviceError::TooLarge { what: label.to_owned(), needs: bytes, most });
        }
        let scope = self.inner.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let buffer = self.inner.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        if pollster::block_on(scope.pop()).is_some() {
            return Err(DeviceError::OutOfMemory { what: label.to_owned(), bytes });
        }
        if self.inner.options.garbage {
            let garbage = vec![GARBAGE; (bytes / 4) as usize];
            self.inner.queue.write_buffer(&buffer, 0, bytemuck::cast_slice(&garbage));
        }
        Ok(Buffer::new(buffer, len, &self.inner.memory))
    }

    /// A buffer with these elements.
    ///
    /// # Errors
    /// As [`Self::buffer`].
    pub fn upload<T: Pod>(&self, label: &str, data: &[T]) -> Result<Buffer<T>, DeviceError> {
        let buffer = self.buffer(label, data.len())?;
        self.write(&buffer, 0, data);
        Ok(buffer)
    }

    /// Overwrites elements from `offset` on; what would lie beyond the end is left out.
    pub fn write<T: Pod>(&self, buffer: &Buffer<T>, offset: usize, data: &[T]) {
        let fits = buffer.len().saturating_sub(offset).min(data.len());
        let bytes: &[u8] = bytemuck::cast_slice(&data[..fits]);
        if !bytes.is_empty() {
            self.inner.queue.write_buffer(buffer.raw(), (offset * size_of::<T>()) as u64, bytes);
        }
    }

    /// Copies elements to the host; waits for the device.
    ///
    /// # Errors
    /// Whatever went wrong on the device meanwhile.
    pub fn read<T: Pod>(&self, buffer: &Buffer<T>, range: Range<usize>) -> Result<Vec<T>, DeviceError> {
        self.healthy()?;
        let range = range.start.min(buffer.len())..range.end.min(buffer.len());
        if range.is_empty() {
            return Ok(Vec::new());
        }
        let (start, end) = (range.start * size_of::<T>(), range.end * size_of::<T>());
        // Copies are in units of four bytes.
        let (first, last) = ((start / 4 * 4) as u64, end.next_multiple_of(4) as u64);
        let staging = self.staging(last - first);
        let mut encoder = self.inner.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(buffer.raw(), first, &staging, 0, last - first);
        self.inner.queue.submit([encoder.finish()]);
        let slice = staging.slice(..last - first);
        let (sender, receiver) = std::sync::mpsc::channel();
        slice.map_async(wgpu::MapMode::Read, move |result| {
            let _ = sender.send(result);
        });
        self.wait()?;
        // The callback may run in another thread that waits too, a moment after this one's wait is over.
        match receiver.recv_timeout(Duration::from_secs(PATIENCE)) {
            Ok(Ok(())) => {}
            other => return Err(self.failure(format!("a buffer could not be read: {other:?}"))),
        }
        let mut out = vec![T::zeroed(); range.len()];
        {
            let mapped = slice.get_mapped_range().map_err(|e| self.failure(e.to_string()))?;
            let skip = start - first as usize;
            let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut out);
            bytes.copy_from_slice(&mapped[skip..skip + end - start]);
        }
        staging.unmap();
        *locked(&self.inner.staging) = Some(staging);
        self.healthy()?;
        Ok(out)
    }

    /// Waits until the device has done all that was submitted.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`] when it takes too long, or what went wrong meanwhile.
    pub fn wait(&self) -> Result<(), DeviceError> {
        let timeout = Some(Duration::from_secs(PATIENCE));
        match self.inner.device.poll(wgpu::PollType::Wait { submission_index: None, timeout }) {
            Ok(_) => self.healthy(),
            Err(wgpu::PollError::Timeout) => {
                let mut fault = locked(&self.inner.fault);
                Err(fault.get_or_insert(DeviceError::Timeout(PATIENCE)).clone())
            }
            Err(error) => Err(self.failure(error.to_string())),
        }
    }

    /// Gives the device up: everything asked of it from now on fails with [`DeviceError::Lost`].
    pub fn destroy(&self) {
        locked(&self.inner.fault).get_or_insert(DeviceError::Lost("it was given up".to_owned()));
        self.inner.device.destroy();
    }

    /// Starts or stops measuring the time of each stage; measuring waits for the device after every submission.
    pub fn measure(&self, on: bool) {
        let able = on && self.inner.report.timestamps;
        *locked(&self.inner.timings) = able.then(Timings::default);
    }

    /// What each stage took since [`Self::measure`], in order of first appearance.
    pub fn timings(&self) -> Vec<StageTime> {
        locked(&self.inner.timings).as_ref().map(Timings::listed).unwrap_or_default()
    }

    pub(super) fn pipeline(&self, kernel: &'static Kernel) -> Arc<Pipeline> {
        if let Some(found) = locked(&self.inner.pipelines).get(kernel.name) {
            return found.clone();
        }
        let made = Arc::new(self.compile(kernel));
        locked(&self.inner.pipelines).insert(kernel.name, made.clone());
        made
    }

    fn compile(&self, kernel: &'static Kernel) -> Pipeline {
        let device = &self.inner.device;
        let native = self.inner.report.float_atomics && !self.inner.options.compare_exchange;
        let source = if native { kernel.source } else { kernel.fallback.unwrap_or(kernel.source) };
        let module = if self.inner.options.checks {
            device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(kernel.name),
                source: wgpu::ShaderSource::Wgsl(source.into()),
            })
        } else {
            trusted::unchecked_module(device, kernel.name, source)
        };
        let entries: Vec<wgpu::BindGroupLayoutEntry> =
            kernel.bindings.iter().enumerate().map(|(i, kind)| layout_entry(i as u32, *kind)).collect();
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(kernel.name),
            entries: &entries,
        });
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(kernel.name),
            bind_group_layouts: &[Some(&layout)],
            ..Default::default()
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(kernel.name),
            layout: Some(&pipeline_layout),
            module: &module,
            entry_point: Some("main"),
            // Every kernel writes its workgroup memory before it reads it.
            compilation_options: wgpu::PipelineCompilationOptions {
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            cache: None,
        });
        Pipeline { pipeline, layout }
    }

    fn staging(&self, bytes: u64) -> wgpu::Buffer {
        let kept = locked(&self.inner.staging).take();
        kept.filter(|b| b.size() >= bytes).unwrap_or_else(|| {
            self.inner.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("staging"),
                size: bytes.next_power_of_two().max(4096),
                usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        })
    }

    /// The fault on record, or else this one.
    fn failure(&self, text: String) -> DeviceError {
        locked(&self.inner.fault).get_or_insert(DeviceError::Internal(text)).clone()
    }
}

fn layout_entry(binding: u32, kind: BindingKind) -> wgpu::BindGroupLayoutEntry {
    let ty = match kind {
        BindingKind::Uniform => wgpu::BufferBindingType::Uniform,
        BindingKind::Read => wgpu::BufferBindingType::Storage { read_only: true },
        BindingKind::Write => wgpu::BufferBindingType::Storage { read_only: false },
    };
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    }
}

/// Keeps the first fault of the device: wgpu's own reaction would be to panic.
fn watch(device: &wgpu::Device, fault: &Arc<Mutex<Option<DeviceError>>>) {
    let uncaptured = fault.clone();
    device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
        let error = match error {
            wgpu::Error::OutOfMemory { .. } => {
                DeviceError::OutOfMemory { what: "a command".into(), bytes: 0 }
            }
            other => DeviceError::Internal(other.to_string()),
        };
        tracing::error!(%error, "the device reported an error");
        locked(&uncaptured).get_or_insert(error);
    }));
    let lost = fault.clone();
    device.set_device_lost_callback(move |reason, text| {
        if reason != wgpu::DeviceLostReason::Destroyed {
            locked(&lost).get_or_insert(DeviceError::Lost(text));
        }
    });
}

#[cfg(test)]
impl Gpu {
    /// Any usable adapter, software or not, with garbage in fresh buffers. Shared by all tests.
    pub fn for_tests() -> Self {
        static SHARED: std::sync::LazyLock<Gpu> = std::sync::LazyLock::new(|| {
            let options = GpuOptions { garbage: true, ..GpuOptions::from_env() };
            Gpu::with_options(options)
        });
        SHARED.clone()
    }

    /// As [`Self::for_tests`], with other options and shared with nobody.
    pub fn with_options(options: GpuOptions) -> Self {
        let adapters = Adapters::find();
        let usable = adapters.reports().iter().position(|r| r.lacks.is_empty());
        let index = usable.expect("this test needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)");
        Self::open(&adapters, index, options).expect("the adapter opens")
    }
}
