//! Images of both branches of a view from its G-buffer, forward and backward.

use rayon::prelude::*;

use crate::cpu::lanes::LANES;
use crate::cpu::pass::Pass;
use crate::cpu::project::normalise;
use crate::cpu::surface::{MAX_COEFFICIENTS, Surface, SurfaceShader};
use crate::zeros;
use relume_layout::channel::{self, Channels, GROUP, IncidentLight, OutgoingRadiance, RowLight};
use relume_layout::constants::{MIN_COVERAGE, TILE};
use relume_scene::light::LightTables;
use relume_scene::{MAX_LIGHTS, ShadeAt, sh_count};

/// Both branches of a view, composited over the background, row-major: display values in the range of the photographs.
#[derive(Debug, Clone, Default)]
pub struct BranchImages {
    /// Physically based branch.
    pub physical: Vec<[f32; 3]>,
    /// Radiance branch.
    pub radiance: Vec<[f32; 3]>,
}

/// Extra gradient of one pixel's G-buffer, from losses on the buffers themselves.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct BufferGradient {
    /// Gradient by blended (not normalised) normal.
    pub normal: [f32; 3],
    /// Gradient by blended plane distance.
    pub plane: f32,
    /// Gradient by blended metalness.
    pub metal: f32,
    /// Gradient by blended roughness.
    pub rough: f32,
    /// Gradient by coverage.
    pub coverage: f32,
}

/// The surface in pixel (`x`, `y`) and its coverage, or `None` where coverage is too small to shade. The surface has no
/// incident light in a pass whose Gaussians were shaded before blending.
pub fn surface_at(pass: &Pass, x: usize, y: usize) -> Option<(Surface, f32)> {
    let base = pass.locate(x, y, pass.channels.stored());
    let at = |c: usize| pass.gbuffer[base + c * LANES];
    let coverage = at(channel::COVERAGE);
    if !(coverage >= MIN_COVERAGE) {
        return None;
    }
    let inverse = 1.0 / coverage;
    let triple = |r: std::ops::Range<usize>| std::array::from_fn(|k| at(r.start + k) * inverse);
    let mut visibility = [0.0f32; MAX_COEFFICIENTS];
    if let Channels::Full(n) = pass.channels {
        for (j, v) in visibility.iter_mut().enumerate().take(n) {
            *v = at(channel::VISIBILITY + j) * inverse;
        }
    }
    let incident = match pass.light {
        RowLight::Incident => IncidentLight {
            gathered: triple(IncidentLight::GATHERED),
            blocked: triple(IncidentLight::BLOCKED),
        },
        RowLight::Outgoing => IncidentLight::default(),
    };
    let (ray, _) = normalise(pass.view.ray(x, y));
    let surface = Surface {
        normal: triple(channel::NORMAL),
        albedo: triple(channel::ALBEDO),
        metal: at(channel::METAL) * inverse,
        rough: at(channel::ROUGH) * inverse,
        sheen: 0.0,
        gathered: incident.gathered,
        blocked: incident.blocked,
        arriving: [0.0; MAX_LIGHTS],
        visibility,
        view: ray.map(|v| -v),
    };
    Some((surface, coverage))
}

/// Radiance in pixel (`x`, `y`) of a pass whose Gaussians were shaded before blending, or `None` where coverage is too small.
fn blended_radiance(pass: &Pass, x: usize, y: usize) -> Option<[f32; 3]> {
    let coverage = pass.at(x, y, channel::COVERAGE);
    let light = || std::array::from_fn(|c| pass.at(x, y, OutgoingRadiance::TOTAL.start + c) / coverage);
    (coverage >= MIN_COVERAGE).then(light)
}

