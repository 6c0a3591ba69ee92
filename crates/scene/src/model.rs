//! A whole relightable model: Gaussians, albedo prototypes, the recovered environment and how to shade them.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::{EnvMap, Field, Gaussians, Illumination, LightSplit};

/// Form of the visibility field. `linear`: the sum of coefficients times basis functions, clamped to [0, 1].
/// `sigmoid`: the sigmoid of that sum. `off`: no occlusion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum VisibilityForm {
    /// `V = sum c Y` (article Eq. 13), clamped to [0, 1] where it is used. V = 1 gives AO = 1 exactly.
    #[default]
    Linear,
    /// `V = sigmoid(sum c Y)`, as in the article's listing.
    Sigmoid,
    /// No occlusion: V = 1 everywhere.
    Off,
}

/// Form of the diffuse term. `ambient_occlusion`: diffuse light times ambient occlusion. `directional`: the
/// integral of visibility, light and cosine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DiffuseForm {
    /// The article's `AO * L_diff(n)` (Eq. 21).
    AmbientOcclusion,
    /// `E(n) = sum_j c_j T_j(n)`: the integral of visibility x light x cosine (docs/MODEL.md, section 4).
    #[default]
    Directional,
}

/// Place of shading. `pixel`: in the pixel, from blended attributes (deferred shading). `gaussian`: at each
/// Gaussian, from its own attributes; the resulting radiance is blended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ShadeAt {
    /// In the pixel, from blended attributes (deferred shading, as in the article).
    Pixel,
    /// At each Gaussian, from its own attributes; the resulting radiance is blended.
    #[default]
    Gaussian,
}

/// Source of the normals. `free`: the normal field itself, normalised. `shortest_axis`: the shortest axis of
/// the Gaussian, turned towards the camera, plus the normal field as an offset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum NormalForm {
    /// The `Normal` field itself, normalised (as in the article's listing).
    Free,
    /// The shortest axis, turned towards the camera, plus the `Normal` field as an offset.
    #[default]
    ShortestAxis,
}

/// Light from directions that are not visible. `off`: none. `learned`: 16 learned SH weights on the
/// low-frequency environment, specular only. `gathered`: irradiance gathered from the occluding Gaussians,
/// diffuse and specular.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum IndirectForm {
    /// No light.
    Off,
    /// 16 learned SH weights on the low-frequency environment, specular only (Eq. 19-20).
    Learned,
    /// Irradiance gathered from the occluding Gaussians, diffuse and specular (docs/MODEL.md, section 6).
    #[default]
    Gathered,
}

/// Options of the forward model. They are stored with the model, because its parameters are valid only with
/// them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ShadingOptions {
    /// Form of the visibility field.
    pub visibility: VisibilityForm,
    /// Form of the diffuse term.
    pub diffuse: DiffuseForm,
    /// True: the diffuse term receives only the light that the highlight leaves, so that no surface reflects more than what arrives.
    /// Trainings that conserve energy recover albedo and light less well (docs/decisions/0044-energy-of-the-diffuse-term.md).
    pub conserves_energy: bool,
    /// Place of shading.
    // Files of version 2 had the diffuse term at the Gaussians alone, under this name.
    #[serde(alias = "diffuse_at")]
    pub shade_at: ShadeAt,
    /// Source of normals.
    pub normal: NormalForm,
    /// Indirect light.
    pub indirect: IndirectForm,
    /// True: the diffuse term has the shadows of the sky in single directions, where indirect light is gathered. False: only through the
    /// visibility field, as in models of earlier versions.
    #[serde(default)]
    pub sky_shadows: bool,
    /// Screen-space low-pass added to the projected covariance, px^2.
    pub low_pass: f32,
    /// Scales the opacity so that the low-pass does not change the total weight of a splat (Mip-Splatting).
    /// Without it, splats become too wide in small images, which costs 4 to 6 dB at half the trained size.
    pub low_pass_compensation: bool,
    /// Maximum distance of an occluder, world units. Absent: any distance. Captures without masks include
    /// their surroundings; distant surroundings are a source of light, not an occluder.
    pub occluder_reach: Option<f32>,
    /// True: images are clamped and sRGB-encoded. False: images are only clamped, as in the article's
    /// listing.
    pub srgb: bool,
}

impl ShadingOptions {
    /// True where shading uses dominant lights, each with its own shadow.
    pub fn shades_lights(&self) -> bool {
        self.shade_at == ShadeAt::Gaussian && self.visibility != VisibilityForm::Off
    }

    /// True where gathered light contains the shadows of the sky in single directions.
    pub fn has_sky_shadows(&self) -> bool {
        self.sky_shadows
            && self.indirect == IndirectForm::Gathered
            && self.visibility == VisibilityForm::Linear
            && self.diffuse == DiffuseForm::Directional
    }

