//! Transfers the detail of a photograph to the albedo of a model, by a guided filter (He, Sun and Tang 2013, "Guided image filtering").
//!
//! In each small window the logarithm of the albedo is a linear function of the logarithm of the photograph divided by its light. Where the
//! colours of the photograph follow the model's albedo, its edges become those of the albedo. Where they vary without it, as in folds and
//! highlights, the window has the mean of the model's albedo.

use glam::{Mat3, Vec3};
use rayon::prelude::*;

use super::Surfaces;

/// Rows that are filtered together, and strips that are filtered in parallel, which bounds the memory.
const STRIP: usize = 32;
const STRIPS_AT_ONCE: usize = 8;
/// Radius of the windows, pixels of the training, and its limits in pixels of the photograph.
const RADIUS: f32 = 2.0;
const RADII: (f32, f32) = (2.0, 16.0);
/// Added to reflected light before logarithms and divisions, so that dark pixels have no weight.
const DARK: f32 = 0.01;
/// Largest logarithm of a photograph over the model's picture.
const MAX_LOG_RATIO: f32 = 1.5;
/// Coverage from which a pixel shows the model alone.
const MIN_COVERAGE: f32 = 0.9;

/// A photograph in the exposure of a model.
pub(super) struct MatchedPhotograph {
    /// Linear light, row-major.
    pub(super) light: Vec<[f32; 3]>,
    /// False for pixels that are clipped or outside of the mask.
    pub(super) is_usable: Vec<bool>,
}

/// The guided filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetailTransfer {
    /// Radius of the square windows, pixels.
    pub radius: usize,
    /// Variance of the logarithm of the guide below which a window is smooth.
    pub epsilon: f32,
}

impl DetailTransfer {
    /// The filter for a photograph that is `enlargement` times as large as it was in the training: the model is blurred by that many pixels.
    pub(super) fn enlarged(enlargement: f32) -> Self {
        let radius = (RADIUS * enlargement).round().clamp(RADII.0, RADII.1) as usize;
        Self { radius, epsilon: 0.04 }
    }
}

/// A picture in windows, as sums: the weight, the guide, the input, and their products.
const MOMENTS: usize = 1 + 3 + 3 + 6 + 9;
/// Coefficients of a window by channel: three factors and an offset; and the weight.
const COEFFICIENTS: usize = 3 * 4 + 1;
/// The upper triangle of a symmetric matrix.
const PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

impl DetailTransfer {
    /// Albedo of `surfaces` with the detail of `photograph`, row-major. Unusable pixels have the albedo of the model.
    pub(super) fn albedo(&self, photograph: &MatchedPhotograph, surfaces: &Surfaces) -> Vec<[f32; 3]> {
        let (width, height) = (surfaces.width as usize, surfaces.height as usize);
        let mut out = surfaces.albedo.clone();
        let strip_pixels = STRIP * width.max(1);
        for (group, out) in out.chunks_mut(STRIPS_AT_ONCE * strip_pixels).enumerate() {
            out.par_chunks_mut(strip_pixels).enumerate().for_each(|(strip, out)| {
                self.filter(photograph, surfaces, (group * STRIPS_AT_ONCE + strip) * STRIP, height, out);
            });
        }
        out
    }

    /// Writes the rows from `first` on to `out`, which has the albedo of the model.
    fn filter(
        &self,
        photograph: &MatchedPhotograph,
        surfaces: &Surfaces,
        first: usize,
        height: usize,
        out: &mut [[f32; 3]],
    ) {
        let width = surfaces.width as usize;
        let (rows, reach) = (out.len() / width.max(1), 2 * self.radius);
        let (from, to) = (first.saturating_sub(reach), (first + rows + reach).min(height));
        let pixels: Vec<Option<Pixel>> =
            (from * width..to * width).map(|i| Pixel::of(photograph, surfaces, i)).collect();
        let moments: Vec<[f32; MOMENTS]> = pixels.iter().map(moments).collect();
        let fits: Vec<[f32; COEFFICIENTS]> = box_sums(&moments, width, self.radius)
            .iter()
            .zip(&pixels)
            .map(|(sums, pixel)| if pixel.is_some() { self.fit(sums) } else { [0.0; COEFFICIENTS] })
            .collect();
        let fits = box_sums(&fits, width, self.radius);
        let shift = (first - from) * width;
        for (k, out) in out.iter_mut().enumerate() {
            if let Some(pixel) = &pixels[k + shift] {
                *out = predicted(&fits[k + shift], pixel.guide);
            }
        }
    }

