//! Exclusive prefix sums in device memory.

use bytemuck::{Pod, Zeroable};

use crate::DeviceError;
use crate::gpu::grow::grow;
use crate::gpu::{Buffer, Groups, Recorder, shaders, uniform};
use relume_layout::kernel_constants::SCAN_BLOCK;

/// `ScanSize` of `scan_blocks.wgsl` and `scan_add.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct ScanSize {
    n_in: u32,
    n_out: u32,
    pad_a: u32,
    pad_b: u32,
}

/// Memory for prefix sums, reused by each call.
#[derive(Debug, Default)]
pub struct Scan {
    levels: Vec<ScanLevel>,
}

/// Block totals of one level, and their own prefix sums.
#[derive(Debug, Default)]
struct ScanLevel {
    sums: Option<Buffer<u32>>,
    prefixes: Option<Buffer<u32>>,
}

impl Scan {
    /// `output[i] = input[0] + .. + input[i - 1]` for i = 0..=n. `output` has at least `n + 1` elements; element n is the
    /// total. Sums wrap at 2^32.
    ///
    /// # Errors
    /// [`DeviceError::Misuse`] when a buffer is too short, or as
    /// [`Gpu::buffer`](crate::gpu::Gpu::buffer).
    pub fn exclusive(
        &mut self,
        rec: &mut Recorder<'_>,
        input: &Buffer<u32>,
        output: &Buffer<u32>,
        n: usize,
    ) -> Result<(), DeviceError> {
        if input.len() < n || output.len() <= n {
            let text = format!("prefix sum of {n} from {} to {} elements", input.len(), output.len());
            return Err(DeviceError::Misuse(text));
        }
        self.level(rec, 0, (input, n), (output, n + 1))
    }

    fn level(
        &mut self,
        rec: &mut Recorder<'_>,
        depth: usize,
        (input, n_in): (&Buffer<u32>, usize),
        (output, n_out): (&Buffer<u32>, usize),
    ) -> Result<(), DeviceError> {
        if self.levels.len() <= depth {
            self.levels.push(ScanLevel::default());
        }
        let n_blocks = n_out.div_ceil(SCAN_BLOCK);
        let level = &mut self.levels[depth];
        let sums = grow(rec.gpu(), "block sums", &mut level.sums, n_blocks)?;
        let size = ScanSize { n_in: n_in as u32, n_out: n_out as u32, pad_a: 0, pad_b: 0 };
        let bindings = [uniform(&size), input.into(), output.into(), (&sums).into()];
        rec.dispatch(&shaders::SCAN_BLOCKS, Groups::Workgroups(n_blocks), &bindings);
        if n_blocks > 1 {
            let prefixes = grow(rec.gpu(), "block prefixes", &mut level.prefixes, n_blocks)?;
            self.level(rec, depth + 1, (&sums, n_blocks), (&prefixes, n_blocks))?;
            let bindings = [uniform(&size), (&prefixes).into(), output.into()];
            rec.dispatch(&shaders::SCAN_ADD, Groups::Linear(n_out), &bindings);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::Gpu;
    use crate::gpu::shaders::assert_layout;

    fn scanned(gpu: &Gpu, scan: &mut Scan, input: &[u32]) -> Vec<u32> {
        let (from, to) = (gpu.upload("in", input).unwrap(), gpu.buffer("out", input.len() + 1).unwrap());
        let mut rec = gpu.record();
        scan.exclusive(&mut rec, &from, &to, input.len()).unwrap();
        rec.submit().unwrap();
        gpu.read(&to, 0..input.len() + 1).unwrap()
    }

    fn expected(input: &[u32]) -> Vec<u32> {
        let mut sum = 0u32;
        let after = input.iter().map(|v| {
            sum = sum.wrapping_add(*v);
            sum
        });
        std::iter::once(0).chain(after).collect()
    }

    #[test]
    fn host_and_shader_agree_on_the_size_struct() {
        assert_layout!(ScanSize as "ScanSize" in shaders::SCAN_BLOCKS; n_in, n_out, pad_a, pad_b);
        assert_layout!(ScanSize as "ScanSize" in shaders::SCAN_ADD; n_in, n_out, pad_a, pad_b);
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn prefix_sums_of_any_length_are_exact_and_end_with_the_total() {
        let gpu = Gpu::for_tests();
        let mut scan = Scan::default();
        // Three levels need more than 1024^2 elements.
        for n in [0, 1, 3, 255, 1023, 1024, 1025, 5000, 1_048_576, 1_100_003] {
            let input: Vec<u32> = (0..n as u32).map(|i| i.wrapping_mul(2_654_435_761) >> 21).collect();
            let got = scanned(&gpu, &mut scan, &input);
            let wrong = got.iter().zip(expected(&input)).position(|(a, b)| *a != b);
            assert_eq!(wrong, None, "n = {n}");
        }
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn comparison_detects_one_changed_element() {
        let gpu = Gpu::for_tests();
        let mut input = vec![1u32; 3000];
        let before = expected(&input);
        input[2999] = 2;
        assert_ne!(scanned(&gpu, &mut Scan::default(), &input), before);
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn too_short_output_buffer_is_refused() {
        let gpu = Gpu::for_tests();
        let (from, to) = (gpu.upload("in", &[1u32; 8]).unwrap(), gpu.buffer("out", 8).unwrap());
        assert!(Scan::default().exclusive(&mut gpu.record(), &from, &to, 8).is_err());
    }
}