    /// The first number that is out of range, and its range.
    pub fn fault(&self) -> Option<(&'static str, &'static str)> {
        if !(0.0..=MAX_LOW_PASS).contains(&self.low_pass) {
            return Some(("low_pass", "must be 0 to 100 px^2"));
        }
        let is_distance = |reach: f32| reach > 0.0 && reach.is_finite();
        match self.occluder_reach {
            Some(reach) if !is_distance(reach) => Some(("occluder_reach", "must be above 0 and finite")),
            _ => None,
        }
    }
}

/// Largest low-pass, px^2.
const MAX_LOW_PASS: f32 = 100.0;

impl Default for ShadingOptions {
    fn default() -> Self {
        Self {
            visibility: VisibilityForm::default(),
            diffuse: DiffuseForm::default(),
            conserves_energy: false,
            shade_at: ShadeAt::default(),
            normal: NormalForm::default(),
            indirect: IndirectForm::default(),
            sky_shadows: true,
            low_pass: 0.3,
            low_pass_compensation: true,
            occluder_reach: None,
            srgb: true,
        }
    }
}

/// A view near the photographs, capture units. From elsewhere, parts that no photograph shows may hide the scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Framing {
    /// Position of the camera.
    pub eye: DVec3,
    /// The point it looks at.
    pub target: DVec3,
    /// Field of view of a square picture, degrees.
    pub fov_deg: f64,
}

impl Framing {
    /// The framing if it defines a view, else `None`.
    pub fn checked(self) -> Option<Self> {
        let distance = (self.eye - self.target).length();
        let is_view = distance.is_finite() && distance > 0.0 && self.fov_deg > 0.0 && self.fov_deg < 180.0;
        is_view.then_some(self)
    }
}

/// Prefix of the name of a recovered light of one light group: `recovered:evening`.
pub const RECOVERED_GROUP: &str = "recovered:";

/// Largest number of light groups of a model.
pub const MAX_LIGHT_GROUPS: usize = 8;

/// A relightable model in a normalised world: the scene fills about the unit ball around the origin.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// The Gaussians.
    pub gaussians: Gaussians,
    /// K albedo prototypes, linear Rec.709 (Eq. 23).
    pub prototypes: Vec<[f32; 3]>,
    /// Raw environments of the capture, before softplus: one for each light group, each row-major `env_height x env_width`.
    pub env_raw: Vec<[f32; 3]>,
    /// Columns of the environment.
    pub env_width: usize,
    /// Rows of the environment.
    pub env_height: usize,
    /// Dominant lights of these environments; each has its own measured shadow.
    pub lights: LightSplit,
    /// The options of the forward model with which the parameters were trained.
    pub shading: ShadingOptions,
    /// Capture to model: `x_model = scale * (x_capture + offset)`.
    pub world_scale: f64,
    /// See `world_scale`; capture units.
    pub world_offset: DVec3,
    /// A view of the scene from photographs without masks. `None` where masks isolate the object, which then lies in the unit
    /// ball.
    pub framing: Option<Framing>,
    /// The model card: the training's input, settings and decisions with their evidence.
    pub card: serde_json::Value,
}

/// Why a model cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("model: {field}: {reason}")]
pub struct ModelError {
    /// The array or option at fault.
    pub field: &'static str,
    /// The reason.
    pub reason: String,
}

impl Model {
    /// A model in capture units with default shading. Each environment has `width` times `height` raw texels and no separate lights.
    pub fn new(
        gaussians: Gaussians,
        prototypes: Vec<[f32; 3]>,
        env_raw: Vec<[f32; 3]>,
        (width, height): (usize, usize),
    ) -> Self {
        Self {
            gaussians,
            prototypes,
            env_raw,
            env_width: width,
            env_height: height,
            lights: LightSplit::default(),
            shading: ShadingOptions::default(),
            world_scale: 1.0,
            world_offset: DVec3::ZERO,
            framing: None,
            card: serde_json::Value::Null,
        }
    }

    /// Number of texels of an environment.
    pub fn env_texels(&self) -> usize {
        self.env_width * self.env_height
    }

    /// Number of light groups: sets of photographs that share a light. Each has an environment; materials are common.
    pub fn light_groups(&self) -> usize {
        self.env_raw.len() / self.env_texels().max(1)
    }

    /// Raw environment of light group `group`; empty where there is no such group.
    pub fn env_raw_of(&self, group: usize) -> &[[f32; 3]] {
        self.env_raw.chunks(self.env_texels().max(1)).nth(group).unwrap_or(&[])
    }

    /// The recovered environment of light group `group` as radiance (softplus of the raw values). Without such a group it is black.
    pub fn environment(&self, group: usize) -> EnvMap {
        let texels = self.env_raw_of(group).iter().map(|t| t.map(softplus)).collect();
        match EnvMap::new(self.env_width, self.env_height, texels) {
            Ok((map, _)) => map,
            Err(_) => EnvMap::constant(self.env_width, self.env_height, [0.0; 3]),
        }
    }

    /// The light of the photographs of the first light group, with the dominant lights that the training found in it.
    pub fn recovered_light(&self) -> Illumination {
        self.recovered_light_of(0)
    }