impl SurfaceShader<'_> {
    /// Linear radiance of a pixel, or `None` where coverage is too small to shade.
    fn light_at(&self, pass: &Pass, x: usize, y: usize) -> Option<[f32; 3]> {
        if self.options.shade_at == ShadeAt::Gaussian {
            return blended_radiance(pass, x, y);
        }
        let (surface, _) = surface_at(pass, x, y)?;
        Some(self.shade(&surface).outgoing().total())
    }

    /// Shades every pixel of a pass and composites both branches over `background`. The pass carries all channels or, where
    /// its Gaussians were shaded before blending, materials.
    pub fn images(&self, pass: &Pass, background: [f32; 3]) -> BranchImages {
        let (w, h) = (pass.view.width, pass.view.height);
        let mut out = BranchImages { physical: vec![[0.0; 3]; w * h], radiance: vec![[0.0; 3]; w * h] };
        let rows = out.physical.par_chunks_mut(w).zip(out.radiance.par_chunks_mut(w)).enumerate();
        rows.for_each(|(y, (physical, radiance))| {
            for x in 0..w {
                radiance[x] = radiance_pixel(pass, x, y, background);
                let coverage = pass.at(x, y, channel::COVERAGE);
                let shown =
                    self.light_at(pass, x, y).map_or([0.0; 3], |light| light.map(|v| self.display(v)));
                physical[x] = std::array::from_fn(|c| shown[c] * coverage + background[c] * (1.0 - coverage));
            }
        });
        out
    }

    /// Gradient of the first `count` G-buffer channels (`[tile][row][channel][lane]`, rounded up to 4 channels)
    /// and of the light tables, from the gradients of both images and of the buffers.
    pub fn images_backward(
        &self,
        pass: &Pass,
        background: [f32; 3],
        by: &BranchImages,
        by_buffers: &[BufferGradient],
        count: usize,
    ) -> (Vec<f32>, LightTables) {
        let (out, partial) = write_pixels(
            pass,
            count,
            || (self.options.shade_at == ShadeAt::Pixel).then(|| self.tables.zeroed()),
            |i, at, pixel, tables| {
                let extra = by_buffers.get(i).copied().unwrap_or_default();
                radiance_backward(background, by.radiance.get(i), pixel);
                self.pixel_backward(pass, at, background, by.physical.get(i), extra, pixel, tables.as_mut());
            },
        );
        let mut tables = self.tables.zeroed();
        partial.iter().flatten().for_each(|p| tables.accumulate(p));
        (out, tables)
    }

    fn pixel_backward(
        &self,
        pass: &Pass,
        (x, y): (usize, usize),
        background: [f32; 3],
        by_image: Option<&[f32; 3]>,
        extra: BufferGradient,
        out: &mut PixelGradient<'_>,
        tables: Option<&mut LightTables>,
    ) {
        out.add(channel::COVERAGE, extra.coverage);
        out.add_triple(channel::NORMAL, extra.normal);
        out.add(channel::PLANE, extra.plane);
        out.add(channel::METAL, extra.metal);
        out.add(channel::ROUGH, extra.rough);
        let Some(g) = by_image else { return };
        let coverage = pass.at(x, y, channel::COVERAGE);
        let mut by_coverage: f32 = (0..3).map(|c| -g[c] * background[c]).sum();
        if coverage >= MIN_COVERAGE {
            by_coverage += match tables {
                None => self.blended_backward(pass, (x, y), *g, out),
                Some(tables) => self.surface_backward(pass, (x, y), *g, out, tables),
            };
        }
        out.add(channel::COVERAGE, by_coverage);
    }

    /// Chain rule through the display of blended light; returns the gradient by coverage.
    fn blended_backward(
        &self,
        pass: &Pass,
        (x, y): (usize, usize),
        g: [f32; 3],
        out: &mut PixelGradient<'_>,
    ) -> f32 {
        let Some(light) = blended_radiance(pass, x, y) else { return 0.0 };
        let coverage = pass.at(x, y, channel::COVERAGE);
        let mut by_coverage = 0.0;
        for c in 0..3 {
            // Light is a buffer divided by coverage; `g` contains the coverage that multiplies it again.
            let shown = self.display(light[c]);
            let by_light = self.display_backward(light[c], shown, g[c] * coverage);
            by_coverage += g[c] * shown - by_light * light[c] / coverage;
            out.add(OutgoingRadiance::TOTAL.start + c, by_light / coverage);
        }
        by_coverage
    }

    /// Chain rule through the shading of a pixel's surface; returns the gradient by coverage.
    fn surface_backward(
        &self,
        pass: &Pass,
        (x, y): (usize, usize),
        g: [f32; 3],
        out: &mut PixelGradient<'_>,
        tables: &mut LightTables,
    ) -> f32 {
        let Some((surface, coverage)) = surface_at(pass, x, y) else { return 0.0 };
        let shaded = self.shade(&surface);
        let mut by_linear = [0.0f32; 3];
        let mut by_coverage = 0.0;
        for c in 0..3 {
            let linear = shaded.diffuse[c] + shaded.specular[c];
            let shown = self.display(linear);
            by_coverage += g[c] * shown;
            by_linear[c] = self.display_backward(linear, shown, g[c] * coverage);
        }
        let by = self.shade_backward(&surface, &shaded, by_linear, tables, true);
        // Attributes are buffers divided by coverage.
        let inverse = 1.0 / coverage;
        let mut along = 0.0;
        for k in 0..3 {
            along += by.normal[k] * surface.normal[k]
                + by.albedo[k] * surface.albedo[k]
                + by.gathered[k] * surface.gathered[k]
                + by.blocked[k] * surface.blocked[k];
        }
        along += by.metal * surface.metal + by.rough * surface.rough;
        for j in 0..sh_count(self.sh_degree) {
            along += by.visibility[j] * surface.visibility[j];
        }
        out.add_triple(channel::NORMAL, by.normal.map(|v| v * inverse));
        out.add_triple(channel::ALBEDO, by.albedo.map(|v| v * inverse));
        out.add(channel::METAL, by.metal * inverse);
        out.add(channel::ROUGH, by.rough * inverse);
        out.add_triple(IncidentLight::GATHERED, by.gathered.map(|v| v * inverse));
        if out.count > channel::VISIBILITY {
            out.add_triple(IncidentLight::BLOCKED, by.blocked.map(|v| v * inverse));
            for j in 0..out.count - channel::VISIBILITY {
                out.add(channel::VISIBILITY + j, by.visibility[j] * inverse);
            }
        }
        by_coverage - along * inverse
    }
}

