//! The forward pass: from the parameters to the images of both branches.

use super::array::Array;
use super::compositing::{AlphaLimits, Weights};
use super::gbuffer::{Attributes, BlendedLight, GBuffer};
use super::lighting::Lighting;
use super::model::{Arrays, Parameters, ReferenceModel};
use super::projection::{GuardBand, Splats};
use super::quadrature::Quadrature;
use super::shading::{Shaded, Surfaces};
use super::tables::TableOperators;
use super::tape::{Tape, Var};
use super::{attributes, compositing, display, gbuffer, losses, projection, shading, spherical};
use relume_scene::{
    Camera, DiffuseForm, DisplayRange, Field, IndirectForm, MAX_LIGHTS, NormalForm, ShadeAt, ShadingOptions,
    VisibilityForm,
};

/// Convention where the article's listing and docs/MODEL.md differ in details.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Conventions {
    /// The listing: Jacobian taken anywhere, every pixel shaded, plain clamp, 7-tap SSIM.
    Listing,
    /// docs/MODEL.md.
    Model,
}

impl Conventions {
    fn guard_band(self) -> GuardBand {
        match self {
            Self::Listing => GuardBand::Unlimited,
            Self::Model => GuardBand::Image,
        }
    }

    /// 1 where a pixel with this coverage is shaded, else 0.
    pub(super) fn shaded(self, coverage: &Array) -> Array {
        let least = match self {
            Self::Listing => 0.0,
            Self::Model => MIN_SHADED_COVERAGE,
        };
        coverage.map(|c| f64::from(u8::from(c >= least)))
    }

    pub(super) fn ssim_window(self) -> Vec<f64> {
        let taps = match self {
            Self::Listing => 7,
            Self::Model => 11,
        };
        losses::gaussian_window(taps, 1.5)
    }
}

/// Source of light.
#[derive(Debug, Clone)]
pub enum Light {
    /// The listing's quadrature over the texels.
    Quadrature(Quadrature),
    /// The tables of docs/MODEL.md.
    Tables(TableOperators),
}

/// Light from other Gaussians at each Gaussian: measured, constant to the optimiser.
#[derive(Debug, Clone, PartialEq)]
pub struct Gathered {
    /// Irradiance `E`, (N, 3).
    pub irradiance: Array,
    /// Radiance of blocked directions `G`, (N, 3).
    pub radiance: Array,
}

/// Options of the forward model.
#[derive(Debug, Clone)]
pub struct Options {
    /// The options that a model stores.
    pub shading: ShadingOptions,
    /// Convention for details.
    pub conventions: Conventions,
    /// Screen-space low-pass, px^2. As in `shading`, but in f64: the f32 there differs from the listing's 0.3 within nine
    /// digits.
    pub low_pass: f64,
    /// Limits of alpha.
    pub alpha: AlphaLimits,
    /// Background colour, in the space in which images are compared.
    pub background: [f64; 3],
    /// Range of the display values of the images.
    pub range: DisplayRange,
    /// Source of light.
    pub light: Light,
    /// Radiance (M, 3) that replaces the scene's own environment.
    pub environment: Option<Array>,
    /// Gathered light for [`IndirectForm::Gathered`]; `None` is black.
    pub gathered: Option<Gathered>,
    /// Arriving share of each dominant light at each Gaussian, (N, K); `None` is 1.
    pub arriving: Option<Array>,
}

impl Options {
    /// Options of docs/MODEL.md over white, under the scene's own environment, without gathered light.
    pub fn model(shading: ShadingOptions, tables: TableOperators) -> Self {
        Self {
            shading,
            conventions: Conventions::Model,
            low_pass: shading.low_pass.into(),
            alpha: AlphaLimits::default(),
            background: [1.0; 3],
            range: DisplayRange::Unit,
            light: Light::Tables(tables),
            environment: None,
            gathered: None,
            arriving: None,
        }
    }

    /// Options of the article's listing, over white.
    pub fn listing(quadrature: Quadrature) -> Self {
        let shading = ShadingOptions {
            visibility: VisibilityForm::Sigmoid,
            diffuse: DiffuseForm::AmbientOcclusion,
            shade_at: ShadeAt::Pixel,
            normal: NormalForm::Free,
            indirect: IndirectForm::Learned,
            low_pass_compensation: false,
            srgb: false,
            ..ShadingOptions::default()
        };
        Self {
            shading,
            conventions: Conventions::Listing,
            low_pass: 0.3,
            alpha: AlphaLimits::default(),
            background: [1.0; 3],
            range: DisplayRange::Unit,
            light: Light::Quadrature(quadrature),
            environment: None,
            gathered: None,
            arriving: None,
        }
    }
}

/// All intermediate values of one rendered view of N Gaussians on P pixels.
pub struct Stages<'t> {
    /// The scene's parameters.
    pub parameters: Parameters<'t>,
    /// Attributes of each Gaussian.
    pub attributes: Attributes<'t>,
    /// The projected Gaussians.
    pub splats: Splats<'t>,
    /// Their blending weights.
    pub weights: Weights<'t>,
    /// The blended attributes.
    pub buffer: GBuffer<'t>,
    /// The shaded pixels.
    pub shaded: Shaded<'t>,
    /// The physically based image over the background, in display space, (P, 3).
    pub image: Var<'t>,
    /// The radiance branch over the background, in display space, (P, 3).
    pub radiance_image: Var<'t>,
}

