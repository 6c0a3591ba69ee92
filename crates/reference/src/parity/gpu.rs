//! The GPU engine's result.

use crate::Array;
use crate::parity::case::{ParityCase, ParityResult, VisibleSplat};
use crate::parity::cpu::shared;
use relume_engine::gpu::frame::{FrameBranches, FrameGradients, FramePass};
use relume_engine::gpu::light::{Constants, TrainingLight};
use relume_engine::gpu::model::{ModelBuffers, from_planar};
use relume_engine::gpu::objective::LOSS_SLOTS;
use relume_engine::gpu::raster::SplatRecord;
use relume_engine::gpu::shading::{Images, Shading};
use relume_engine::gpu::update::{STATUS_WORDS, StepInput, UpdateSums, Updater, UpstreamGradients};
use relume_engine::gpu::{AttributeSource, Buffer, CameraUniform, Gpu, Raster};
use relume_engine::{DeviceError, LightWeights, ParameterWeights, RasterCamera, TurnedLight};
use relume_layout::channel::Channels;
use relume_layout::constants::EarlyStop;
use relume_scene::{Field, IndirectForm};

/// Buffers of one result.
struct ParityBuffers {
    images: Images,
    by_images: Images,
    by_buffers: Buffer<[f32; 4]>,
    /// Gradients of the Gaussians, planar.
    out: Buffer<f32>,
    /// Gradients of prototypes and environment.
    globals: Buffer<f32>,
    losses: Buffer<f32>,
    density: Buffer<[f32; 2]>,
    status: Buffer<u32>,
}

impl ParityBuffers {
    fn new(gpu: &Gpu, case: &ParityCase<'_>, model: &ModelBuffers) -> Result<Self, DeviceError> {
        let padded =
            |rows: &[[f32; 3]]| -> Vec<[f32; 4]> { rows.iter().map(|[r, g, b]| [*r, *g, *b, 0.0]).collect() };
        let geometry = case.buffers.iter().map(|b| {
            let [x, y, z] = b.normal;
            [x, y, z, b.plane]
        });
        let material = case.buffers.iter().map(|b| [b.coverage, b.metal, b.rough, 0.0]);
        let by_buffers: Vec<[f32; 4]> = geometry.chain(material).collect();
        Ok(Self {
            images: Images::new(gpu, case.pixels())?,
            by_images: Images {
                physical: gpu.upload("by physical image", &padded(&case.physical))?,
                radiance: gpu.upload("by radiance image", &padded(&case.radiance))?,
            },
            by_buffers: gpu.upload("by buffers", &by_buffers)?,
            out: gpu.buffer("gradients", model.params.len())?,
            globals: gpu.buffer("gradients of the shared parameters", model.globals.len())?,
            losses: gpu.buffer("losses", LOSS_SLOTS)?,
            density: gpu.buffer("density", model.len())?,
            status: gpu.buffer("status", STATUS_WORDS)?,
        })
    }
}

