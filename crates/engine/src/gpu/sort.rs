//! Stable radix sort of (key, value) pairs in device memory.

use bytemuck::{Pod, Zeroable};

use crate::DeviceError;
use crate::gpu::grow::grow;
use crate::gpu::scan::Scan;
use crate::gpu::{Buffer, Gpu, Groups, Recorder, shaders, uniform};
use relume_layout::kernel_constants::SORT_BLOCK;

/// Maximum number of bits per sort pass.
const PASS_BITS: u32 = 8;

/// `SortPass` of `shared/radix.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct SortPass {
    n: u32,
    n_blocks: u32,
    shift: u32,
    n_digits: u32,
}

/// Pairs in device memory.
#[derive(Debug, Clone)]
pub struct Pairs {
    /// Keys.
    pub keys: Buffer<u32>,
    /// Values, parallel to the keys.
    pub values: Buffer<u32>,
}

/// Number of pairs.
#[derive(Debug, Clone, Copy)]
pub struct PairCount<'a> {
    /// Upper bound of the number of pairs; memory is allocated for it.
    pub most: usize,
    /// Where only the device knows the number: element 0, clamped to `most`.
    pub counted: Option<&'a Buffer<u32>>,
}

impl From<usize> for PairCount<'_> {
    fn from(n: usize) -> Self {
        Self { most: n, counted: None }
    }
}

/// Memory for sorting, reused by each sort.
#[derive(Debug, Default)]
pub struct Sorter {
    /// One element, larger than any number of pairs.
    unlimited: Option<Buffer<u32>>,
    keys: [Option<Buffer<u32>>; 2],
    values: [Option<Buffer<u32>>; 2],
    counts: Option<Buffer<u32>>,
    places: Option<Buffer<u32>>,
    scan: Scan,
}

