//! What the GPU engine answers.

use crate::engine::DeviceError;
use crate::engine::RasterCamera;
use crate::engine::channel::Channels;
use crate::engine::gpu::light::{Constants, LightWeights, TrainingLight};
use crate::engine::gpu::losses::LOSS_SLOTS;
use crate::engine::gpu::model::{ModelBuffers, from_planar};
use crate::engine::gpu::raster::groups;
use crate::engine::gpu::shading::{
    Images, ShadeGradients, ShadeJob, ShadingUniform, shade, shade_backward, show_lit, show_lit_backward,
};
use crate::engine::gpu::update::{ParameterTerms, STATUS_WORDS, StepInput, Sums, Updater, Upstream};
use crate::engine::gpu::{AttributeBuffers, Buffer, CameraUniform, Gpu, Raster};
use crate::engine::reference::Array;
use crate::engine::side_by_side::on_cpu::shared;
use crate::engine::side_by_side::{Answer, Question, SplatSeen};
use crate::scene::{Field, ShadeAt};

/// Buffers of one answer.
struct Canvas {
    images: Images,
    by_images: Images,
    by_buffers: Buffer<[f32; 4]>,
    by_gbuffer: Buffer<[f32; 4]>,
    /// Gradients of the Gaussians, planar.
    out: Buffer<f32>,
    /// Gradients of prototypes and environment.
    globals: Buffer<f32>,
    losses: Buffer<f32>,
    density: Buffer<[f32; 2]>,
    status: Buffer<u32>,
}

impl Canvas {
    fn new(
        gpu: &Gpu,
        question: &Question<'_>,
        model: &ModelBuffers,
        groups: usize,
    ) -> Result<Self, DeviceError> {
        let pixels = question.pixels();
        let padded =
            |rows: &[[f32; 3]]| -> Vec<[f32; 4]> { rows.iter().map(|[r, g, b]| [*r, *g, *b, 0.0]).collect() };
        let geometry = question.buffers.iter().map(|b| {
            let [x, y, z] = b.normal;
            [x, y, z, b.plane]
        });
        let material = question.buffers.iter().map(|b| [b.coverage, b.metal, b.rough, 0.0]);
        let by_buffers: Vec<[f32; 4]> = geometry.chain(material).collect();
        Ok(Self {
            images: Images::new(gpu, pixels)?,
            by_images: Images {
                physical: gpu.upload("by physical image", &padded(&question.physical))?,
                radiance: gpu.upload("by radiance image", &padded(&question.radiance))?,
            },
            by_buffers: gpu.upload("by buffers", &by_buffers)?,
            by_gbuffer: gpu.buffer("by G-buffer", groups * pixels)?,
            out: gpu.buffer("gradients", model.params.len())?,
            globals: gpu.buffer("gradients of what is shared", model.globals.len())?,
            losses: gpu.buffer("losses", LOSS_SLOTS)?,
            density: gpu.buffer("density", model.len())?,
            status: gpu.buffer("status", STATUS_WORDS)?,
        })
    }
}

