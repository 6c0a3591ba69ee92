//! The diffuse term at the Gaussians, against the CPU engine.

use super::*;
use crate::engine::channel::DIFFUSE;
use crate::engine::cpu::{ROW_HEADER, Shader as CpuShader};
use crate::engine::gpu::light::{Constants, LightBuffers, flat};
use crate::engine::gpu::shading::tests::{Noise, error, random_tables};
use crate::engine::gpu::shading::{ShadeJob, ShadingUniform};
use crate::light::LightTables;
use crate::scene::{DiffuseAt, DiffuseForm, VisibilityForm, sh_count};

/// What both directions give, by Gaussian that is drawn.
struct Found {
    /// Diffuse channels of the attributes.
    radiance: Vec<f32>,
    /// Gradients by the differentiated channels.
    rows: Vec<f32>,
    /// Gradient by the tables.
    by_tables: Vec<f32>,
}

impl Found {
    /// Errors of each, relative to the largest expected.
    fn errors(&self, expected: &Found) -> [f32; 3] {
        [
            error(&self.radiance, &expected.radiance),
            error(&self.rows, &expected.rows),
            error(&self.by_tables, &expected.by_tables),
        ]
    }
}

struct Case {
    scene: Scene,
    order: usize,
    tables: LightTables,
    /// Channels of the way back.
    differentiated: Channels,
}

impl Case {
    fn new(seed: u64, order: usize, options: ShadingOptions, all: bool) -> Self {
        // More than one workgroup, the last one not full.
        let scene = Scene::random(seed, 300, (37, 21), order).with_options(options);
        let tables = random_tables(&mut Noise::new(seed), order);
        let differentiated = if all { Channels::Full(sh_count(order)) } else { Channels::Material };
        Self { scene, order, tables, differentiated }
    }

    fn full(&self) -> Channels {
        Channels::Full(sh_count(self.order))
    }

    /// A gradient of noise by every pixel's differentiated channels, `[pixel][stored]`.
    fn by_gbuffer(&self) -> Vec<Vec<f32>> {
        let mut noise = Noise::new(17);
        let channels = self.differentiated;
        let mut row = || {
            (0..channels.stored())
                .map(|c| if c < channels.count() { noise.between(-0.5, 0.5) } else { 0.0 })
                .collect()
        };
        (0..self.scene.view.width * self.scene.view.height).map(|_| row()).collect()
    }

    fn on_cpu(&self, drawn: &[usize]) -> Found {
        let shader = CpuShader { tables: &self.tables, options: &self.scene.options, order: self.order };
        let source = self.scene.source().under(shader);
        let pass = Pass::forward(&source, self.scene.view, self.full(), false);
        let (count, stored) = (self.differentiated.count(), self.differentiated.stored());
        let by = backward::for_cpu(&pass, &self.scene.view, &self.by_gbuffer());
        let width = ROW_HEADER + count;
        let mut rows = pass.splat_gradients(&by, stored, count);
        let mut by_tables = self.tables.zeroed();
        pass.diffuse_backward(&source, &mut rows, width, &mut by_tables);
        let rank = |i: &usize| pass.splats.iter().position(|s| s.gaussian as usize == *i).unwrap();
        let ranks: Vec<usize> = drawn.iter().map(rank).collect();
        let carried = self.full().stored();
        let radiance = |rank: &usize| {
            DIFFUSE.map({
                let first = rank * carried;
                move |c| first + c
            })
        };
        Found {
            radiance: ranks.iter().flat_map(radiance).map(|at| pass.attributes[at]).collect(),
            rows: ranks.iter().flat_map(|r| rows[r * width + ROW_HEADER..(r + 1) * width].to_vec()).collect(),
            by_tables: flat(&by_tables),
        }
    }