    /// The linear function of a window from its sums.
    fn fit(&self, sums: &[f32; MOMENTS]) -> [f32; COEFFICIENTS] {
        let mean = |k: usize| sums[k] / sums[0];
        let guide = Vec3::new(mean(1), mean(2), mean(3));
        let mut covariance = Mat3::ZERO;
        for (k, (i, j)) in PAIRS.into_iter().enumerate() {
            let value = mean(7 + k) - guide[i] * guide[j];
            covariance.col_mut(i)[j] = value;
            covariance.col_mut(j)[i] = value;
        }
        let inverse = (covariance + Mat3::from_diagonal(Vec3::splat(self.epsilon))).inverse();
        let mut out = [0.0; COEFFICIENTS];
        for c in 0..3 {
            let input = mean(4 + c);
            let with_guide: Vec3 = std::array::from_fn(|i| mean(13 + 3 * c + i) - guide[i] * input).into();
            let factors = inverse * with_guide;
            out[4 * c..4 * c + 3].copy_from_slice(&factors.to_array());
            out[4 * c + 3] = input - factors.dot(guide);
        }
        out[COEFFICIENTS - 1] = 1.0;
        out
    }
}

/// Albedo from the summed functions of the windows around a pixel.
fn predicted(fits: &[f32; COEFFICIENTS], guide: Vec3) -> [f32; 3] {
    let count = fits[COEFFICIENTS - 1];
    std::array::from_fn(|c| {
        let factors = Vec3::from_slice(&fits[4 * c..4 * c + 3]);
        let log = (factors.dot(guide) + fits[4 * c + 3]) / count;
        (log.exp() - DARK).clamp(0.0, 1.0)
    })
}

/// A usable pixel: logarithms of the photograph without its light, and of the model's albedo.
struct Pixel {
    guide: Vec3,
    input: Vec3,
}

impl Pixel {
    fn of(photograph: &MatchedPhotograph, surfaces: &Surfaces, i: usize) -> Option<Self> {
        if !photograph.is_usable[i] || surfaces.alpha[i] < MIN_COVERAGE {
            return None;
        }
        let (by_albedo, rest) = surfaces.reflected(i);
        let input: Vec3 = surfaces.albedo[i].map(|a| (a.max(0.0) + DARK).ln()).into();
        let ratio = |c: usize| {
            let ratio = ((photograph.light[i][c] - rest[c]).max(0.0) + DARK) / (by_albedo[c] + DARK);
            ratio.ln().clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO)
        };
        let guide = input + Vec3::from(std::array::from_fn::<f32, 3, _>(ratio));
        (guide.is_finite() && input.is_finite()).then_some(Self { guide, input })
    }
}

fn moments(pixel: &Option<Pixel>) -> [f32; MOMENTS] {
    let mut out = [0.0; MOMENTS];
    let Some(Pixel { guide, input }) = pixel else { return out };
    out[0] = 1.0;
    out[1..4].copy_from_slice(&guide.to_array());
    out[4..7].copy_from_slice(&input.to_array());
    for (k, (i, j)) in PAIRS.into_iter().enumerate() {
        out[7 + k] = guide[i] * guide[j];
    }
    for c in 0..3 {
        (0..3).for_each(|i| out[13 + 3 * c + i] = guide[i] * input[c]);
    }
    out
}

/// Sums over the square windows around the pixels of a row-major picture. Windows end at its borders.
fn box_sums<const N: usize>(values: &[[f32; N]], width: usize, radius: usize) -> Vec<[f32; N]> {
    let height = values.len() / width.max(1);
    let mut across = vec![[0.0; N]; values.len()];
    for y in 0..height {
        let row = y * width..(y + 1) * width;
        running_sums(&values[row.clone()], |x| x, width, radius, &mut across[row]);
    }
    let mut out = vec![[0.0; N]; values.len()];
    let mut column = vec![[0.0; N]; height];
    for x in 0..width {
        running_sums(&across, |y| y * width + x, height, radius, &mut column);
        column.iter().enumerate().for_each(|(y, sum)| out[y * width + x] = *sum);
    }
    out
}

