//! The terms against direct f64 versions of their formulas and central differences of those.

use super::*;
use crate::RasterCamera;
use crate::cpu::Pass;
use crate::cpu::objective::image::Target;
use crate::gpu::shaders::assert_layout;
use crate::gpu::shading::tests::{Noise, camera_view, empty_pass, planar_gbuffer, set};
use crate::gpu::{Gpu, photo_pixel};
use relume_compare::relative_error;
use relume_layout::channel;
use relume_scene::{DisplayRange, ShadingOptions};

type Rgb = [f64; 3];

/// Weights of the image term.
const WEIGHTS: ImageWeights = ImageWeights { l1: 0.7, ssim: 0.4 };

/// Mean absolute error, mean squared error and mean SSIM, with the window as one 2D kernel.
fn image_means(w: usize, h: usize, image: &[Rgb], photo: &[Rgb]) -> [f64; 3] {
    let raw: Vec<f64> = (0..11).map(|i| (-(f64::from(i) - 5.0).powi(2) / 4.5).exp()).collect();
    let total: f64 = raw.iter().sum();
    let mut out = [0.0; 3];
    for i in 0..w * h {
        for c in 0..3 {
            let mut m = [0.0; 5];
            for (dy, ky) in raw.iter().enumerate() {
                for (dx, kx) in raw.iter().enumerate() {
                    let (x, y) = (i % w + dx, i / w + dy);
                    if x < 5 || y < 5 || x - 5 >= w || y - 5 >= h {
                        continue;
                    }
                    let j = (y - 5) * w + x - 5;
                    let (a, b, k) = (image[j][c], photo[j][c], kx * ky / total / total);
                    for (m, v) in m.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                        *m += k * v;
                    }
                }
            }
            let [ma, mb, aa, bb, ab] = m;
            let top = (2.0 * ma * mb + 1e-4) * (2.0 * (ab - ma * mb) + 9e-4);
            let bottom = (ma * ma + mb * mb + 1e-4) * (aa - ma * ma + bb - mb * mb + 9e-4);
            let d = image[i][c] - photo[i][c];
            for (o, v) in out.iter_mut().zip([d.abs(), d * d, top / bottom]) {
                *o += v / (3 * w * h) as f64;
            }
        }
    }
    out
}

fn rows<'a>(pixels: &'a [Rgb], fourth: &'a [f32]) -> impl Iterator<Item = [f32; 4]> + 'a {
    pixels.iter().enumerate().map(|(i, p)| {
        let [r, g, b] = p.map(|v| v as f32);
        [r, g, b, fourth.get(i).copied().unwrap_or(f32::NAN)]
    })
}

fn uploaded(gpu: &Gpu, pixels: &[Rgb]) -> Buffer<[f32; 4]> {
    gpu.upload("pixels", &rows(pixels, &[]).collect::<Vec<_>>()).unwrap()
}

fn uploaded_photo(gpu: &Gpu, pixels: &[Rgb], mask: &[f32], range: DisplayRange) -> DevicePhoto {
    let packed: Vec<_> = rows(pixels, mask).map(|pixel| photo_pixel(pixel, range)).collect();
    DevicePhoto { pixels: gpu.upload("a photograph", &packed).unwrap(), range }
}

/// The nearest level of a photograph on the device.
fn level(value: f32) -> f64 {
    f64::from((value * 65_535.0).round()) / 65_535.0
}

fn picture(noise: &mut Noise, n: usize) -> Vec<Rgb> {
    (0..n).map(|_| noise.rgb(0.0, 1.0).map(level)).collect()
}

