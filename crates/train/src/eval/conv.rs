//! The neural network layers that LPIPS needs, on the CPU: convolution with ReLU, and max pooling.
//!
//! A convolution is a matrix product `weights x patches`. Patches are laid out for one strip of output pixels at a
//! time, so the strip stays in cache while it is multiplied with every group of output channels.

use rayon::prelude::*;

/// Output channels and output pixels that the inner product keeps in registers.
const CHANNELS: usize = 4;
const PIXELS: usize = 16;
/// Panels of [`PIXELS`] that share one pass over the weights.
const PANELS: usize = 3;

/// A stack of feature maps: channel-major, then rows.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FeatureMaps {
    pub(crate) channels: usize,
    pub(crate) height: usize,
    pub(crate) width: usize,
    pub(crate) values: Vec<f32>,
}

/// A square convolution followed by ReLU, its weights packed for the inner product.
pub(crate) struct Conv {
    inputs: usize,
    outputs: usize,
    kernel: usize,
    stride: usize,
    padding: usize,
    /// `[group of output channels][tap][channel in the group]`, zero-padded to whole groups.
    packed: Vec<f32>,
    bias: Vec<f32>,
}

impl Conv {
    /// Packs OIHW `weights` of `bias.len()` output channels.
    pub(crate) fn new(
        weights: &[f32],
        bias: &[f32],
        kernel: usize,
        (stride, padding): (usize, usize),
    ) -> Self {
        let outputs = bias.len();
        let taps = weights.len() / outputs;
        let groups = outputs.div_ceil(CHANNELS);
        let mut packed = vec![0.0; groups * taps * CHANNELS];
        for output in 0..outputs {
            let (group, lane) = (output / CHANNELS, output % CHANNELS);
            for tap in 0..taps {
                packed[(group * taps + tap) * CHANNELS + lane] = weights[output * taps + tap];
            }
        }
        let inputs = taps / (kernel * kernel);
        Self { inputs, outputs, kernel, stride, padding, packed, bias: bias.to_vec() }
    }

    /// Applies the convolution and ReLU. The padded input is at least the kernel's size.
    pub(crate) fn apply(&self, input: &FeatureMaps) -> FeatureMaps {
        let size = |n: usize| (n + 2 * self.padding - self.kernel) / self.stride + 1;
        let (width, height) = (size(input.width), size(input.height));
        let (area, strip) = (width * height, PIXELS * PANELS);
        let strips: Vec<Vec<f32>> = (0..area.div_ceil(strip))
            .into_par_iter()
            .map(|s| self.strip(input, width, s * strip..((s + 1) * strip).min(area)))
            .collect();
        let mut values = vec![0.0; self.outputs * area];
        for (s, block) in strips.iter().enumerate() {
            let pixels = (area - s * strip).min(strip);
            for (channel, row) in block.chunks_exact(strip).take(self.outputs).enumerate() {
                let start = channel * area + s * strip;
                values[start..start + pixels].copy_from_slice(&row[..pixels]);
            }
        }
        FeatureMaps { channels: self.outputs, height, width, values }
    }

    /// All output channels of one strip of output pixels, `[channel][PIXELS * PANELS]`.
    fn strip(&self, input: &FeatureMaps, width: usize, pixels: std::ops::Range<usize>) -> Vec<f32> {
        let taps = self.inputs * self.kernel * self.kernel;
        let patches = self.patches(input, width, pixels, taps);
        let groups = self.outputs.div_ceil(CHANNELS);
        let mut out = vec![0.0; groups * CHANNELS * PIXELS * PANELS];
        for (group, weights) in self.packed.chunks_exact(taps * CHANNELS).enumerate() {
            for (panel, patch) in patches.chunks_exact(taps * PIXELS).enumerate() {
                let sums = inner_product(weights, patch);
                for (lane, sum) in sums.iter().enumerate() {
                    let channel = group * CHANNELS + lane;
                    let bias = self.bias.get(channel).copied().unwrap_or(0.0);
                    let start = (channel * PANELS + panel) * PIXELS;
                    for (o, v) in out[start..start + PIXELS].iter_mut().zip(sum) {
                        *o = (v + bias).max(0.0);
                    }
                }
            }
        }
        out
    }

