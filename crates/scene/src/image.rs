//! Images in memory: display-referred photographs, and planes of floats.

/// An RGBA image: sRGB-curve colour and straight alpha, both in [0, 1], row-major. The colours of a scene-referred
/// photograph are in [`DisplayRange::Extended`](crate::DisplayRange).
#[derive(Debug, Clone, PartialEq)]
pub struct ImageRgba {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Row-major pixels `r g b a`.
    pub pixels: Vec<[f32; 4]>,
}

/// A row-major image of `C` floats per pixel, e.g. a ground-truth layer.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane<const C: usize> {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Row-major values.
    pub values: Vec<[f32; C]>,
}

impl ImageRgba {
    /// RGB over a solid display-referred background.
    pub fn over(&self, background: [f32; 3]) -> Vec<[f32; 3]> {
        let blend = |p: &[f32; 4]| std::array::from_fn(|k| p[k] * p[3] + background[k] * (1.0 - p[3]));
        self.pixels.iter().map(blend).collect()
    }

    /// The image with its colours clamped to [0, 1], as a display shows it.
    #[must_use]
    pub fn shown(&self) -> Self {
        let pixels = self.pixels.iter().map(|&[r, g, b, a]| {
            let [r, g, b] = [r, g, b].map(|v| v.clamp(0.0, 1.0));
            [r, g, b, a]
        });
        Self { width: self.width, height: self.height, pixels: pixels.collect() }
    }

    /// The image reduced to `width` x `height` by area averaging with premultiplied alpha.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        Self::reduced((self.width, self.height), (width, height), |i| self.pixels[i])
    }

    /// The image of size `stored` whose `i`-th pixel, row-major and with straight alpha, is `pixel(i)`, reduced to `size` by
    /// area averaging with premultiplied alpha. The function allocates the returned image only.
    #[must_use]
    pub fn reduced(
        stored: (u32, u32),
        size @ (width, height): (u32, u32),
        pixel: impl Fn(usize) -> [f32; 4],
    ) -> Self {
        if size == stored {
            let pixels = (0..width as usize * height as usize).map(pixel).collect();
            return Self { width, height, pixels };
        }
        let premultiplied = |i: usize| {
            let [r, g, b, a] = pixel(i);
            [r * a, g * a, b * a, a]
        };
        let straight = |p: [f32; 4]| {
            let a = p[3].max(1e-8);
            [unrounded(p[0] / a), unrounded(p[1] / a), unrounded(p[2] / a), p[3].min(1.0)]
        };
        let pixels = averaged(stored, size, premultiplied).into_iter().map(straight).collect();
        Self { width, height, pixels }
    }
}

impl<const C: usize> Plane<C> {
    /// The image reduced to `width` x `height` by exact area averaging.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let values = averaged((self.width, self.height), (width, height), |i| self.values[i]);
        Self { width, height, values }
    }
}

/// Largest error of a mean of values up to 1 by rounding.
const ROUNDING: f32 = 1e-5;

/// A mean, at most 1 if it exceeds 1 only by rounding. NaN becomes 1.
fn unrounded(mean: f32) -> f32 {
    if mean > 1.0 + ROUNDING { mean } else { mean.min(1.0) }
}

/// Means of the values `value(i)` of an image of size `from` over the cells of an image of size `to`, row-major.
fn averaged<const C: usize>(
    from: (u32, u32),
    to: (u32, u32),
    value: impl Fn(usize) -> [f32; C],
) -> Vec<[f32; C]> {
    let stride = from.0 as usize;
    let (rows, columns) = (spans(from.1, to.1), spans(from.0, to.0));
    let mean = |row: &[(usize, f64)], column: &[(usize, f64)]| {
        let mut sum = [0.0f64; C];
        for &(y, wy) in row {
            for &(x, wx) in column {
                let v = value(y * stride + x);
                (0..C).for_each(|k| sum[k] += f64::from(v[k]) * wx * wy);
            }
        }
        sum.map(|s| s as f32)
    };
    let mut out = Vec::with_capacity(rows.len() * columns.len());
    for row in &rows {
        out.extend(columns.iter().map(|column| mean(row, column)));
    }
    out
}

/// For each new cell, the old cells under it and their shares, summing to 1.
fn spans(from: u32, to: u32) -> Vec<Vec<(usize, f64)>> {
    let ratio = f64::from(from) / f64::from(to);
    (0..to)
        .map(|i| {
            let (lo, hi) = (f64::from(i) * ratio, f64::from(i + 1) * ratio);
            let last = (hi.ceil() as usize).min(from as usize);
            let share = |j: usize| (hi.min(j as f64 + 1.0) - lo.max(j as f64)).max(0.0) / ratio;
            (lo as usize..last).map(|j| (j, share(j))).filter(|&(_, w)| w > 1e-9).collect()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resizing_keeps_the_mean_and_ignores_colour_under_zero_alpha() {
        let mut pixels = vec![[1.0, 0.0, 0.0, 1.0]; 16];
        pixels[5] = [0.0, 1.0, 0.0, 0.0];
        let image = ImageRgba { width: 4, height: 4, pixels };
        let small = image.resized(2, 2);
        assert!(small.pixels.iter().all(|p| (p[0] - 1.0).abs() < 1e-6 && p[1] == 0.0));
        let mean: f32 = small.pixels.iter().map(|p| p[3]).sum::<f32>() / 4.0;
        assert!((mean - 15.0 / 16.0).abs() < 1e-6);
    }

    #[test]
    fn resizing_keeps_values_above_1_and_adds_none() {
        let grey = |v: f32| ImageRgba { width: 3, height: 3, pixels: vec![[v, v, v, 0.7]; 9] };
        assert!(grey(1.0).resized(2, 2).pixels.iter().flatten().all(|v| *v <= 1.0));
        assert!(grey(3.0).resized(2, 2).pixels.iter().all(|p| (p[0] - 3.0).abs() < 1e-5), "the control");
        assert_eq!(grey(3.0).shown(), grey(1.0));
        assert_eq!(grey(0.5).shown(), grey(0.5));
    }
}
