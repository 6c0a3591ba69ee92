//! Buffers that are reused and only grow.

use bytemuck::Pod;

use crate::DeviceError;
use crate::gpu::buffer::Buffer;
use crate::gpu::device::Gpu;

/// Makes `buffer` at least `len` elements long. A buffer that grows loses its content.
///
/// It grows by at least a quarter, so that slow growth does not allocate on each use.
///
/// # Errors
/// As [`Gpu::buffer`].
pub fn grow<T: Pod>(
    gpu: &Gpu,
    label: &str,
    buffer: &mut Option<Buffer<T>>,
    len: usize,
) -> Result<Buffer<T>, DeviceError> {
    if let Some(kept) = buffer.as_ref().filter(|b| b.len() >= len) {
        return Ok(kept.clone());
    }
    let roomy = buffer.as_ref().map_or(len, |b| len.max(b.len() + b.len() / 4));
    // The old memory is freed first: both at once may not fit.
    *buffer = None;
    let made = gpu.buffer(label, roomy).or_else(|_| gpu.buffer(label, len))?;
    Ok(buffer.insert(made).clone())
}