/// Smallest coverage at which a pixel is shaded (docs/MODEL.md, section 4).
const MIN_SHADED_COVERAGE: f64 = 1e-3;

/// Renders a scene and keeps all intermediate values on the tape.
pub fn forward<'t>(tape: &'t Tape, scene: &ReferenceModel, camera: &Camera, options: &Options) -> Stages<'t> {
    let parameters = Parameters::new(tape, scene);
    let p = &parameters;
    let shading = &options.shading;
    let splats = projection::project(tape, p, camera, options.low_pass, options.conventions.guard_band());
    let mut opacities = p.get(Field::OpacityLogit).sigmoid().gather(0, &splats.indices);
    if shading.low_pass_compensation {
        opacities = opacities * splats.compensation;
    }
    let weights = compositing::composite(tape, &splats, opacities, camera, options.alpha);

    let light = light(tape, p, options);
    let attributes = attributes(tape, p, camera, &*light, options);
    let buffer = gbuffer::blend(p, &splats, &weights, &attributes);
    let shaded = shading::pixels(tape, &buffer, camera, &*light, shading);

    let background = tape.input(Array::from_rows(&[options.background])) * (1.0 - buffer.coverage);
    let radiance = shaded.diffuse + shaded.specular;
    let display = match options.conventions {
        Conventions::Listing => radiance.clamp(0.0, 1.0),
        Conventions::Model => display::display(radiance, shading.srgb, options.range.peak().into()),
    };
    let seen = tape.input(options.conventions.shaded(&buffer.coverage.value()));
    let image = display * seen * buffer.coverage + background;
    let radiance_image = buffer.radiance + background;
    Stages { parameters, attributes, splats, weights, buffer, shaded, image, radiance_image }
}

fn light<'t>(tape: &'t Tape, p: &Parameters<'t>, options: &Options) -> Box<dyn Lighting<'t> + 't> {
    let radiance = options.environment.as_ref().map_or_else(|| p.environment(), |e| tape.input(e.clone()));
    match &options.light {
        Light::Quadrature(quadrature) => Box::new(quadrature.under(radiance)),
        Light::Tables(tables) => {
            Box::new(tables.under(radiance, spherical::sh_degree_of(p.get(Field::Visibility))))
        }
    }
}

fn attributes<'t>(
    tape: &'t Tape,
    p: &Parameters<'t>,
    camera: &Camera,
    light: &dyn Lighting<'t>,
    options: &Options,
) -> Attributes<'t> {
    let normal = attributes::normals(tape, p, camera, options.shading.normal);
    let outward = attributes::from_camera(tape, p, camera);
    let black = || tape.input(Array::zeros(outward.value().shape()));
    let (gathered, blocked) = match (options.shading.indirect, &options.gathered) {
        (IndirectForm::Learned, _) => (black(), shading::learned_indirect(tape, p, light)),
        (IndirectForm::Gathered, Some(g)) => {
            (tape.input(g.irradiance.clone()), tape.input(g.radiance.clone()))
        }
        _ => (black(), black()),
    };
    let blended = match options.shading.shade_at {
        ShadeAt::Pixel => BlendedLight::Incident { gathered, blocked },
        ShadeAt::Gaussian => {
            let open = || Array::filled(&[outward.value().shape()[0], MAX_LIGHTS], 1.0);
            let arriving = tape.input(options.arriving.clone().unwrap_or_else(open));
            let surfaces = Surfaces {
                normal,
                albedo: p.albedo(),
                metal: p.get(Field::MetalLogit).sigmoid(),
                rough: p.get(Field::RoughLogit).sigmoid(),
                sheen: Some(p.get(Field::Sheen)),
                gathered,
                blocked,
                visibility: p.get(Field::Visibility),
                arriving: Some(arriving),
                view: outward.normalised() * -1.0,
            };
            let shaded = shading::shade(tape, &surfaces, light, &options.shading);
            BlendedLight::Outgoing { total: shaded.diffuse + shaded.specular, specular: shaded.specular }
        }
    };
    let plane = normal.dot(outward);
    let radiance = attributes::radiance(tape, p, camera);
    Attributes { normal, plane, radiance, light: blended }
}

/// A rendered view by channel name, each (P, C): `image radiance normal albedo metal rough ao coverage depth
/// diffuse specular`.
pub fn render(scene: &ReferenceModel, camera: &Camera, options: &Options) -> Arrays {
    let tape = Tape::new();
    let pass = forward(&tape, scene, camera, options);
    let channels = [
        ("image", pass.image),
        ("radiance", pass.radiance_image),
        ("normal", pass.shaded.normal),
        ("albedo", pass.buffer.albedo),
        ("metal", pass.buffer.metal),
        ("rough", pass.buffer.rough),
        ("ao", pass.shaded.ambient_occlusion),
        ("coverage", pass.buffer.coverage),
        ("depth", pass.buffer.depth),
        ("diffuse", pass.shaded.diffuse),
        ("specular", pass.shaded.specular),
    ];
    channels.into_iter().map(|(name, var)| (name, (*var.value()).clone())).collect()
}