    /// The receptive field of each pixel of the strip, `[panel][tap][PIXELS]`; zero outside the input.
    fn patches(
        &self,
        input: &FeatureMaps,
        width: usize,
        pixels: std::ops::Range<usize>,
        taps: usize,
    ) -> Vec<f32> {
        let mut out = vec![0.0; PANELS * taps * PIXELS];
        for (slot, pixel) in pixels.enumerate() {
            let (panel, lane) = (slot / PIXELS, slot % PIXELS);
            let (x0, y0) = ((pixel % width) * self.stride, (pixel / width) * self.stride);
            let inside = |at: usize, limit: usize| at.checked_sub(self.padding).filter(|&v| v < limit);
            for ky in 0..self.kernel {
                let Some(y) = inside(y0 + ky, input.height) else { continue };
                for kx in 0..self.kernel {
                    let Some(x) = inside(x0 + kx, input.width) else { continue };
                    for channel in 0..self.inputs {
                        let tap = (channel * self.kernel + ky) * self.kernel + kx;
                        out[(panel * taps + tap) * PIXELS + lane] =
                            input.values[(channel * input.height + y) * input.width + x];
                    }
                }
            }
        }
        out
    }
}

/// `sum over taps of weight[channel] * patch[pixel]` for a block of channels and pixels.
fn inner_product(weights: &[f32], patch: &[f32]) -> [[f32; PIXELS]; CHANNELS] {
    let mut sums = [[0.0f32; PIXELS]; CHANNELS];
    let (weights, patch) = (weights.as_chunks::<CHANNELS>().0, patch.as_chunks::<PIXELS>().0);
    for (w, p) in weights.iter().zip(patch) {
        for (sum, w) in sums.iter_mut().zip(w) {
            for (s, v) in sum.iter_mut().zip(p) {
                *s += w * v;
            }
        }
    }
    sums
}

/// Max pooling with a 3x3 window and stride 2, no padding. The input is at least 3x3.
pub(crate) fn max_pool(input: &FeatureMaps) -> FeatureMaps {
    let (height, width) = ((input.height - 3) / 2 + 1, (input.width - 3) / 2 + 1);
    let at = |c: usize, y: usize, x: usize| input.values[(c * input.height + y) * input.width + x];
    let mut values = Vec::with_capacity(input.channels * height * width);
    for c in 0..input.channels {
        for y in 0..height {
            for x in 0..width {
                let window = (0..9).map(|t| at(c, 2 * y + t / 3, 2 * x + t % 3));
                values.push(window.fold(f32::NEG_INFINITY, f32::max));
            }
        }
    }
    FeatureMaps { channels: input.channels, height, width, values }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(channels: usize, height: usize, width: usize) -> FeatureMaps {
        let values = (0..channels * height * width).map(|i| ((i * 37) % 23) as f32 - 9.0).collect();
        FeatureMaps { channels, height, width, values }
    }

    /// The definition, without blocking.
    fn plainly(
        input: &FeatureMaps,
        weights: &[f32],
        bias: &[f32],
        k: usize,
        stride: usize,
        pad: usize,
    ) -> Vec<f32> {
        let size = |n: usize| (n + 2 * pad - k) / stride + 1;
        let mut out = Vec::new();
        for (o, b) in bias.iter().enumerate() {
            for (y, x) in (0..size(input.height)).flat_map(|y| (0..size(input.width)).map(move |x| (y, x))) {
                let mut sum = *b;
                for (c, ky, kx) in (0..input.channels * k * k).map(|t| (t / (k * k), t / k % k, t % k)) {
                    let (iy, ix) = (y * stride + ky, x * stride + kx);
                    if iy < pad || ix < pad || iy - pad >= input.height || ix - pad >= input.width {
                        continue;
                    }
                    let v = input.values[(c * input.height + iy - pad) * input.width + ix - pad];
                    sum += weights[((o * input.channels + c) * k + ky) * k + kx] * v;
                }
                out.push(sum.max(0.0));
            }
        }
        out
    }

    #[test]
    fn blocked_convolution_equals_the_direct_convolution() {
        // Neither channels nor pixels fill whole blocks.
        let input = ramp(3, 13, 11);
        for (k, stride, pad) in [(3, 1, 1), (5, 2, 2), (3, 4, 0)] {
            let weights: Vec<f32> = (0..7 * 3 * k * k).map(|i| ((i * 13) % 11) as f32 - 5.0).collect();
            let bias: Vec<f32> = (0..7).map(|i| i as f32).collect();
            let fast = Conv::new(&weights, &bias, k, (stride, pad)).apply(&input);
            let slow = plainly(&input, &weights, &bias, k, stride, pad);
            assert_eq!(fast.values, slow, "kernel {k} stride {stride} padding {pad}");
            // Negative control: another padding gives another result.
            assert_ne!(Conv::new(&weights, &bias, k, (stride, pad + 1)).apply(&input).values, slow);
        }
    }

    #[test]
    fn max_pooling_takes_the_maximum_of_nine_values() {
        let input =
            FeatureMaps { channels: 1, height: 3, width: 5, values: (0..15).map(|v| v as f32).collect() };
        assert_eq!(max_pool(&input).values, vec![12.0, 14.0]);
    }
}
