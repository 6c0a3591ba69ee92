//! The parameter update against the CPU engine, and against f64 where the CPU engine has no counterpart.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::cpu::{AttributeSource as CpuSource, Pass, ROW_HEADER, backward_labels};
use crate::gpu::shaders::assert_layout;
use crate::gpu::shading::tests::error_of_entries;
use crate::gpu::{GpuOptions, model::LayoutUniform};
use crate::{Gradients, RasterCamera};
use relume_layout::channel::{Channels, IncidentLight};
use relume_layout::constants::EarlyStop;
use relume_scene::{Camera, Gaussians, IndirectForm, Model, NormalForm, ShadingOptions, VisibilityForm};

mod parity;
mod pipeline;
mod steps;
mod terms;

/// Settings of a random case.
#[derive(Clone, Copy, Debug)]
struct Shape {
    n: usize,
    prototypes: usize,
    visibility: usize,
    radiance: usize,
    channels: Channels,
    options: ShadingOptions,
}

impl Default for Shape {
    fn default() -> Self {
        Self {
            n: 150,
            prototypes: 8,
            visibility: 2,
            radiance: 2,
            channels: Channels::Full(9),
            options: ShadingOptions::default(),
        }
    }
}

/// A random model, a view of it, and the gradients from its image.
struct UpdateCase {
    model: Model,
    basis: [[f32; 3]; 16],
    view: RasterCamera,
    groups: usize,
    records: Vec<SplatRecord>,
    rows: Vec<f32>,
    expected: Gradients,
    by_basis: [[f64; 3]; 16],
    /// Gradient of the G-buffer, `[group][pixel]`.
    by_gbuffer: Vec<[f32; 4]>,
    labels: Vec<[f32; 2]>,
}

fn random_model(shape: &Shape, rng: &mut ChaCha8Rng) -> Model {
    let mut g = Gaussians::zeroed(shape.n, shape.prototypes, shape.visibility, shape.radiance);
    let spread = |field: Field| match field {
        Field::Mean => (0.0, 0.8),
        Field::LogScale => (-2.4, 0.6),
        Field::OpacityLogit => (0.5, 1.5),
        Field::Residual => (0.0, 0.5),
        // Some Gaussians are enlarged, some are not.
        Field::SamplingRate => (30.0, 25.0),
        Field::Visibility | Field::Indirect | Field::Radiance | Field::Normal => (0.0, 0.4),
        Field::Quaternion | Field::MetalLogit | Field::RoughLogit | Field::Sheen | Field::ProtoLogits => {
            (0.0, 1.5)
        }
    };
    for (field, _, data) in g.fields_mut() {
        let (centre, half) = spread(field);
        data.iter_mut().for_each(|v| *v = centre + half * rng.random_range(-1.0f32..1.0));
    }
    if shape.n > 3 {
        g.row_mut(Field::Quaternion, 0).fill(0.0);
        g.row_mut(Field::LogScale, 1).fill(-2.0);
        g.row_mut(Field::Mean, 2).copy_from_slice(&[0.1, 0.2, -9.0]);
        // Far off the axis: the ratios of the Jacobian are clamped.
        g.row_mut(Field::Mean, 3).copy_from_slice(&[2.9, 0.1, -1.0]);
        g.row_mut(Field::LogScale, 3).copy_from_slice(&[0.2, 0.1, 0.0]);
    }
    Model {
        shading: shape.options,
        ..Model::new(
            g,
            (0..shape.prototypes)
                .map(|_| std::array::from_fn(|_| rng.random_range(-0.15f32..1.15)))
                .collect(),
            vec![[0.1; 3]; 8],
            (4, 2),
        )
    }
}

fn camera() -> Camera {
    Camera {
        width: 37,
        height: 21,
        fx: 30.0,
        fy: 31.0,
        cx: 18.2,
        cy: 10.6,
        rotation: glam::DMat3::from_rotation_z(0.3) * glam::DMat3::from_rotation_x(0.2),
        translation: glam::DVec3::new(0.05, -0.1, 2.5),
    }
}

fn source<'a>(model: &'a Model, basis: &'a [[f32; 3]; 16]) -> CpuSource<'a> {
    CpuSource {
        gaussians: &model.gaussians,
        prototypes: &model.prototypes,
        options: &model.shading,
        gathered: &[],
        arriving: &[],
        indirect_basis: basis,
        light: None,
    }
}