/// The result of the GPU engine, without early stop.
///
/// # Errors
/// Errors of the device.
pub fn gpu_result(gpu: &Gpu, case: &ParityCase<'_>) -> Result<ParityResult, DeviceError> {
    let options = case.model.shading;
    let camera = CameraUniform::new(&RasterCamera::new(case.camera, &options));
    let model = ModelBuffers::upload(gpu, case.model)?;
    let light = TrainingLight::new(gpu, &case.light.operators)?;
    let channels = Channels::Full(case.model.gaussians.width(Field::Visibility));
    let parity_buffers = ParityBuffers::new(gpu, case, &model)?;
    let mut measured = case.gathered.as_flattened().to_vec();
    if !case.arriving.is_empty() {
        measured.resize(6 * case.arriving.len(), 0.0);
        measured.extend(case.arriving.as_flattened());
    }
    let gathered = match measured.as_slice() {
        [] => None,
        rows => Some(gpu.upload("gathered light", rows)?),
    };
    let source = AttributeSource {
        gathered,
        indirect_basis: Some(light.light.indirect_basis.clone()),
        ..AttributeSource::new(&model)
    };
    let shading = Shading {
        options,
        background: case.background,
        range: case.range,
        light: light.light.clone(),
        constants: Constants::upload(gpu)?,
    };
    let pass =
        FramePass { channels, blending: EarlyStop::Never, branches: FrameBranches::Both(Box::new(shading)) };
    let mut raster = Raster::new(gpu)?;
    let projected = raster.prepare(&camera, &source)?;
    let list_status = projected.list_status().clone();
    let mut recorder = gpu.record();
    recorder.clear(&parity_buffers.losses);
    recorder.clear(&parity_buffers.globals);
    recorder.clear(&parity_buffers.status);
    recorder.clear(&parity_buffers.density);
    light.apply(
        &mut recorder,
        &model,
        TurnedLight::default(),
        &LightWeights::default(),
        &parity_buffers.losses,
    );
    let frame = pass.forward(&mut recorder, projected)?;
    pass.images(&mut recorder, &frame, &parity_buffers.images)?;
    let gbuffer = frame.gbuffer().clone();
    let gradients = FrameGradients {
        by_images: &parity_buffers.by_images,
        by_buffers: &parity_buffers.by_buffers,
        by_tables: &light.tables_gradient,
        differentiated: channels,
    };
    let frame = pass.backward(&mut recorder, frame, &gradients)?;
    let upstream = UpstreamGradients::new(&frame);
    let sums = UpdateSums {
        globals_gradient: &parity_buffers.globals,
        losses: &parity_buffers.losses,
        density: &parity_buffers.density,
        list_status: &list_status,
        status: &parity_buffers.status,
    };
    let input = StepInput { model: &model, upstream, sums, weights: ParameterWeights::default() };
    Updater::new(gpu)?.gradients(&mut recorder, &input, &parity_buffers.out);
    let (weights, indirect) = (LightWeights::default(), IndirectForm::Off);
    light.backward(
        &mut recorder,
        &model,
        TurnedLight::default(),
        &weights,
        indirect,
        &parity_buffers.globals,
    );
    recorder.submit()?;
    read(gpu, case, &model, &parity_buffers, upstream.splats, &gbuffer)
}

fn read(
    gpu: &Gpu,
    case: &ParityCase<'_>,
    buffers: &ModelBuffers,
    parity_buffers: &ParityBuffers,
    splats: &Buffer<SplatRecord>,
    gbuffer: &Buffer<[f32; 4]>,
) -> Result<ParityResult, DeviceError> {
    let (model, pixels) = (case.model, case.pixels());
    let rgb = |buffer: &Buffer<[f32; 4]>| -> Result<Vec<[f64; 3]>, DeviceError> {
        let rows = gpu.read(buffer, 0..pixels)?;
        Ok(rows.iter().map(|p| [p[0], p[1], p[2]].map(f64::from)).collect())
    };
    let globals = gpu.read(&parity_buffers.globals, 0..buffers.globals.len())?;
    let (prototypes, by_raw) = globals.split_at(3 * buffers.n_prototypes);
    let mut gradients = shared(model, prototypes, &by_raw[..3 * buffers.n_texels]);
    let mut rows = model.gaussians.clone();
    from_planar(&gpu.read(&parity_buffers.out, 0..buffers.layout.floats())?, &mut rows);
    for field in Field::ALL {
        let values = rows.field(field).iter().map(|v| f64::from(*v)).collect();
        gradients.insert(field.name(), Array::new(&[rows.len(), rows.width(field)], values));
    }
    let splats = gpu.read(splats, 0..model.gaussians.len())?;
    let seen = splats.iter().enumerate().filter(|(_, s)| s.flags == 1).map(|(gaussian, s)| VisibleSplat {
        gaussian,
        mean: s.mean.map(f64::from),
        conic: s.conic.map(f64::from),
    });
    Ok(ParityResult {
        physical: rgb(&parity_buffers.images.physical)?,
        radiance: rgb(&parity_buffers.images.radiance)?,
        coverage: gpu.read(gbuffer, 0..pixels)?.iter().map(|p| f64::from(p[0])).collect(),
        gradients,
        splats: seen.collect(),
    })
}
