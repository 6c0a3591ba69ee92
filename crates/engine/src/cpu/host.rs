//! A model on the host, and lights prepared for it: what the CPU engine renders, and what the host computes of a model whose
//! frames another device renders.

use std::sync::{Arc, OnceLock};

use crate::cpu::{
    AttributeSource, OccluderBvh, Pass, Probes, SkyShadows, Surface, SurfaceShader, Transport, arriving,
    outward_normals, resolve, surface_at, surface_point,
};
use crate::{
    BOUNCES, Frame, NO_INDIRECT_BASIS, PROBE_DIRECTIONS, ProbeSettings, RasterCamera, fibonacci_sphere,
    indirect_basis,
};
use relume_layout::channel::{Channels, IncidentLight, OutgoingRadiance};
use relume_layout::constants::EarlyStop;
use relume_scene::light::{LightTables, rendering_tables, split_tables, tables_of_split};
use relume_scene::{
    DisplayRange, Field, Illumination, IndirectForm, MAX_LIGHTS, Model, Output, ShadeAt, ShadingOptions,
    SplitLight,
};

/// A model on the host. Data that does not depend on the light is computed on first use.
pub struct HostModel {
    model: Arc<Model>,
    occlusion: OnceLock<Occlusion>,
    occluders: OnceLock<OccluderBvh>,
}

/// What a model's surfaces hide from each other.
pub(super) struct Occlusion {
    pub(super) transport: Transport,
    /// `None` where the model has no shadows of the sky in single directions.
    pub(super) sky: Option<SkyShadows>,
}

/// A light prepared for a model on the host.
pub struct HostLight {
    pub(super) model: Arc<HostModel>,
    /// Tables of the light.
    pub tables: LightTables,
    /// Irradiance and mean blocked radiance from the model's other surfaces, per Gaussian.
    gathered: Vec<[f32; 6]>,
    /// The same with the shadows of the sky under `tables`; `None` where the model has none.
    with_sky_shadows: Option<Vec<[f32; 6]>>,
    /// The same with the shadows of the sky without its sharp lights, computed on first use.
    of_the_rest: OnceLock<Vec<[f32; 6]>>,
    /// Share of each dominant light that arrives, per Gaussian.
    arriving: Vec<[f32; MAX_LIGHTS]>,
    indirect_basis: [[f32; 3]; 16],
}

impl HostModel {
    /// Wraps a checked model.
    pub fn new(model: Arc<Model>) -> Self {
        Self { model, occlusion: OnceLock::new(), occluders: OnceLock::new() }
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Tables of a light and, for models shaded at their Gaussians, its dominant lights.
    pub fn light_tables(&self, light: &Illumination) -> LightTables {
        let (environment, sh_degree) = (&light.environment, self.model.gaussians.visibility_degree());
        match (self.model.shading.shade_at, &light.split) {
            (ShadeAt::Pixel, _) => rendering_tables(environment, sh_degree),
            (ShadeAt::Gaussian, Some(split)) => tables_of_split(environment, split, sh_degree),
            (ShadeAt::Gaussian, None) => split_tables(environment, sh_degree),
        }
    }

    /// The light of `tables`, with the light that the model's surfaces send each other under it.
    pub fn prepare_light(self: &Arc<Self>, tables: LightTables) -> HostLight {
        let lights: Vec<SplitLight> = tables.lights.iter().map(SplitLight::from).collect();
        let arriving = arriving(&self.source(&[], &[], &NO_INDIRECT_BASIS), &lights);
        let source = self.source(&[], &arriving, &NO_INDIRECT_BASIS);
        let (mut gathered, mut with_sky_shadows) = (Vec::new(), None);
        if source.options.indirect == IndirectForm::Gathered {
            let occlusion = self.occlusion(&source);
            gathered = occlusion.transport.gather(&source, &tables, BOUNCES);
            with_sky_shadows =
                occlusion.sky.as_ref().map(|sky| sky.added_to(gathered.clone(), &source, &tables));
        }
        let indirect_basis = indirect_basis(&tables);
        let (model, of_the_rest) = (self.clone(), OnceLock::new());
        HostLight { model, tables, gathered, with_sky_shadows, of_the_rest, arriving, indirect_basis }
    }

    /// What the model's surfaces hide from each other, measured on first use.
    pub(super) fn occlusion(&self, source: &AttributeSource<'_>) -> &Occlusion {
        self.occlusion.get_or_init(|| {
            let directions = fibonacci_sphere(PROBE_DIRECTIONS);
            let probes = Probes::measure(source, directions, ProbeSettings::of(source.options));
            let outward = outward_normals(source);
            let sky = source.options.has_sky_shadows();
            let sky = sky.then(|| SkyShadows::new(source, &probes, &outward));
            Occlusion { transport: Transport::new(&probes, outward), sky }
        })
    }

    /// The occluder tree of the model.
    pub fn occluders(&self) -> &OccluderBvh {
        self.occluders.get_or_init(|| {
            let source = self.source(&[], &[], &NO_INDIRECT_BASIS);
            OccluderBvh::new(&source, ProbeSettings::of(source.options))
        })
    }

    /// The surfaces that `view` shows, one for each covered pixel, in row-major order.
    pub fn surfaces(&self, view: RasterCamera) -> Vec<VisibleSurface> {
        let channels = Channels::Full(self.model.gaussians.width(Field::Visibility));
        let source = self.source(&[], &[], &NO_INDIRECT_BASIS);
        let pass = Pass::forward(&source, view, channels, EarlyStop::WhenSaturated);
        let pixels = (0..view.height).flat_map(|y| (0..view.width).map(move |x| (x, y)));
        let visible = |(x, y): (usize, usize)| {
            let (surface, coverage) = surface_at(&pass, x, y)?;
            Some(VisibleSurface { position: surface_point(&pass, x, y), surface, coverage })
        };
        pixels.filter_map(visible).collect()
    }

    pub(super) fn source<'a>(
        &'a self,
        gathered: &'a [[f32; 6]],
        arriving: &'a [[f32; MAX_LIGHTS]],
        basis: &'a [[f32; 3]; 16],
    ) -> AttributeSource<'a> {
        AttributeSource {
            gathered,
            arriving,
            indirect_basis: basis,
            ..AttributeSource::new(&self.model.gaussians, &self.model.prototypes, &self.model.shading)
        }
    }
}