    /// Gaussians that reach a tile, and what the device finds for them.
    fn on_gpu(&self, raster: &mut Raster) -> (Vec<usize>, Found) {
        let (gpu, n) = (raster.gpu.clone(), self.scene.gaussians.len());
        self.scene.gpu(raster, self.full(), false);
        let params = gpu.upload("params", &planar(&self.scene.gaussians)).unwrap();
        let gathered = gpu.upload("gathered", self.scene.gathered.as_flattened()).unwrap();
        let light = LightBuffers::upload(&gpu, &self.tables, self.order, &[[0.0; 3]; 16]).unwrap();
        let constants = Constants::upload(&gpu).unwrap();
        let by_tables = gpu.buffer("by tables", light.layout.floats()).unwrap();
        let by = gpu.upload("by", &backward::planes(&self.by_gbuffer())).unwrap();
        let (view, shading) =
            (ViewUniform::new(&self.scene.view), ShadingUniform::new(&self.scene.options, [0.0; 3]));
        let job = ShadeJob {
            view: &view,
            shading: &shading,
            n_visibility: sh_count(self.order),
            light: &light,
            constants: &constants,
        };
        let mut rec = gpu.record();
        raster.light(&mut rec, &job, &params).unwrap();
        raster.blend(&mut rec, self.full(), false).unwrap();
        let groups = groups(self.differentiated);
        raster.blend_backward(&mut rec, &by, groups).unwrap();
        rec.clear(&by_tables);
        let to = LightGradients {
            gathered: (!self.scene.gathered.is_empty()).then_some(&gathered),
            by_tables: &by_tables,
            all_channels: self.differentiated == self.full(),
        };
        raster.light_backward(&mut rec, &job, &params, &to).unwrap();
        rec.submit().unwrap();
        let splats = gpu.read(raster.splats.as_ref().unwrap(), 0..n).unwrap();
        let drawn: Vec<usize> = (0..n).filter(|i| splats[*i].flags == 1 && splats[*i].n_tiles > 0).collect();
        let carried = self.full().stored() / 4;
        let attributes = gpu.read(raster.attributes.as_ref().unwrap(), 0..n * carried).unwrap();
        let width = GRADIENT_HEADER + 4 * groups;
        let rows = gpu.read(raster.splat_gradients.as_ref().unwrap(), 0..n * width).unwrap();
        let count = self.differentiated.count();
        let found = Found {
            radiance: drawn.iter().flat_map(|i| attributes[i * carried + 3][1..].to_vec()).collect(),
            rows: drawn.iter().flat_map(|i| rows[i * width + GRADIENT_HEADER..][..count].to_vec()).collect(),
            by_tables: gpu.read(&by_tables, 0..by_tables.len()).unwrap(),
        };
        (drawn, found)
    }

    fn errors(&self, raster: &mut Raster) -> [f32; 3] {
        let (drawn, found) = self.on_gpu(raster);
        assert!(drawn.len() > 200, "too little to compare: {}", drawn.len());
        found.errors(&self.on_cpu(&drawn))
    }
}

fn assert_small([radiance, rows, by_tables]: [f32; 3], name: &str) {
    assert!(radiance < 2e-5 && rows < 1e-4 && by_tables < 1e-4, "{name}: {radiance} {rows} {by_tables}");
}

#[test]
fn every_form_lights_the_gaussians_as_the_cpu_engine_does() {
    let Some(gpu) = Gpu::for_tests() else { return };
    let mut raster = Raster::new(&gpu).unwrap();
    for visibility in [VisibilityForm::Linear, VisibilityForm::Sigmoid, VisibilityForm::Off] {
        for diffuse in [DiffuseForm::Directional, DiffuseForm::AmbientOcclusion] {
            let options = ShadingOptions { visibility, diffuse, ..ShadingOptions::default() };
            for all in [false, true] {
                let mut case = Case::new(3, 2, options, all);
                assert_small(case.errors(&mut raster), &format!("{options:?} {all}"));
                case.scene.gathered.clear();
                assert_small(case.errors(&mut raster), &format!("{options:?} {all}, nothing gathered"));
            }
        }
    }
}

#[test]
fn every_order_lights_the_gaussians_as_the_cpu_engine_does() {
    let Some(gpu) = Gpu::for_tests() else { return };
    let mut raster = Raster::new(&gpu).unwrap();
    for order in [0, 1, 3, 4, 5, 6] {
        // The largest kernels take a software device seconds to compile: one of the two ways back each.
        for all in [false, true].into_iter().filter(|all| order < 5 || *all == (order == 6)) {
            let case = Case::new(40 + order as u64, order, ShadingOptions::default(), all);
            assert_small(case.errors(&mut raster), &format!("order {order} {all}"));
        }
    }
}

#[test]
fn the_comparison_of_lit_gaussians_notices_their_normals_and_what_was_gathered() {
    let Some(gpu) = Gpu::for_tests() else { return };
    let mut raster = Raster::new(&gpu).unwrap();
    let case = || Case::new(3, 2, ShadingOptions::default(), false);
    let (drawn, found) = case().on_gpu(&mut raster);
    let mut turned = case();
    turned.scene.gaussians.field_mut(Field::Normal).iter_mut().for_each(|v| *v += 0.05);
    let mut brighter = case();
    brighter.scene.gathered.iter_mut().flatten().for_each(|v| *v += 0.05);
    for (name, other) in [("normals", turned), ("gathered", brighter)] {
        let errors = found.errors(&other.on_cpu(&drawn));
        assert!(errors[0] > 1e-3 && errors[1] > 1e-4, "{name}: {errors:?}");
    }
    let unlit = ShadingOptions { diffuse_at: DiffuseAt::Pixel, ..ShadingOptions::default() };
    let (_, plain) = Case::new(3, 2, unlit, false).on_gpu(&mut raster);
    assert!(plain.by_tables.iter().all(|v| *v == 0.0), "a deferred model has nothing lit here");
}

#[test]
fn a_device_without_float_atomics_sums_the_same_table() {
    let options = crate::engine::gpu::GpuOptions {
        compare_exchange: true,
        garbage: true,
        checks: true,
        ..Default::default()
    };
    let Some(gpu) = Gpu::with_options(options) else { return };
    let mut raster = Raster::new(&gpu).unwrap();
    assert_small(Case::new(8, 1, ShadingOptions::default(), false).errors(&mut raster), "compare-exchange");
}