impl Sorter {
    /// The first `n` pairs in ascending order of the lowest `bits` bits of their keys (1 to 32); equal keys keep their order.
    /// The input is unchanged. The result lies in this sorter's memory and is valid until the next sort.
    /// Elements beyond `n` are undefined.
    ///
    /// # Errors
    /// [`DeviceError::Misuse`] when an input is shorter than `n` or `bits` out of range, or as
    /// [`Gpu::buffer`](crate::gpu::Gpu::buffer).
    pub fn sort<'a>(
        &mut self,
        rec: &mut Recorder<'_>,
        keys: &Buffer<u32>,
        values: &Buffer<u32>,
        n: impl Into<PairCount<'a>>,
        bits: u32,
    ) -> Result<Pairs, DeviceError> {
        let PairCount { most: n, counted } = n.into();
        if keys.len() < n || values.len() < n || !(1..=32).contains(&bits) {
            return Err(DeviceError::Misuse(format!(
                "sort of {n} pairs by {bits} bits from shorter buffers"
            )));
        }
        let limit = match counted {
            Some(counted) => counted.clone(),
            None => self.unlimited(rec.gpu())?,
        };
        let n_passes = bits.div_ceil(PASS_BITS);
        let mut from = Pairs { keys: keys.clone(), values: values.clone() };
        let mut shift = 0;
        for pass in 0..n_passes {
            // Bits are distributed evenly over the passes: smaller tables of counts cost less.
            let pass_bits = (bits - shift).div_ceil(n_passes - pass);
            let side = pass as usize % 2;
            let to = Pairs {
                keys: grow(rec.gpu(), "sorted keys", &mut self.keys[side], n)?,
                values: grow(rec.gpu(), "sorted values", &mut self.values[side], n)?,
            };
            self.pass(rec, [&from, &to], &limit, (n, shift, pass_bits))?;
            from = to;
            shift += pass_bits;
        }
        Ok(from)
    }

    /// One element, larger than any number of pairs, for kernels with a number that the host knows.
    pub(super) fn unlimited(&mut self, gpu: &Gpu) -> Result<Buffer<u32>, DeviceError> {
        match &self.unlimited {
            Some(unlimited) => Ok(unlimited.clone()),
            None => Ok(self.unlimited.insert(gpu.upload("no limit", &[u32::MAX])?).clone()),
        }
    }

    fn pass(
        &mut self,
        rec: &mut Recorder<'_>,
        [from, to]: [&Pairs; 2],
        limit: &Buffer<u32>,
        (n, shift, bits): (usize, u32, u32),
    ) -> Result<(), DeviceError> {
        let n_blocks = n.div_ceil(SORT_BLOCK);
        let n_counts = n_blocks << bits;
        let counts = grow(rec.gpu(), "digit counts", &mut self.counts, n_counts)?;
        let places = grow(rec.gpu(), "digit places", &mut self.places, n_counts + 1)?;
        let sort = SortPass { n: n as u32, n_blocks: n_blocks as u32, shift, n_digits: 1 << bits };
        let bindings = [uniform(&sort), (&from.keys).into(), limit.into(), (&counts).into()];
        rec.dispatch(&shaders::SORT_COUNT, Groups::Workgroups(n_blocks), &bindings);
        self.scan.exclusive(rec, &counts, &places, n_counts)?;
        let bindings = [
            uniform(&sort),
            (&from.keys).into(),
            (&from.values).into(),
            (&places).into(),
            limit.into(),
            (&to.keys).into(),
            (&to.values).into(),
        ];
        rec.dispatch(&shaders::SORT_SCATTER, Groups::Workgroups(n_blocks), &bindings);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;
    use crate::gpu::shaders::assert_layout;

    fn sorted(gpu: &Gpu, sorter: &mut Sorter, keys: &[u32], bits: u32) -> Vec<(u32, u32)> {
        let n = keys.len();
        let values: Vec<u32> = (0..n as u32).collect();
        let (k, v) = (gpu.upload("keys", keys).unwrap(), gpu.upload("values", &values).unwrap());
        let mut rec = gpu.record();
        let out = sorter.sort(&mut rec, &k, &v, n, bits).unwrap();
        rec.submit().unwrap();
        assert_eq!(gpu.read(&k, 0..n).unwrap(), keys, "the input is left alone");
        let values = gpu.read(&out.values, 0..n).unwrap();
        gpu.read(&out.keys, 0..n).unwrap().into_iter().zip(values).collect()
    }

    fn expected(keys: &[u32], bits: u32) -> Vec<(u32, u32)> {
        let mask = u32::MAX >> (32 - bits);
        let mut pairs: Vec<(u32, u32)> = keys.iter().copied().zip(0..).collect();
        pairs.sort_by_key(|p| p.0 & mask);
        pairs
    }

    fn random(n: usize, seed: u64) -> Vec<u32> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        (0..n).map(|_| rng.random()).collect()
    }

    #[test]
    fn host_and_shaders_agree_on_the_pass_struct() {
        for shader in [&shaders::SORT_COUNT, &shaders::SORT_SCATTER] {
            assert_layout!(SortPass as "SortPass" in shader; n, n_blocks, shift, n_digits);
        }
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn sort_matches_the_stable_std_sort_for_any_number_of_pairs() {
        let gpu = Gpu::for_tests();
        let mut sorter = Sorter::default();
        for n in [0, 1, 255, 256, 257, 2047, 2049, 5000, 70_000] {
            let keys = random(n, n as u64);
            assert_eq!(sorted(&gpu, &mut sorter, &keys, 32), expected(&keys, 32), "n = {n}");
        }
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn sort_uses_the_pair_count_of_the_device() {
        let gpu = Gpu::for_tests();
        let mut sorter = Sorter::default();
        let keys = random(9000, 11);
        let values: Vec<u32> = (0..9000).collect();
        let (k, v) = (gpu.upload("keys", &keys).unwrap(), gpu.upload("values", &values).unwrap());
        for counted in [0usize, 1, 2048, 5000, 9000, 1 << 31] {
            let on_device = gpu.upload("counted", &[counted as u32]).unwrap();
            let mut rec = gpu.record();
            let n = PairCount { most: keys.len(), counted: Some(&on_device) };
            let out = sorter.sort(&mut rec, &k, &v, n, 32).unwrap();
            rec.submit().unwrap();
            let n = counted.min(9000);
            let got =
                gpu.read(&out.keys, 0..n).unwrap().into_iter().zip(gpu.read(&out.values, 0..n).unwrap());
            assert_eq!(got.collect::<Vec<_>>(), expected(&keys[..n], 32), "{counted} counted");
        }
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn sorts_by_any_number_of_bits() {
        let gpu = Gpu::for_tests();
        let mut sorter = Sorter::default();
        let keys = random(4500, 7);
        for bits in 1..=32 {
            assert_eq!(sorted(&gpu, &mut sorter, &keys, bits), expected(&keys, bits), "{bits} bits");
        }
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn equal_and_extreme_keys_keep_their_order() {
        let gpu = Gpu::for_tests();
        let mut sorter = Sorter::default();
        for key in [0, 0x8000_0000, u32::MAX] {
            let keys = vec![key; 4100];
            assert_eq!(sorted(&gpu, &mut sorter, &keys, 32), expected(&keys, 32), "{key:x}");
        }
        // Few distinct keys: stability decides almost the whole order. The last digit is also that of the padding.
        let keys: Vec<u32> =
            random(5000, 3).iter().map(|k| if k % 3 == 0 { u32::MAX } else { k % 4 }).collect();
        assert_eq!(sorted(&gpu, &mut sorter, &keys, 32), expected(&keys, 32));
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn comparison_detects_an_unstable_sort() {
        let gpu = Gpu::for_tests();
        let mut keys = random(300, 5);
        keys[17] = keys[200];
        let mut wrong = expected(&keys, 32);
        let at = wrong.windows(2).position(|w| w[0].0 == w[1].0).unwrap();
        wrong.swap(at, at + 1);
        assert_ne!(sorted(&gpu, &mut Sorter::default(), &keys, 32), wrong);
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn invalid_sort_arguments_are_refused() {
        let gpu = Gpu::for_tests();
        let short = gpu.upload("keys", &[1u32; 4]).unwrap();
        for (n, bits) in [(5, 8), (4, 0), (4, 33)] {
            assert!(Sorter::default().sort(&mut gpu.record(), &short, &short, n, bits).is_err());
        }
    }
}
