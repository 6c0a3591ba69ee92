//! Split-sum shading of pixels, from the G-buffer, or of each Gaussian before blending (Eq. 16-22, docs/MODEL.md,
//! section 4).

use std::f64::consts::PI;

use super::array::Array;
use super::direct::direct;
use super::gbuffer::{BlendedLight, GBuffer};
use super::lighting::Lighting;
use super::model::Parameters;
use super::projection::view_vectors;
use super::spherical::{degrees, fibonacci_sphere, normal_related_sh, real_sh, sh_degree_of};
use super::tape::{Tape, Var};
use relume_scene::light::{LobeAttenuation, MAX_SHEEN};
use relume_scene::{Camera, DiffuseForm, Field, ShadingOptions, VisibilityForm};

/// Result of shading P pixels or Gaussians.
pub struct Shaded<'t> {
    /// Unit normals turned to the camera, (P, 3).
    pub normal: Var<'t>,
    /// Ambient occlusion, 1 = open, (P, 1).
    pub ambient_occlusion: Var<'t>,
    /// Diffuse radiance, (P, 3).
    pub diffuse: Var<'t>,
    /// Specular radiance, (P, 3).
    pub specular: Var<'t>,
}

/// Indirect light of each Gaussian, (N, 3): 16 learned SH weights on the low-frequency environment at 32
/// fixed directions (Eq. 19-20). It is linear in the weights, so it is contracted before blending.
pub fn learned_indirect<'t>(tape: &'t Tape, p: &Parameters<'t>, light: &dyn Lighting<'t>) -> Var<'t> {
    const DIRECTIONS: usize = 32;
    let directions = tape.input(fibonacci_sphere(DIRECTIONS));
    let matte = tape.input(Array::filled(&[DIRECTIONS, 1], 1.0));
    let low = light.prefiltered(directions, matte);
    let basis = real_sh(directions, 3).transposed().matmul(low) * (1.0 / DIRECTIONS as f64);
    p.get(Field::Indirect).matmul(basis)
}

/// Input of shading: P pixels or Gaussians.
pub struct Surfaces<'t> {
    /// Normal of any length, (P, 3).
    pub normal: Var<'t>,
    /// Albedo, (P, 3).
    pub albedo: Var<'t>,
    /// Metalness, (P, 1).
    pub metal: Var<'t>,
    /// Roughness, (P, 1).
    pub rough: Var<'t>,
    /// Sheen, (P, 1); `None` in the pixel.
    pub sheen: Option<Var<'t>>,
    /// Irradiance gathered from other surfaces, (P, 3).
    pub gathered: Var<'t>,
    /// Radiance from directions in which the environment is blocked, (P, 3).
    pub blocked: Var<'t>,
    /// Visibility SH coefficients, (P, (L + 1)^2).
    pub visibility: Var<'t>,
    /// Arriving share of each dominant light, (P, K); `None`: dominant lights are not shaded.
    pub arriving: Option<Var<'t>>,
    /// Unit direction to the camera, (P, 3).
    pub view: Var<'t>,
}

impl<'t> Surfaces<'t> {
    /// The surfaces in the pixels of a G-buffer seen by `camera`. They have no incident light where outgoing light was blended.
    pub fn behind(tape: &'t Tape, buffer: &GBuffer<'t>, camera: &Camera) -> Self {
        let (gathered, blocked) = match buffer.light {
            BlendedLight::Incident { gathered, blocked } => (gathered, blocked),
            BlendedLight::Outgoing { total, .. } => {
                let black = tape.input(Array::zeros(total.value().shape()));
                (black, black)
            }
        };
        Self {
            normal: buffer.normal,
            albedo: buffer.albedo,
            metal: buffer.metal,
            rough: buffer.rough,
            sheen: None,
            gathered,
            blocked,
            visibility: buffer.visibility,
            arriving: None,
            view: tape.input(view_vectors(camera)),
        }
    }
}

/// Radiance of the pixels of the G-buffer seen by `camera`.
pub fn pixels<'t>(
    tape: &'t Tape,
    buffer: &GBuffer<'t>,
    camera: &Camera,
    light: &dyn Lighting<'t>,
    options: &ShadingOptions,
) -> Shaded<'t> {
    let shaded = shade(tape, &Surfaces::behind(tape, buffer, camera), light, options);
    match buffer.light {
        BlendedLight::Incident { .. } => shaded,
        BlendedLight::Outgoing { total, specular } => {
            Shaded { diffuse: total - specular, specular, ..shaded }
        }
    }
}