    /// The light of the photographs of light group `group`, with the dominant lights that the training found.
    pub fn recovered_light_of(&self, group: usize) -> Illumination {
        let split = (!self.lights.is_empty()).then(|| self.lights.clone());
        Illumination { environment: self.environment(group), split }
    }

    /// Names of the light groups by index, according to the model card; the name of photographs that state no group is empty. A model of one
    /// light has one group with an empty name.
    pub fn light_group_names(&self) -> Vec<&str> {
        let names = self.card.pointer("/light/groups").and_then(serde_json::Value::as_array);
        let names: Vec<&str> = names.into_iter().flatten().filter_map(serde_json::Value::as_str).collect();
        if names.len() == self.light_groups() { names } else { vec![""] }
    }

    /// Index of the light group `name`.
    pub fn light_group(&self, name: &str) -> Option<usize> {
        self.light_group_names().iter().position(|other| *other == name)
    }

    /// The light with a name that requests use: `recovered`, the light of the photographs of the first light group, or `recovered:GROUP`.
    /// `None` for other names.
    ///
    /// # Errors
    /// The reason, if the model has no such light group.
    pub fn named_recovered_light(&self, name: &str) -> Option<Result<Illumination, String>> {
        if name == "recovered" {
            return Some(Ok(self.recovered_light()));
        }
        let name = name.strip_prefix(RECOVERED_GROUP)?;
        let groups = || {
            let names: Vec<&str> =
                self.light_group_names().into_iter().filter(|name| !name.is_empty()).collect();
            if names.is_empty() { "none".to_owned() } else { names.join(", ") }
        };
        let missing = || format!("the model has no light group `{name}`; its light groups: {}", groups());
        Some(self.light_group(name).map(|group| self.recovered_light_of(group)).ok_or_else(missing))
    }

    /// False for a model of colour alone, according to its card: trained as one, or imported from a file without materials.
    /// Such a model cannot be relit.
    pub fn has_materials(&self) -> bool {
        let warm_up = self.card.pointer("/config/warm_up").and_then(serde_json::Value::as_f64);
        let imported = self.card.pointer("/imported/materials").and_then(serde_json::Value::as_bool);
        warm_up.is_none_or(|share| share < 1.0) && imported != Some(false)
    }

    /// Checks lengths and finiteness, for models that come from a file.
    ///
    /// # Errors
    /// Names the first array that is at fault.
    pub fn check(&self) -> Result<(), ModelError> {
        let err = |field, reason: &str| Err(ModelError { field, reason: reason.to_owned() });
        if self.prototypes.len() != self.gaussians.prototypes() {
            return err("prototypes", "their number differs from the Gaussians' K");
        }
        let texels = self.env_texels();
        if texels == 0 || !(1..=MAX_LIGHT_GROUPS).any(|groups| self.env_raw.len() == groups * texels) {
            return err("environment", "its size does not fit its texels");
        }
        if let Some((field, reason)) = self.shading.fault() {
            return err(field, reason);
        }
        if let Some(reason) = self.lights.fault(texels) {
            return err("lights", reason);
        }
        for field in Field::ALL {
            check_values(field.name(), self.gaussians.field(field))?;
        }
        let confidence = self.gaussians.confidence().unwrap_or_default();
        if !confidence.iter().all(|c| (0.0..=1.0).contains(c)) {
            return err("confidence", "must be 0 to 1");
        }
        check_values("prototypes", self.prototypes.as_flattened())?;
        check_values("environment", self.env_raw.as_flattened())?;
        if !(self.world_scale.is_finite() && self.world_scale > 0.0 && self.world_offset.is_finite()) {
            return err("world_scale,world_offset", "must be finite and the scale positive");
        }
        if self.framing.is_some_and(|framing| framing.checked().is_none()) {
            return err("framing", "must look from one point at another, with 0 to 180 degrees");
        }
        Ok(())
    }
}

/// Largest magnitude of a parameter in a file: its square, and sums of many, stay finite in f32.
const MAX_VALUE: f32 = 1e18;

fn check_values(field: &'static str, values: &[f32]) -> Result<(), ModelError> {
    let err = |reason: String| Err(ModelError { field, reason });
    match values.iter().position(|v| !(v.abs() <= MAX_VALUE)) {
        Some(at) if values[at].is_finite() => err(format!("value {at} is beyond {MAX_VALUE:e}")),
        Some(at) => err(format!("value {at} is not finite")),
        None => Ok(()),
    }
}

/// `ln(1 + e^x)` without overflow.
pub fn softplus(x: f32) -> f32 {
    if x > 20.0 { x } else { x.exp().ln_1p() }
}

/// The `x` with `softplus(x) = y`, for y > 0.
pub fn softplus_inverse(y: f32) -> f32 {
    if y > 20.0 { y } else { y.max(1e-12).exp_m1().ln() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn softplus_inverse_is_accurate_from_1e_6_to_6e4() {
        for y in [1e-6f32, 0.1, 1.0, 15.0, 6e4] {
            assert!((softplus(softplus_inverse(y)) / y - 1.0).abs() < 1e-3, "{y}");
        }
    }
}