/// The answer of the GPU engine, without early stop.
///
/// # Errors
/// What went wrong on the device.
pub fn by_gpu(gpu: &Gpu, question: &Question<'_>) -> Result<Answer, DeviceError> {
    let (model, options) = (question.model, &question.model.shading);
    let view = CameraUniform::new(&RasterCamera::new(question.camera, options));
    let buffers = ModelBuffers::upload(gpu, model)?;
    let light = TrainingLight::new(gpu, &question.light.operators)?;
    let n_visibility = model.gaussians.width(Field::Visibility);
    let channels = Channels::Full(n_visibility);
    let canvas = Canvas::new(gpu, question, &buffers, groups(channels))?;
    let gathered = match question.gathered {
        [] => None,
        rows => Some(gpu.upload("gathered light", rows.as_flattened())?),
    };
    let mut raster = Raster::new(gpu)?;
    raster.prepare(&view, &buffers.layout, &buffers.params)?;
    let mut recorder = gpu.record();
    recorder.clear(&canvas.losses);
    recorder.clear(&canvas.globals);
    recorder.clear(&canvas.status);
    recorder.clear(&canvas.density);
    light.apply(&mut recorder, &buffers, &LightWeights::default(), &canvas.losses);
    let source = AttributeBuffers {
        params: &buffers.params,
        globals: &buffers.globals,
        gathered: gathered.as_ref(),
        indirect_basis: Some(&light.light.indirect_basis),
    };
    let shading = ShadingUniform::new(options, question.background);
    let constants = Constants::upload(gpu)?;
    let job =
        ShadeJob { view: &view, shading: &shading, n_visibility, light: &light.light, constants: &constants };
    raster.attributes(&mut recorder, channels, &source)?;
    let is_lit = options.shade_at == ShadeAt::Gaussian;
    if is_lit {
        raster.light(&mut recorder, &job, channels, &source)?;
    }
    raster.blend(&mut recorder, channels, false)?;
    let gbuffer = raster.gbuffer.clone().ok_or_else(|| missing("G-buffer"))?;
    let gradients = ShadeGradients {
        gbuffer: &gbuffer,
        by_images: &canvas.by_images,
        by_buffers: &canvas.by_buffers,
        by_gbuffer: &canvas.by_gbuffer,
        by_tables: &light.tables_gradient,
        all_channels: true,
    };
    if is_lit {
        show_lit(&mut recorder, &job, &gbuffer, &canvas.images);
        show_lit_backward(&mut recorder, &job, &gradients);
    } else {
        shade(&mut recorder, &job, &gbuffer, &canvas.images)?;
        shade_backward(&mut recorder, &job, &gradients)?;
    }
    raster.blend_backward(&mut recorder, &canvas.by_gbuffer, groups(channels))?;
    if is_lit {
        raster.light_backward(&mut recorder, &job, channels, &source, &light.tables_gradient)?;
    }
    let upstream = Upstream {
        view: &view,
        splats: raster.splats.as_ref().ok_or_else(|| missing("splats"))?,
        gradients: raster.splat_gradients.as_ref().ok_or_else(|| missing("splat gradients"))?,
        groups: groups(channels),
        indirect_basis: None,
        probe_labels: None,
        view_labels: None,
    };
    let sums = Sums {
        globals_gradient: &canvas.globals,
        losses: &canvas.losses,
        density: &canvas.density,
        status: &canvas.status,
    };
    let input = StepInput { model: &buffers, upstream, sums, terms: ParameterTerms::default() };
    Updater::new(gpu)?.gradients(&mut recorder, &input, &canvas.out);
    light.backward(&mut recorder, &buffers, &LightWeights::default(), false, &canvas.globals);
    recorder.submit()?;
    read(gpu, question, &buffers, &canvas, &raster, &gbuffer)
}

fn missing(what: &str) -> DeviceError {
    DeviceError::Internal(format!("a pass without {what}"))
}

fn read(
    gpu: &Gpu,
    question: &Question<'_>,
    buffers: &ModelBuffers,
    canvas: &Canvas,
    raster: &Raster,
    gbuffer: &Buffer<[f32; 4]>,
) -> Result<Answer, DeviceError> {
    let (model, pixels) = (question.model, question.pixels());
    let rgb = |buffer: &Buffer<[f32; 4]>| -> Result<Vec<[f64; 3]>, DeviceError> {
        let rows = gpu.read(buffer, 0..pixels)?;
        Ok(rows.iter().map(|p| [p[0], p[1], p[2]].map(f64::from)).collect())
    };
    let globals = gpu.read(&canvas.globals, 0..buffers.globals.len())?;
    let (prototypes, by_raw) = globals.split_at(3 * buffers.n_prototypes);
    let mut gradients = shared(model, prototypes, &by_raw[..3 * buffers.n_texels]);
    let mut rows = model.gaussians.clone();
    from_planar(&gpu.read(&canvas.out, 0..buffers.layout.floats())?, &mut rows);
    for field in Field::ALL {
        let values = rows.field(field).iter().map(|v| f64::from(*v)).collect();
        gradients.insert(field.name(), Array::new(&[rows.len(), rows.width(field)], values));
    }
    let splats = raster.splats.as_ref().ok_or_else(|| missing("splats"))?;
    let splats = gpu.read(splats, 0..model.gaussians.len())?;
    let seen = splats.iter().enumerate().filter(|(_, s)| s.flags == 1).map(|(gaussian, s)| SplatSeen {
        gaussian,
        mean: s.mean.map(f64::from),
        conic: s.conic.map(f64::from),
    });
    Ok(Answer {
        physical: rgb(&canvas.images.physical)?,
        radiance: rgb(&canvas.images.radiance)?,
        coverage: gpu.read(gbuffer, 0..pixels)?.iter().map(|p| f64::from(p[0])).collect(),
        gradients,
        splats: seen.collect(),
    })
}