/// The surface that a pixel shows.
#[derive(Debug, Clone)]
pub struct VisibleSurface {
    /// Its point in the normalised world.
    pub position: [f32; 3],
    /// Its material, normal and visibility.
    pub surface: Surface,
    /// Share of the pixel that it covers, above 0 to 1.
    pub coverage: f32,
}

/// Changes the surface of a row-major pixel before it is shaded.
pub type SurfaceEdit<'a> = dyn Fn(&SurfaceShader<'_>, usize, &mut Surface) + Sync + 'a;

impl HostLight {
    /// Radiance of Gaussian `i` along the unit direction `along`.
    pub fn outgoing(&self, i: usize, along: [f32; 3]) -> OutgoingRadiance {
        self.source().outgoing(i, along, &self.shader(&self.tables))
    }

    /// Light that arrives at Gaussian `i` from the model's other surfaces.
    pub fn incident(&self, i: usize) -> IncidentLight {
        self.source().incident(i)
    }

    /// Share of each dominant light that arrives at Gaussian `i`.
    pub fn arriving_at(&self, i: usize) -> [f32; MAX_LIGHTS] {
        self.source().arriving_at(i)
    }

    /// Renders colour and alpha of `view`. `edit` changes the surface of each pixel before it is shaded under `tables`, which
    /// must be tables of the same environment without dominant lights.
    pub fn render_edited(&self, view: RasterCamera, tables: &LightTables, edit: &SurfaceEdit<'_>) -> Frame {
        // Shaded per pixel for every model, because the edited surface is that of the pixel.
        let options = ShadingOptions { shade_at: ShadeAt::Pixel, ..self.model.model.shading };
        let shader = SurfaceShader { options: &options, ..self.shader(tables) };
        let source = self.source();
        let channels = Channels::Full(source.gaussians.width(Field::Visibility));
        let pass = Pass::forward(&source, view, channels, EarlyStop::WhenSaturated);
        resolve(&pass, &shader, &[Output::Rgb, Output::Alpha], 1.0, |(x, y), surface| {
            let mut surface = *surface;
            edit(&shader, y * view.width + x, &mut surface);
            shader.shade(&surface).outgoing()
        })
    }

    /// The model under this light, not yet shaded.
    pub(super) fn source(&self) -> AttributeSource<'_> {
        self.with(self.with_sky_shadows.as_ref().unwrap_or(&self.gathered))
    }

    /// The model under this light without its sharp lights, whose tables are `rest`; the same at every call.
    pub(super) fn source_without_sharp_lights(&self, rest: &LightTables) -> AttributeSource<'_> {
        let source = self.source_without_sky_shadows();
        let occlusion = self.model.occlusion.get();
        let Some(sky) = occlusion.and_then(|occlusion| occlusion.sky.as_ref()) else { return source };
        let shaded = || sky.added_to(self.gathered.clone(), &source, rest);
        self.with(self.of_the_rest.get_or_init(shaded))
    }

    /// The model under this light where rays find the shadows of the sky.
    pub(super) fn source_without_sky_shadows(&self) -> AttributeSource<'_> {
        self.with(&self.gathered)
    }

    fn with<'a>(&'a self, gathered: &'a [[f32; 6]]) -> AttributeSource<'a> {
        self.model.source(gathered, &self.arriving, &self.indirect_basis)
    }

    /// The shader of the model under `tables`.
    pub(super) fn shader<'a>(&'a self, tables: &'a LightTables) -> SurfaceShader<'a> {
        let model = self.model.model();
        SurfaceShader {
            tables,
            options: &model.shading,
            sh_degree: model.gaussians.visibility_degree(),
            range: DisplayRange::Unit,
        }
    }
}