/// Absolute error, squared error and SSIM, and the gradient by the image.
fn on_device(gpu: &Gpu, view: &RasterCamera, image: &[Rgb], photo: &DevicePhoto) -> ([f32; 3], Vec<f32>) {
    let (view, n) = (CameraUniform::new(view), image.len());
    let image = uploaded(gpu, image);
    let losses = gpu.buffer("losses", LOSS_SLOTS).unwrap();
    let partials = gpu.buffer("partials", 3 * n).unwrap();
    let by_image = gpu.buffer("by image", n).unwrap();
    let mut recorder = gpu.record();
    recorder.clear(&losses);
    let slot = LossSlot::RadianceL1;
    let term = ImageTerm { camera: &view, image: &image, photo, slot, weights: WEIGHTS, partials: &partials };
    term.record(&mut recorder, &by_image, &losses);
    recorder.submit().unwrap();
    let losses = gpu.read(&losses, 0..LOSS_SLOTS).unwrap();
    assert!(losses.iter().enumerate().all(|(i, v)| *v == 0.0 || (3..6).contains(&i)), "{losses:?}");
    let by_image: Vec<[f32; 4]> = gpu.read(&by_image, 0..n).unwrap();
    ([losses[3], losses[4], losses[5]], by_image.iter().flat_map(|p| [p[0], p[1], p[2]]).collect())
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn image_terms_and_gradients_match_the_formulas() {
    let gpu = Gpu::for_tests();
    for (seed, (w, h)) in [(1, (1, 1)), (2, (37, 21)), (3, (16, 16)), (4, (3, 40))] {
        let mut noise = Noise::new(seed);
        let view = camera_view((w as u32, h as u32), &ShadingOptions::default());
        let mut photo = picture(&mut noise, w * h);
        let mut image = picture(&mut noise, w * h);
        // Near the photograph in some pixels, and equal in one.
        for i in 0..w * h / 2 {
            image[i] = std::array::from_fn(|c| (photo[i][c] + 0.1 * image[i][c]) as f32 as f64);
        }
        if w * h > 1 {
            // Levels that no driver rounds.
            photo[w * h / 2] = [1.0, 0.0, 1.0];
            image[w * h / 2] = photo[w * h / 2];
        }
        let uploaded = uploaded_photo(&gpu, &photo, &[], DisplayRange::Unit);
        let (found, by_image) = on_device(&gpu, &view, &image, &uploaded);
        let expected = image_means(w, h, &image, &photo);
        for k in 0..3 {
            assert!((f64::from(found[k]) - expected[k]).abs() < 5e-6, "{w}x{h} {k}: {found:?} {expected:?}");
        }
        let value = |image: &[Rgb]| {
            let [l1, _, ssim] = image_means(w, h, image, &photo);
            0.7 * l1 + 0.4 * (1.0 - ssim)
        };
        let (mut numeric, mut analytic) = (Vec::new(), Vec::new());
        for i in (0..w * h).step_by(1 + w * h / 40) {
            for c in 0..3 {
                let (mut high, mut low) = (image.clone(), image.clone());
                high[i][c] += 1e-5;
                low[i][c] -= 1e-5;
                numeric.push(((value(&high) - value(&low)) / 2e-5) as f32);
                analytic.push(by_image[3 * i + c]);
            }
        }
        let seen = relative_error(&analytic, &numeric);
        assert!(seen < 1e-4, "{w}x{h}: {seen}");
        analytic[0] += 1e-3 * numeric.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        assert!(relative_error(&analytic, &numeric) > 1e-4, "the control");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn image_terms_of_scene_referred_photographs_match_the_cpu() {
    let (gpu, (w, h)) = (Gpu::for_tests(), (37, 21));
    let mut noise = Noise::new(5);
    let white = f64::from(DisplayRange::Extended.white());
    let view = camera_view((w as u32, h as u32), &ShadingOptions::default());
    let [photo, image] = [0, 1].map(|_| -> Vec<Rgb> {
        picture(&mut noise, w * h).iter().map(|p| p.map(|v| f64::from((v * white) as f32))).collect()
    });
    let floats = |pixels: &[Rgb]| -> Vec<[f32; 3]> { pixels.iter().map(|p| p.map(|v| v as f32)).collect() };
    let target = floats(&photo);
    let expected = Target::new(w, h, &target).compare(&floats(&image), WEIGHTS);
    let of = |range| on_device(&gpu, &view, &image, &uploaded_photo(&gpu, &photo, &[], range));
    let (found, by_image) = of(DisplayRange::Extended);
    assert!((found[1] / expected.mse - 1.0).abs() < 1e-4, "{found:?} {}", expected.mse);
    let error = relative_error(&by_image, expected.gradient.as_flattened());
    assert!(error < 1e-3, "{error}");
    let (clipped, _) = of(DisplayRange::Unit);
    assert!((clipped[1] / expected.mse - 1.0).abs() > 0.1, "the control: {clipped:?}");
}

/// A G-buffer in f64, `[pixel][channel]` of `Material`, with the camera's rays and a photograph.
#[derive(Clone)]
struct Buffers {
    size: (usize, usize),
    rays: Vec<Rgb>,
    rows: Vec<[f64; 13]>,
    photo: Vec<Rgb>,
    mask: Vec<f32>,
}

fn dot(a: Rgb, b: Rgb) -> f64 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

fn cross(a: Rgb, b: Rgb) -> Rgb {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(a: Rgb) -> Rgb {
    a.map(|v| v / dot(a, a).sqrt())
}

const NORMAL: usize = channel::NORMAL.start;

impl Buffers {
    /// A bumpy wall with holes and one step in depth.
    fn new(seed: u64, view: &RasterCamera) -> Self {
        let mut noise = Noise::new(seed);
        let size = (view.width, view.height);
        let pixels = || (0..size.0 * size.1).map(|i| (i % size.0, i / size.0));
        let rays: Vec<Rgb> = pixels().map(|(x, y)| view.ray(x, y).map(f64::from)).collect();
        let rows = pixels()
            .zip(&rays)
            .map(|((x, y), ray)| {
                let mut row = [0.0f64; 13];
                let hole = (x * 7 + y * 3) % 13 == 0;
                let coverage = if hole { [0.0, 5e-4, 0.3][(x + y) % 3] } else { noise.between(0.5, 1.0) };
                row.iter_mut().for_each(|v| *v = f64::from(noise.between(0.0, coverage)));
                row[0] = f64::from(coverage);
                let towards = unit(ray.map(|v| -v));
                for k in 0..3 {
                    let bump = f64::from(noise.between(-0.3, 0.3));
                    row[NORMAL + k] = ((towards[k] + bump) * f64::from(coverage)) as f32 as f64;
                }
                let step = if x > 2 * size.0 / 3 { 1.0 } else { 0.0 };
                let depth = 2.0 + step + f64::from(noise.between(0.0, 0.09));
                let facing = dot(std::array::from_fn(|k| row[NORMAL + k]), *ray);
                row[channel::PLANE] = (depth * facing) as f32 as f64;
                row.map(|v| f64::from(v as f32))
            })
            .collect();
        let photo = picture(&mut noise, size.0 * size.1);
        let mask = (0..size.0 * size.1).map(|_| level(noise.between(0.0, 1.0)) as f32).collect();
        Self { size, rays, rows, photo, mask }
    }

    fn pass(&self, view: RasterCamera, channels: Channels) -> Pass {
        let mut pass = empty_pass(view, &ShadingOptions::default(), channels);
        for (i, row) in self.rows.iter().enumerate() {
            for (c, value) in row.iter().enumerate().take(channels.count()) {
                set(&mut pass, i % self.size.0, i / self.size.0, c, *value as f32);
            }
        }
        pass
    }

    fn normal(&self, i: usize) -> Rgb {
        std::array::from_fn(|k| self.rows[i][NORMAL + k])
    }

    fn depth(&self, i: usize) -> Option<f64> {
        let facing = dot(self.normal(i), self.rays[i]);
        let t = self.rows[i][channel::PLANE] / facing;
        (self.rows[i][0] >= 0.5 && facing < -0.05 && t > 0.0 && t < 1e4).then_some(t)
    }

    /// Mean of `coverage (1 - n . n_d)`, and the number of pixels that contribute.
    fn depth_normal(&self) -> (f64, usize) {
        let (w, h) = self.size;
        let (mut sum, mut count) = (0.0, 0);
        for i in 0..w * h {
            if i % w + 1 >= w || i / w + 1 >= h {
                continue;
            }
            let (Some(a), Some(b), Some(c)) = (self.depth(i), self.depth(i + 1), self.depth(i + w)) else {
                continue;
            };
            if (b - a).abs() > 0.05 * a || (c - a).abs() > 0.05 * a {
                continue;
            }
            let edge = |j: usize, t: f64| std::array::from_fn(|k| self.rays[j][k] * t - self.rays[i][k] * a);
            let towards = unit(cross(edge(i + w, c), edge(i + 1, b)));
            sum += self.rows[i][0] * (1.0 - dot(unit(self.normal(i)), towards));
            count += 1;
        }
        (sum / (w * h) as f64, count)
    }

    fn coverage(&self) -> f64 {
        let pairs = self.rows.iter().zip(&self.mask);
        pairs.map(|(r, m)| (r[0] - f64::from(*m)).abs()).sum::<f64>() / self.rows.len() as f64
    }

    fn smoothness(&self, [metal, rough, of_normal]: [f32; 3]) -> f64 {
        let (w, h) = self.size;
        let weigh = |weight: f32, value: f64| f64::from(weight) * value;
        let attribute = |i: usize, c: usize| {
            if self.rows[i][0] < f64::from(1e-3f32) { 0.0 } else { self.rows[i][c] / self.rows[i][0] }
        };
        let pair = |i: usize, j: usize| {
            let edge: f64 = (0..3).map(|c| (self.photo[i][c] - self.photo[j][c]).abs()).sum::<f64>() / 3.0;
            let d = |c: usize| (attribute(i, c) - attribute(j, c)).abs();
            let normal = (d(NORMAL) + d(NORMAL + 1) + d(NORMAL + 2)) / 3.0;
            (-edge).exp()
                * (weigh(metal, d(channel::METAL))
                    + weigh(rough, d(channel::ROUGH))
                    + weigh(of_normal, normal))
        };
        let all = || (0..w * h).map(|i| (i % w, i / w, i));
        let across: f64 = all().filter(|p| p.0 + 1 < w).map(|(_, _, i)| pair(i, i + 1)).sum();
        let down: f64 = all().filter(|p| p.1 + 1 < h).map(|(_, _, i)| pair(i, i + w)).sum();
        across / ((w - 1) * h) as f64 + down / (w * (h - 1)) as f64
    }

    fn terms(&self, weights: &SurfaceWeights) -> [f64; 3] {
        let weigh = |weight: f32, value: f64| if weight == 0.0 { 0.0 } else { f64::from(weight) * value };
        [
            weigh(weights.coverage, self.coverage()),
            weigh(weights.depth_normal, self.depth_normal().0),
            self.smoothness(weights.smoothness),
        ]
    }
}

fn surface_on_device(
    gpu: &Gpu,
    view: &RasterCamera,
    buffers: &Buffers,
    channels: Channels,
    weights: &SurfaceWeights,
) -> ([f32; 3], Vec<[f32; 4]>) {
    let uniform = CameraUniform::new(view);
    let pass = buffers.pass(*view, channels);
    let gbuffer = gpu.upload("gbuffer", &planar_gbuffer(&pass, &pass.gbuffer, channels)).unwrap();
    let photo = uploaded_photo(gpu, &buffers.photo, &buffers.mask, DisplayRange::Unit);
    let by_buffers = gpu.buffer("by buffers", 2 * uniform.pixels()).unwrap();
    let losses = gpu.buffer("losses", LOSS_SLOTS).unwrap();
    let mut recorder = gpu.record();
    recorder.clear(&losses);
    surface_terms(&mut recorder, &uniform, channels, weights, &photo, [&gbuffer, &by_buffers], &losses);
    recorder.submit().unwrap();
    let losses = gpu.read(&losses, 6..9).unwrap();
    ([losses[0], losses[1], losses[2]], gpu.read(&by_buffers, 0..by_buffers.len()).unwrap())
}

/// Gradients of one pixel as (channel, value).
fn by_channel(by_buffers: &[[f32; 4]], i: usize) -> [(usize, f32); 7] {
    let (a, b) = (by_buffers[i], by_buffers[by_buffers.len() / 2 + i]);
    [
        (NORMAL, a[0]),
        (NORMAL + 1, a[1]),
        (NORMAL + 2, a[2]),
        (channel::PLANE, a[3]),
        (channel::COVERAGE, b[0]),
        (channel::METAL, b[1]),
        (channel::ROUGH, b[2]),
    ]
}

/// Weights of metalness, roughness and normal, all different, so that a mix-up fails.
const SMOOTH: [f32; 3] = [0.15, 0.06, 0.1];

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn surface_terms_and_gradients_match_the_formulas() {
    let gpu = Gpu::for_tests();
    let none = SurfaceWeights::default();
    let cases = [
        (Channels::Material, SurfaceWeights { coverage: 0.5, depth_normal: 0.2, smoothness: SMOOTH }),
        (Channels::Material, SurfaceWeights { depth_normal: 0.2, ..none }),
        (Channels::Full(4), SurfaceWeights { smoothness: SMOOTH, ..none }),
        (Channels::Geometry, SurfaceWeights { coverage: 0.5, depth_normal: 0.2, smoothness: [0.0; 3] }),
        (Channels::Colour, SurfaceWeights { coverage: 0.5, ..none }),
    ];
    let view = camera_view((19, 17), &ShadingOptions::default());
    for (seed, (channels, weights)) in cases.into_iter().enumerate() {
        let buffers = Buffers::new(seed as u64, &view);
        let shares = buffers.depth_normal().1;
        assert!(shares > 60 && shares < 250, "the gates must open and close: {shares}");
        let (found, by_buffers) = surface_on_device(&gpu, &view, &buffers, channels, &weights);
        let expected = buffers.terms(&weights);
        for k in 0..3 {
            let difference = (f64::from(found[k]) - expected[k]).abs();
            assert!(difference < 1e-5 * expected[k].max(1e-6), "{channels:?} {k}: {found:?} {expected:?}");
        }
        let (mut analytic, mut numeric) = (vec![Vec::new(); 13], vec![Vec::new(); 13]);
        for i in 0..buffers.rows.len() {
            for (c, value) in by_channel(&by_buffers, i) {
                let at = |step: f64| {
                    let mut moved = buffers.clone();
                    moved.rows[i][c] += step;
                    moved.terms(&weights).iter().sum::<f64>()
                };
                analytic[c].push(value);
                numeric[c].push(((at(1e-7) - at(-1e-7)) / 2e-7) as f32);
            }
        }
        for c in (0..13).filter(|c| !numeric[*c].is_empty()) {
            if numeric[c].iter().any(|v| v.abs() > 1e-9) {
                let seen = relative_error(&analytic[c], &numeric[c]);
                assert!(seen < 1e-4, "{channels:?} channel {c}: {seen}");
            } else {
                assert!(
                    analytic[c].iter().all(|v| v.abs() < 1e-9),
                    "{channels:?} channel {c}: {:?}",
                    analytic[c]
                );
            }
        }
        assert!(channels != Channels::Colour || analytic[4].iter().all(|v| *v == 0.0));
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn surface_term_comparison_detects_one_changed_pixel() {
    let gpu = Gpu::for_tests();
    let view = camera_view((19, 17), &ShadingOptions::default());
    let weights = SurfaceWeights { coverage: 0.5, depth_normal: 0.2, smoothness: SMOOTH };
    let buffers = Buffers::new(5, &view);
    let mut changed = buffers.clone();
    changed.rows[100].iter_mut().for_each(|v| *v *= 0.99);
    let (_, by) = surface_on_device(&gpu, &view, &buffers, Channels::Material, &weights);
    let (found, by_changed) = surface_on_device(&gpu, &view, &changed, Channels::Material, &weights);
    let expected = buffers.terms(&weights);
    assert!((f64::from(found[0]) - expected[0]).abs() > 1e-5 * expected[0]);
    let first = |by: &[[f32; 4]]| by.iter().flat_map(|p| [p[0], p[1], p[2]]).collect::<Vec<f32>>();
    let seen = relative_error(&first(&by_changed), &first(&by));
    assert!(seen.is_finite() && seen > 1e-4, "{seen}");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn images_one_pixel_wide_or_high_have_only_the_coverage_term() {
    let gpu = Gpu::for_tests();
    let weights = SurfaceWeights { coverage: 0.5, depth_normal: 0.2, smoothness: SMOOTH };
    for size in [(1, 1), (5, 1), (1, 33)] {
        let view = camera_view(size, &ShadingOptions::default());
        let buffers = Buffers::new(9, &view);
        let (found, by) = surface_on_device(&gpu, &view, &buffers, Channels::Material, &weights);
        assert!((f64::from(found[0]) - 0.5 * buffers.coverage()).abs() < 1e-6 && found[1..] == [0.0, 0.0]);
        assert!(by[..by.len() / 2].iter().all(|v| *v == [0.0; 4]));
    }
}

#[test]
fn uniforms_are_laid_out_as_the_shaders_read_them() {
    assert_layout!(ImageTermUniform as "ImageTerm" in shaders::SSIM; size, first_slot, scale, l1, ssim,
        photo_white, pad);
    assert_layout!(SurfaceTermsUniform as "SurfaceTerms" in shaders::SURFACE_TERMS_COLOUR; coverage, depth_normal,
        across, down, smoothness, photo_white);
}