impl UpdateCase {
    fn new(shape: &Shape, seed: u64, spoil: impl Fn(&mut Model)) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut model = random_model(shape, &mut rng);
        spoil(&mut model);
        let basis = std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-0.5f32..0.8)));
        let source = source(&model, &basis);
        let view = RasterCamera::new(&camera(), &model.shading);
        let pass = Pass::forward(&source, view, shape.channels, EarlyStop::WhenSaturated);
        let (count, stored) = (shape.channels.count(), shape.channels.stored());
        let mut by_gbuffer = vec![0.0f32; pass.gbuffer.len()];
        let mut planes = vec![[0.0f32; 4]; stored / 4 * view.width * view.height];
        for (x, y) in (0..view.height).flat_map(|y| (0..view.width).map(move |x| (x, y))) {
            for c in 0..count {
                let by = rng.random_range(-1.0..1.0);
                by_gbuffer[pass.locate(x, y, stored) + c * 16] = by;
                planes[(c / 4 * view.height + y) * view.width + x][c % 4] = by;
            }
        }
        let mut labels = vec![[0.0; 2]; shape.n];
        for (splat, l) in pass.splats.iter().zip(backward_labels(&pass)) {
            labels[splat.gaussian as usize] = [l.transmittance * l.weight, l.weight];
        }
        let expected = pass.backward(&source, &by_gbuffer, stored, count, None);
        let summed = pass.splat_gradients(&by_gbuffer, stored, count);
        let groups = stored / 4;
        let (records, rows) = device_rows(&pass, shape.n, &summed, count, groups);
        let mut by_basis = [[0.0; 3]; 16];
        if count >= IncidentLight::BLOCKED.end {
            for (splat, row) in pass.splats.iter().zip(summed.chunks_exact(ROW_HEADER + count)) {
                let weights = model.gaussians.row(Field::Indirect, splat.gaussian as usize);
                for (o, w) in by_basis.iter_mut().zip(weights) {
                    (0..3).for_each(|c| {
                        o[c] += f64::from(*w) * f64::from(row[ROW_HEADER + IncidentLight::BLOCKED.start + c])
                    });
                }
            }
        }
        Self { basis, view, groups, records, rows, expected, by_basis, by_gbuffer: planes, labels, model }
    }
}

/// The splat and the gradient row of each Gaussian; rows of invisible Gaussians hold garbage.
fn device_rows(
    pass: &Pass,
    n: usize,
    summed: &[f32],
    count: usize,
    groups: usize,
) -> (Vec<SplatRecord>, Vec<f32>) {
    let garbage = SplatRecord { flags: 0, ..bytemuck::cast([u32::MAX; 16]) };
    let mut records = vec![garbage; n];
    let mut rows = vec![f32::NAN; n * (8 + 4 * groups)];
    for (splat, from) in pass.splats.iter().zip(summed.chunks_exact(ROW_HEADER + count)) {
        let i = splat.gaussian as usize;
        records[i] = SplatRecord {
            mean: splat.mean,
            opacity: splat.opacity,
            reach: splat.reach,
            conic: splat.conic,
            depth: splat.depth,
            covariance: splat.covariance,
            compensation: splat.compensation,
            n_tiles: 1,
            flags: 1,
            pad_a: 0,
            pad_b: 0,
        };
        let row = &mut rows[i * (8 + 4 * groups)..(i + 1) * (8 + 4 * groups)];
        row.fill(0.0);
        row[..ROW_HEADER].copy_from_slice(&from[..ROW_HEADER]);
        row[8..8 + count].copy_from_slice(&from[ROW_HEADER..]);
    }
    (records, rows)
}

/// A case in device memory.
struct OnDevice {
    gpu: Gpu,
    updater: Updater,
    model: ModelBuffers,
    view: CameraUniform,
    groups: usize,
    splats: Buffer<SplatRecord>,
    rows: Buffer<f32>,
    basis: Buffer<f32>,
    by_basis: Buffer<f32>,
    probe_labels: Option<Buffer<f32>>,
    view_labels: Option<Buffer<[f32; 2]>>,
    globals_gradient: Buffer<f32>,
    losses: Buffer<f32>,
    density: Buffer<[f32; 2]>,
    list_status: Buffer<u32>,
    status: Buffer<u32>,
}

impl OnDevice {
    fn new(gpu: &Gpu, case: &UpdateCase) -> Self {
        let model = ModelBuffers::upload(gpu, &case.model).unwrap();
        let n = case.model.gaussians.len();
        Self {
            gpu: gpu.clone(),
            updater: Updater::new(gpu).unwrap(),
            view: CameraUniform::new(&case.view),
            groups: case.groups,
            splats: gpu.upload("splats", &case.records).unwrap(),
            rows: gpu.upload("rows", &case.rows).unwrap(),
            basis: gpu.upload("basis", bytemuck::cast_slice::<_, f32>(&case.basis)).unwrap(),
            by_basis: gpu.upload("by basis", &[0.0f32; 48]).unwrap(),
            probe_labels: None,
            view_labels: None,
            globals_gradient: gpu.upload("by globals", &vec![0.0f32; model.globals.len()]).unwrap(),
            losses: gpu.upload("losses", &[0.0f32; 16]).unwrap(),
            density: gpu.upload("density", &vec![[1.0f32, 2.0]; n]).unwrap(),
            list_status: gpu.upload("listed", &[0u32; 5]).unwrap(),
            status: gpu.upload("status", &[0u32; STATUS_WORDS]).unwrap(),
            model,
        }
    }