/// Shades surfaces, pixels or Gaussians.
pub fn shade<'t>(
    tape: &'t Tape,
    s: &Surfaces<'t>,
    light: &dyn Lighting<'t>,
    options: &ShadingOptions,
) -> Shaded<'t> {
    let normal = facing(tape, s.normal, s.view);
    let n_dot_v = normal.dot(s.view).clamp(1e-4, 1.0);
    let reflection = (2.0 * n_dot_v * normal - s.view).normalised();

    let visibility = visibility(s.visibility, options.visibility);
    let ambient_occlusion = ambient_occlusion(normal, visibility, options.visibility);
    let irradiance = match options.diffuse {
        DiffuseForm::AmbientOcclusion => ambient_occlusion * light.irradiance(normal),
        DiffuseForm::Directional => light.transfer(normal, visibility).at_least(0.0),
    };
    let f0 = 0.04 * (1.0 - s.metal) + s.albedo * s.metal;
    let lights = s.arriving.map_or_else(Vec::new, |arriving| {
        let lights = light.lights().into_iter().enumerate();
        let seen = (normal, s.view, n_dot_v);
        lights.map(|(k, light)| direct(tape, &light, arriving.column(k), seen, (s.rough, f0))).collect()
    });
    let irradiance = lights.iter().fold(irradiance + s.gathered, |sum, light| sum + light.irradiance);
    let split = light.brdf(n_dot_v, s.rough);
    let lambert = s.albedo * (1.0 - s.metal) * (1.0 / PI) * irradiance;
    let sheen = s.sheen.map_or(lambert, |sheen| lambert * sheen_gain(sheen, n_dot_v));
    let diffuse = if options.conserves_energy {
        sheen * (1.0 - (0.04 * split.column(0) + split.column(1)))
    } else {
        sheen
    };

    let mirrored = lobe_visibility(visibility, reflection, s.rough, options.visibility);
    let prefiltered = light.prefiltered(reflection, s.rough);
    let incoming = mirrored * prefiltered + (1.0 - mirrored) * s.blocked;
    let tabulated = incoming * (f0 * split.column(0) + split.column(1));
    let specular = lights.iter().fold(tabulated, |sum, light| sum + light.specular);
    Shaded { normal, ambient_occlusion, diffuse, specular }
}

/// `exp(s (1 - n . v)^3)`, docs/MODEL.md, section 4.
fn sheen_gain<'t>(sheen: Var<'t>, n_dot_v: Var<'t>) -> Var<'t> {
    let most = f64::from(MAX_SHEEN);
    (sheen.clamp(-most, most) * (1.0 - n_dot_v).powi(3)).exp()
}

/// `normals`, of any length, normalised and turned towards `view`.
fn facing<'t>(tape: &'t Tape, normals: Var<'t>, view: Var<'t>) -> Var<'t> {
    let normals = normals.normalised();
    let sign = normals.dot(view).value().map(|c| if c < 0.0 { -1.0 } else { 1.0 });
    normals * tape.input(sign)
}

fn ambient_occlusion<'t>(normal: Var<'t>, visibility: Var<'t>, form: VisibilityForm) -> Var<'t> {
    squashed(visibility.dot(normal_related_sh(normal, sh_degree_of(visibility))), form)
}

/// The visibility field that shading uses.
fn visibility(coefficients: Var<'_>, form: VisibilityForm) -> Var<'_> {
    if form == VisibilityForm::Off { open(coefficients) } else { coefficients }
}

/// Coefficients of V = 1 in the shape of `coefficients`.
fn open(coefficients: Var<'_>) -> Var<'_> {
    let mut open = Array::zeros(coefficients.value().shape());
    let width = open.shape()[1];
    open.data_mut().iter_mut().step_by(width).for_each(|c| *c = 2.0 * PI.sqrt());
    coefficients.tape.input(open)
}

/// Visibility, 0 to 1, of a linear field.
fn squashed(linear: Var<'_>, form: VisibilityForm) -> Var<'_> {
    match form {
        VisibilityForm::Sigmoid => linear.sigmoid(),
        VisibilityForm::Linear | VisibilityForm::Off => linear.clamp(0.0, 1.0),
    }
}

/// Visibility over the specular lobe, (P, 1); in the article's form along the reflection alone.
fn lobe_visibility<'t>(
    coefficients: Var<'t>,
    reflection: Var<'t>,
    roughness: Var<'t>,
    form: VisibilityForm,
) -> Var<'t> {
    let sh_degree = sh_degree_of(coefficients);
    let along = coefficients * real_sh(reflection, sh_degree);
    if form == VisibilityForm::Sigmoid {
        return squashed(along.sum_last(), form);
    }
    let attenuation = roughness.map_rows(|[roughness]: [f64; 1]| {
        let sample = LobeAttenuation::shared().sample(roughness);
        (sample.value, sample.by_roughness.map(|derivative| [derivative]))
    });
    squashed(along.dot(attenuation.gather(1, &degrees(sh_degree))), form)
}
