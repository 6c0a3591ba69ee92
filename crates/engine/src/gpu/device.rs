//! An open device: memory, pipelines, and error handling.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bytemuck::Pod;

use crate::gpu::adapter::Adapters;
use crate::gpu::bind_groups::BindGroups;
use crate::gpu::buffer::{Buffer, MemoryAccount};
use crate::gpu::counters::{DeviceCounters, DeviceCounts};
use crate::gpu::lock::locked;
use crate::gpu::shaders::{BindingKind, Kernel};
use crate::gpu::timing::{StageTime, Timings};
use crate::gpu::trusted;
use crate::{AdapterReport, DeviceError};

/// Timeout of waits for the device, s.
pub(super) const DEVICE_TIMEOUT_S: u64 = 120;
/// Size of the buffer that the uniforms of one recording share, bytes.
pub(super) const UNIFORM_BYTES: u64 = 256 << 10;
/// Size of the smallest buffer, bytes: an empty array is still bound as one element of any type.
const MIN_BUFFER_BYTES: u64 = 256;
/// Content of new buffers with the option `garbage`.
const GARBAGE: f32 = -12345.0;

/// Options of an open device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GpuOptions {
    /// Bounds checks in shaders (slow); off relies on the kernels' own guards.
    pub checks: bool,
    /// Fill new buffers with garbage, to detect reliance on zeroed memory.
    pub garbage: bool,
    /// Use the compare-exchange loop for float sums even where the device has float atomics.
    pub compare_exchange: bool,
    /// Limit the size of a binding to this number of bytes, as on a smaller device.
    pub binding_limit: Option<u64>,
}

impl GpuOptions {
    /// Options with `checks` from `RELUME_GPU_CHECKS` (`on`, `off`); if it is unset, on in debug builds only.
    pub fn from_env() -> Self {
        let checks = match std::env::var("RELUME_GPU_CHECKS").as_deref() {
            Ok("on") => true,
            Ok("off") => false,
            _ => cfg!(debug_assertions),
        };
        Self { checks, ..Self::default() }
    }
}

/// A pipeline and the layout of its bind groups.
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
    /// Locked from filling the shared uniforms to the submission that reads them.
    pub(super) submitting: Mutex<()>,
    pub(super) timings: Mutex<Option<Timings>>,
    /// Idle staging buffers.
    pub(super) staging: Mutex<Vec<wgpu::Buffer>>,
    pub(super) counters: DeviceCounters,
    pub(super) bind_groups: BindGroups,
    options: GpuOptions,
    pipelines: Mutex<HashMap<&'static str, Arc<Pipeline>>>,
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
        report.max_binding = report.max_binding.min(options.binding_limit.unwrap_or(u64::MAX));
        let inner = Inner {
            device,
            queue,
            report,
            uniforms,
            uniform_align,
            submitting: Mutex::default(),
            timings: Mutex::new(None),
            staging: Mutex::default(),
            counters: DeviceCounters::default(),
            bind_groups: BindGroups::default(),
            options,
            pipelines: Mutex::default(),
            memory: Arc::default(),
            fault,
        };
        Ok(Self { inner: Arc::new(inner) })
    }

    /// Report of the device's adapter.
    pub fn report(&self) -> &AdapterReport {
        &self.inner.report
    }

    /// Bytes of device memory in use, and their peak so far.
    pub fn memory(&self) -> (u64, u64) {
        (self.inner.memory.used(), self.inner.memory.peak())
    }

    /// Fails when the device has had an error since it was opened.
    ///
    /// # Errors
    /// The first error of the device.
    pub fn healthy(&self) -> Result<(), DeviceError> {
        locked(&self.inner.fault).clone().map_or(Ok(()), Err)
    }

    /// A buffer of `len` elements, contents undefined.
    ///
    /// # Errors
    /// [`DeviceError::TooLarge`] with the numbers when it exceeds one binding; [`DeviceError::OutOfMemory`].
    pub fn buffer<T: Pod>(&self, label: &str, len: usize) -> Result<Buffer<T>, DeviceError> {
        self.healthy()?;
        self.forget_freed();
        let bytes =
            (len as u64).saturating_mul(size_of::<T>() as u64).max(MIN_BUFFER_BYTES).next_multiple_of(16);
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

    /// Overwrites elements from `offset` on; elements beyond the end are skipped.
    pub fn write<T: Pod>(&self, buffer: &Buffer<T>, offset: usize, data: &[T]) {
        let fits = buffer.len().saturating_sub(offset).min(data.len());
        let bytes: &[u8] = bytemuck::cast_slice(&data[..fits]);
        if !bytes.is_empty() {
            self.inner.queue.write_buffer(buffer.raw(), (offset * size_of::<T>()) as u64, bytes);
        }
    }

    /// Waits until the device has completed all submissions.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`] after 120 s, or another error of the device.
    pub fn wait(&self) -> Result<(), DeviceError> {
        self.wait_for(None)
    }

    /// Waits until the device has completed one submission and all earlier ones; without an index, the last submission.
    pub(super) fn wait_for(
        &self,
        submission_index: Option<wgpu::SubmissionIndex>,
    ) -> Result<(), DeviceError> {
        let (timeout, start) = (Some(Duration::from_secs(DEVICE_TIMEOUT_S)), Instant::now());
        let polled = self.inner.device.poll(wgpu::PollType::Wait { submission_index, timeout });
        self.inner.counters.waited(start.elapsed());
        match polled {
            Ok(_) => self.healthy(),
            Err(wgpu::PollError::Timeout) => {
                let mut fault = locked(&self.inner.fault);
                Err(fault.get_or_insert(DeviceError::Timeout(DEVICE_TIMEOUT_S)).clone())
            }
            Err(error) => Err(self.failure(error.to_string())),
        }
    }

    /// Counts of the device's work so far.
    pub fn counts(&self) -> DeviceCounts {
        self.inner.counters.counts()
    }

    /// Destroys the device: every later call fails with [`DeviceError::Lost`].
    pub fn destroy(&self) {
        locked(&self.inner.fault).get_or_insert(DeviceError::Lost("it was given up".to_owned()));
        self.inner.device.destroy();
    }

    /// Starts or stops measuring the time of each stage; measuring waits for the device after every submission.
    pub fn measure(&self, on: bool) {
        let able = on && self.inner.report.timestamps;
        *locked(&self.inner.timings) = able.then(Timings::default);
    }

    /// Time of each stage since [`Self::measure`], in order of first appearance.
    pub fn timings(&self) -> Vec<StageTime> {
        locked(&self.inner.timings).as_ref().map(Timings::listed).unwrap_or_default()
    }

    /// Frees memory that only cached bind groups hold.
    pub(super) fn forget_freed(&self) {
        self.inner.bind_groups.forget(&self.inner.memory.take_freed());
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

    /// The recorded first fault, else this one.
    pub(super) fn failure(&self, text: String) -> DeviceError {
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
        ty: wgpu::BindingType::Buffer {
            ty,
            has_dynamic_offset: kind == BindingKind::Uniform,
            min_binding_size: None,
        },
        count: None,
    }
}

/// Records the first fault of the device; by default wgpu panics.
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

    /// As [`Self::for_tests`], with other options and not shared.
    pub fn with_options(options: GpuOptions) -> Self {
        let adapters = Adapters::find();
        let usable = adapters.reports().iter().position(|r| r.lacks.is_empty());
        let index = usable.expect("this test needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)");
        Self::open(&adapters, index, options).expect("the adapter opens")
    }
}