    fn sums(&self) -> UpdateSums<'_> {
        UpdateSums {
            globals_gradient: &self.globals_gradient,
            losses: &self.losses,
            density: &self.density,
            list_status: &self.list_status,
            status: &self.status,
        }
    }

    fn input(&self, terms: &ParameterWeights) -> StepInput<'_> {
        let upstream = UpstreamGradients {
            camera: &self.view,
            splats: &self.splats,
            gradients: &self.rows,
            groups: self.groups,
            indirect_basis: Some((&self.basis, &self.by_basis)),
            probe_labels: self.probe_labels.as_ref(),
            view_labels: self.view_labels.as_ref(),
        };
        StepInput { model: &self.model, upstream, sums: self.sums(), weights: *terms }
    }

    /// The gradients, planar as the model, and the gradient of the globals.
    fn gradients(&self, terms: &ParameterWeights) -> (Vec<f32>, Vec<f32>) {
        let out = self.gpu.buffer("gradients", self.model.params.len()).unwrap();
        let mut recorder = self.gpu.record();
        recorder.clear(&self.globals_gradient);
        recorder.clear(&self.by_basis);
        self.updater.gradients(&mut recorder, &self.input(terms), &out);
        recorder.submit().unwrap();
        let all = self.gpu.read(&out, 0..out.len()).unwrap();
        (all, self.gpu.read(&self.globals_gradient, 0..self.globals_gradient.len()).unwrap())
    }

    fn params(&self) -> Vec<f32> {
        self.gpu.read(&self.model.params, 0..self.model.layout.floats()).unwrap()
    }

    fn poisoned(&self) -> u32 {
        self.gpu.read(&self.status, 0..1).unwrap()[0]
    }

    fn losses(&self) -> Vec<f32> {
        self.gpu.read(&self.losses, 0..16).unwrap()
    }
}

/// Elements of `field` in the planar layout of `g`.
fn range(g: &Gaussians, field: Field) -> std::ops::Range<usize> {
    let start: usize = Field::ALL[..field as usize].iter().map(|f| g.field(*f).len()).sum();
    start..start + g.field(field).len()
}

/// Gradient rows converted to the planar layout.
fn planar_rows(g: &Gaussians, by: &Gradients) -> Vec<f32> {
    // A field that was not differentiated has no floats in a row of the CPU engine; here it has zeros.
    let padded = |f: Field, i: usize| {
        by.get(f, i).iter().copied().chain(std::iter::repeat(0.0)).take(g.width(f)).collect::<Vec<f32>>()
    };
    Field::ALL.iter().flat_map(|f| (0..g.len()).flat_map(move |i| padded(*f, i))).collect()
}

#[test]
fn host_structs_have_the_layout_of_the_shaders() {
    assert_layout!(UpdateUniform as "Update" in shaders::UPDATE; rates, groups, half_width, aggregation, residual,
        flatness, probe_labels, view_labels, pad);
    assert_layout!(AdamGlobals as "AdamGlobals" in shaders::ADAM_GLOBALS; n_prototypes, n, rate_prototypes,
        rate_environment, correction, pad_0, pad_1, pad_2);
    assert_layout!(LabelCount as "LabelCount" in shaders::LABEL_COUNT; n, pad_0, pad_1, pad_2);
    let g = random_model(&Shape::default(), &mut ChaCha8Rng::seed_from_u64(1)).gaussians;
    let layout = LayoutUniform::new(&g, &ShadingOptions::default());
    assert_eq!(layout.resized(g.len() as u32), layout);
    let generated = shaders::UPDATE.layout("Layout").unwrap();
    assert_eq!(generated.size, size_of::<LayoutUniform>());
    let first = std::mem::offset_of!(LayoutUniform, first);
    let fields = Field::ALL.map(|field| (field.kernel_name(), first + 4 * field as usize));
    assert_eq!(generated.members[4..4 + Field::COUNT], fields);
    assert_eq!(generated.members[4 + Field::COUNT].1, std::mem::offset_of!(LayoutUniform, normal_form));
    assert_eq!(layout.floats(), crate::gpu::model::planar(&g).len());
}