/// One pixel of the G-buffer gradient.
struct PixelGradient<'a> {
    target: &'a mut [f32],
    base: usize,
    count: usize,
}

impl PixelGradient<'_> {
    #[inline]
    fn add(&mut self, channel: usize, value: f32) {
        if channel < self.count {
            self.target[self.base + channel * LANES] += value;
        }
    }

    #[inline]
    fn add_triple(&mut self, channels: std::ops::Range<usize>, values: [f32; 3]) {
        for (channel, value) in channels.zip(values) {
            self.add(channel, value);
        }
    }
}

/// The gradient of the first `count` channels of `pass`, and the sums of each row of tiles, which start as `sums()`. The
/// function calls `write(i, (x, y), pixel, sums)` for each pixel; `i` is its row-major index.
fn write_pixels<S: Send>(
    pass: &Pass,
    count: usize,
    sums: impl Fn() -> S + Sync,
    write: impl Fn(usize, (usize, usize), &mut PixelGradient<'_>, &mut S) + Sync,
) -> (Vec<f32>, Vec<S>) {
    let stored = count.next_multiple_of(GROUP);
    let band = pass.tiles.columns * TILE * stored * LANES;
    let mut out = zeros(pass.tiles.rows * band);
    let rows = out.par_chunks_mut(band.max(1)).enumerate();
    let of_rows = rows
        .map(|(tile_row, target)| {
            let mut sums = sums();
            let first = tile_row * TILE;
            for y in first..(first + TILE).min(pass.view.height) {
                for x in 0..pass.view.width {
                    let base = pass.locate(x, y, stored) - tile_row * band;
                    let mut pixel = PixelGradient { target: &mut *target, base, count };
                    write(y * pass.view.width + x, (x, y), &mut pixel, &mut sums);
                }
            }
            sums
        })
        .collect();
    (out, of_rows)
}

/// Radiance branch of one pixel over the background.
fn radiance_pixel(pass: &Pass, x: usize, y: usize, background: [f32; 3]) -> [f32; 3] {
    let rest = 1.0 - pass.at(x, y, channel::COVERAGE);
    std::array::from_fn(|c| pass.at(x, y, channel::RADIANCE.start + c) + background[c] * rest)
}

fn radiance_backward(background: [f32; 3], by_image: Option<&[f32; 3]>, out: &mut PixelGradient<'_>) {
    let Some(g) = by_image else { return };
    out.add_triple(channel::RADIANCE, *g);
    out.add(channel::COVERAGE, (0..3).map(|c| -g[c] * background[c]).sum());
}

/// The radiance branch alone, for passes without material.
pub fn radiance_image(pass: &Pass, background: [f32; 3]) -> Vec<[f32; 3]> {
    let w = pass.view.width;
    let pixel = |i: usize| radiance_pixel(pass, i % w, i / w, background);
    (0..w * pass.view.height).into_par_iter().with_min_len(1024).map(pixel).collect()
}

/// Backward of [`radiance_image`], with extra buffer gradients, for the first `count` channels.
pub fn radiance_image_backward(
    pass: &Pass,
    background: [f32; 3],
    by_image: &[[f32; 3]],
    by_buffers: &[BufferGradient],
    count: usize,
) -> Vec<f32> {
    let (out, _) = write_pixels(
        pass,
        count,
        || (),
        |i, _, pixel, ()| {
            let extra = by_buffers.get(i).copied().unwrap_or_default();
            radiance_backward(background, by_image.get(i), pixel);
            pixel.add(channel::COVERAGE, extra.coverage);
            pixel.add_triple(channel::NORMAL, extra.normal);
            pixel.add(channel::PLANE, extra.plane);
        },
    );
    out
}
