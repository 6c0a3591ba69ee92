//! A model in device memory.

use bytemuck::{Pod, Zeroable};

use crate::DeviceError;
use crate::gpu::{Buffer, Gpu};
use relume_layout::kernel_constants as codes;
use relume_scene::{
    DiffuseForm, Field, FieldWidth, Gaussians, IndirectForm, Model, NormalForm, ShadeAt, ShadingOptions,
    VisibilityForm,
};

/// `Layout` of the generated piece `parameters` (`build/generated.rs`): the start of each field in the planar parameter
/// buffer.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct LayoutUniform {
    /// Number of Gaussians.
    pub n: u32,
    /// Prototype scores per Gaussian.
    pub n_scores: u32,
    /// Visibility coefficients per Gaussian.
    pub n_visibility: u32,
    /// Radiance coefficients per Gaussian, RGB each.
    pub n_radiance: u32,
    /// First float of each field, in storage order.
    pub first: [u32; Field::COUNT],
    /// Code of the [`NormalForm`].
    pub normal_form: u32,
    /// Code of the [`IndirectForm`].
    pub indirect_form: u32,
    /// Code of the [`VisibilityForm`].
    pub visibility_form: u32,
    /// Code of the [`DiffuseForm`].
    pub diffuse_form: u32,
    /// Code of [`ShadeAt`].
    pub shade_at: u32,
    /// Unused.
    pub pad: [u32; PAD],
}

/// Number of members that pad the layout to whole vectors.
const PAD: usize = (Field::COUNT + 9).next_multiple_of(4) - (Field::COUNT + 9);

/// The shaders' code of a visibility form.
pub(super) fn visibility_code(form: VisibilityForm) -> u32 {
    match form {
        VisibilityForm::Off => codes::VISIBILITY_OFF,
        VisibilityForm::Linear => codes::VISIBILITY_LINEAR,
        VisibilityForm::Sigmoid => codes::VISIBILITY_SIGMOID,
    }
}

/// The shaders' code of a diffuse form.
pub(super) fn diffuse_code(form: DiffuseForm) -> u32 {
    match form {
        DiffuseForm::AmbientOcclusion => codes::DIFFUSE_AMBIENT_OCCLUSION,
        DiffuseForm::Directional => codes::DIFFUSE_DIRECTIONAL,
    }
}

/// The shaders' code of the place of shading.
pub(super) fn shade_at_code(shade_at: ShadeAt) -> u32 {
    match shade_at {
        ShadeAt::Pixel => codes::SHADE_AT_PIXEL,
        ShadeAt::Gaussian => codes::SHADE_AT_GAUSSIAN,
    }
}

impl LayoutUniform {
    /// The layout of `g` under the forward model `options`.
    pub fn new(g: &Gaussians, options: &ShadingOptions) -> Self {
        let shape = Self {
            n: 0,
            n_scores: g.prototypes() as u32,
            n_visibility: g.width(Field::Visibility) as u32,
            n_radiance: g.width(Field::Radiance) as u32 / 3,
            first: [0; Field::COUNT],
            normal_form: match options.normal {
                NormalForm::Free => codes::NORMAL_FREE,
                NormalForm::ShortestAxis => codes::NORMAL_SHORTEST_AXIS,
            },
            indirect_form: match options.indirect {
                IndirectForm::Off => codes::INDIRECT_OFF,
                IndirectForm::Learned => codes::INDIRECT_LEARNED,
                IndirectForm::Gathered => codes::INDIRECT_GATHERED,
            },
            visibility_form: visibility_code(options.visibility),
            diffuse_form: diffuse_code(options.diffuse),
            shade_at: shade_at_code(options.shade_at),
            pad: [0; PAD],
        };
        shape.resized(g.len() as u32)
    }

    /// First float of `field`.
    pub fn start(&self, field: Field) -> usize {
        self.first[field as usize] as usize
    }

    /// Floats per Gaussian in `field`.
    fn width(&self, field: Field) -> u32 {
        match field.width() {
            FieldWidth::Fixed(floats) => floats as u32,
            FieldWidth::Prototypes => self.n_scores,
            FieldWidth::Visibility => self.n_visibility,
            FieldWidth::Radiance => 3 * self.n_radiance,
        }
    }

    /// The same fields for `n` Gaussians.
    #[must_use]
    pub fn resized(&self, n: u32) -> Self {
        let mut next = 0;
        let first = Field::ALL.map(|field| {
            let start = next;
            next += n * self.width(field);
            start
        });
        Self { n, first, ..*self }
    }

    /// True when shading reads `E_j` of Eq. 20: `IndirectForm::Learned`.
    pub(super) fn reads_indirect_basis(&self) -> bool {
        self.indirect_form == codes::INDIRECT_LEARNED
    }