/// Sums over the `radius` entries on both sides of each of `count` entries, which `at` locates.
fn running_sums<const N: usize>(
    values: &[[f32; N]],
    at: impl Fn(usize) -> usize,
    count: usize,
    radius: usize,
    out: &mut [[f32; N]],
) {
    for k in 0..count {
        let mut sum = [0.0; N];
        for value in (k.saturating_sub(radius)..(k + radius + 1).min(count)).map(|j| &values[at(j)]) {
            (0..N).for_each(|n| sum[n] += value[n]);
        }
        out[k] = sum;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 96;

    /// A matte surface of `albedo` as a model has it, under a light that grows from left to right.
    fn surfaces(albedo: Vec<[f32; 3]>) -> Surfaces {
        let pixels = albedo.len();
        let diffuse = albedo.iter().enumerate().map(|(i, a)| a.map(|a| a * light(i))).collect();
        Surfaces {
            width: SIDE as u32,
            height: SIDE as u32,
            albedo,
            metal: vec![0.0; pixels],
            diffuse,
            specular: vec![[0.0; 3]; pixels],
            shading: vec![[1.0; 3]; pixels],
            shadow: vec![[1.0; 3]; pixels],
            alpha: vec![1.0; pixels],
        }
    }

    fn light(i: usize) -> f32 {
        0.4 + 0.8 * (i % SIDE) as f32 / SIDE as f32
    }

    fn photograph(light: Vec<[f32; 3]>) -> MatchedPhotograph {
        MatchedPhotograph { is_usable: vec![true; light.len()], light }
    }

    /// Squares of two colours with edges of `softness` pixels.
    fn squares(softness: f32) -> Vec<[f32; 3]> {
        let wave = |at: usize| (std::f32::consts::TAU * at as f32 / 32.0).sin() * 5.0;
        let pixel = |i: usize| {
            let edge =
                (wave(i % SIDE) / softness).clamp(-1.0, 1.0) * (wave(i / SIDE) / softness).clamp(-1.0, 1.0);
            let share = 0.5 + 0.5 * edge;
            std::array::from_fn(|c| [0.6, 0.3, 0.2][c] * share + [0.2, 0.25, 0.5][c] * (1.0 - share))
        };
        (0..SIDE * SIDE).map(pixel).collect()
    }

    fn error(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
        let square =
            |(a, b): (&[f32; 3], &[f32; 3])| (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>();
        (a.iter().zip(b).map(square).sum::<f64>() / (3 * a.len()) as f64).sqrt()
    }

    #[test]
    fn edges_of_the_photograph_become_those_of_the_albedo() {
        let (truth, blurred) = (squares(0.5), squares(2.0));
        let taken = photograph(truth.iter().enumerate().map(|(i, a)| a.map(|a| a * light(i))).collect());
        let found = DetailTransfer::enlarged(2.0).albedo(&taken, &surfaces(blurred.clone()));
        let (before, after) = (error(&blurred, &truth), error(&found, &truth));
        assert!(after < 0.85 * before, "{after} of {before}");
    }

    #[test]
    fn variations_of_light_do_not_become_albedo() {
        let albedo = vec![[0.5, 0.3, 0.2]; SIDE * SIDE];
        let fold = |i: usize| 1.0 + 0.3 * ((i % SIDE) as f32 * 0.7).sin();
        let folded = albedo.iter().enumerate().map(|(i, a)| a.map(|a| a * light(i) * fold(i))).collect();
        let found = DetailTransfer::enlarged(2.0).albedo(&photograph(folded), &surfaces(albedo.clone()));
        assert!(error(&found, &albedo) < 1e-3, "{}", error(&found, &albedo));
    }

    #[test]
    fn unusable_pixels_have_the_albedo_of_the_model() {
        let (truth, blurred) = (squares(0.5), squares(2.0));
        let mut taken = photograph(truth.iter().enumerate().map(|(i, a)| a.map(|a| a * light(i))).collect());
        taken.is_usable[..SIDE * SIDE / 2].fill(false);
        taken.light[..SIDE * SIDE / 2].fill([f32::NAN; 3]);
        let found = DetailTransfer::enlarged(2.0).albedo(&taken, &surfaces(blurred.clone()));
        let half = SIDE * SIDE / 2;
        assert!(found[..half] == blurred[..half]);
        assert!(error(&found[half..], &blurred[half..]) > 0.01, "the control");
        assert!(found.iter().flatten().all(|v| v.is_finite()));
    }

    #[test]
    fn strips_have_no_seams() {
        let (truth, blurred) = (squares(0.5), squares(2.0));
        let light: Vec<[f32; 3]> = truth.iter().enumerate().map(|(i, a)| a.map(|a| a * light(i))).collect();
        let found = DetailTransfer::enlarged(2.0).albedo(&photograph(light), &surfaces(blurred));
        // The pattern repeats every 32 rows, as strips do; rows 60 to 84 are near the end of a strip and of its successor.
        let row = |y: usize| &found[y * SIDE + 20..y * SIDE + 76];
        for y in 18..44 {
            assert!(error(row(y), row(y + 32)) < 1e-3, "row {y}: {}", error(row(y), row(y + 32)));
        }
    }
}