    /// Number of floats of all Gaussians.
    pub fn floats(&self) -> usize {
        Field::ALL.iter().map(|field| self.width(*field) as usize).sum::<usize>() * self.n as usize
    }
}

/// A model with its optimiser's moments in device memory.
#[derive(Debug, Clone)]
pub struct ModelBuffers {
    /// Position of each field of the Gaussians.
    pub layout: LayoutUniform,
    /// Raw parameters of the Gaussians, planar.
    pub params: Buffer<f32>,
    /// Their first moments, planar.
    pub first: Buffer<f32>,
    /// Their second moments, planar.
    pub second: Buffer<f32>,
    /// Albedo prototypes, then the raw environment, RGB each.
    pub globals: Buffer<f32>,
    /// First moments of `globals`.
    pub globals_first: Buffer<f32>,
    /// Second moments of `globals`.
    pub globals_second: Buffer<f32>,
    /// Number K of albedo prototypes.
    pub n_prototypes: usize,
    /// Number of texels of the environment.
    pub n_texels: usize,
}

impl ModelBuffers {
    /// `model` with zero moments.
    ///
    /// # Errors
    /// [`DeviceError::TooLarge`] or [`DeviceError::OutOfMemory`] when it does not fit.
    pub fn upload(gpu: &Gpu, model: &Model) -> Result<Self, DeviceError> {
        let shared: Vec<[f32; 3]> = model.prototypes.iter().chain(&model.env_raw).copied().collect();
        let params = gpu.upload_gaussians(&model.gaussians)?;
        let globals = gpu.upload("prototypes and environment", bytemuck::cast_slice::<_, f32>(&shared))?;
        let out = Self {
            layout: LayoutUniform::new(&model.gaussians, &model.shading),
            first: gpu.buffer("first moments", params.len())?,
            second: gpu.buffer("second moments", params.len())?,
            params,
            globals_first: gpu.buffer("first moments of the shared parameters", globals.len())?,
            globals_second: gpu.buffer("second moments of the shared parameters", globals.len())?,
            globals,
            n_prototypes: model.prototypes.len(),
            n_texels: model.env_raw.len(),
        };
        let mut recorder = gpu.record();
        for moments in [&out.first, &out.second, &out.globals_first, &out.globals_second] {
            recorder.clear(moments);
        }
        recorder.submit()?;
        Ok(out)
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.layout.n as usize
    }

    /// True without Gaussians.
    pub fn is_empty(&self) -> bool {
        self.layout.n == 0
    }

    /// The current Gaussians, with the widths of `shape`; `buffer` is the parameters or a moment.
    ///
    /// # Errors
    /// Errors of the device.
    pub fn read_gaussians(
        &self,
        gpu: &Gpu,
        buffer: &Buffer<f32>,
        shape: &Gaussians,
    ) -> Result<Gaussians, DeviceError> {
        let (l, sh_degree) = (shape.visibility_degree(), shape.radiance_degree());
        let mut out = Gaussians::zeroed(self.len(), shape.prototypes(), l, sh_degree);
        from_planar(&gpu.read(buffer, 0..self.layout.floats())?, &mut out);
        Ok(out)
    }

    /// The current prototypes and environment, or their moments.
    ///
    /// # Errors
    /// Errors of the device.
    pub fn read_globals(&self, gpu: &Gpu, buffer: &Buffer<f32>) -> Result<[Vec<[f32; 3]>; 2], DeviceError> {
        let values = gpu.read(buffer, 0..3 * (self.n_prototypes + self.n_texels))?;
        let (prototypes, texels) = values.split_at(3 * self.n_prototypes);
        Ok([prototypes, texels].map(|part| bytemuck::cast_slice(part).to_vec()))
    }
}

/// All parameters of `g`, planar by field in storage order.
pub fn planar(g: &Gaussians) -> Vec<f32> {
    Field::ALL.iter().flat_map(|f| g.field(*f).iter().copied()).collect()
}

/// Writes a planar array back into `g`, which must have its shape. Elements beyond the array's end are unchanged.
pub fn from_planar(values: &[f32], g: &mut Gaussians) {
    let mut rest = values;
    for (_, _, data) in g.fields_mut() {
        let (head, tail) = rest.split_at(data.len().min(rest.len()));
        data[..head.len()].copy_from_slice(head);
        rest = tail;
    }
}

impl Gpu {
    /// The parameters of `g` in device memory.
    ///
    /// # Errors
    /// [`DeviceError::TooLarge`] with the numbers when the model does not fit.
    pub fn upload_gaussians(&self, g: &Gaussians) -> Result<Buffer<f32>, DeviceError> {
        self.upload("the Gaussians", &planar(g))
    }
}
