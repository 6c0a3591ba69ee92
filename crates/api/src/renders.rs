//! Requests for rendered frames and G-buffers.

use serde::{Deserialize, Serialize};

use crate::EnvironmentId;
use crate::cameras::CameraSpec;
use relume_spec::rendering::{Background, ColourDepth, Lamp, MaterialEdit, Output, Tier, ToneCurve};

/// A render request.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenderRequest {
    /// Camera.
    pub camera: CameraSpec,
    /// Light. Omitted: the recovered light of the capture.
    #[serde(default)]
    pub environment: EnvironmentSpec,
    /// Lamps beside the environment, at most 16. `environment.exposure_ev` does not change them. Omitted: none.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    #[schema(max_items = 16)]
    pub lamps: Vec<Lamp>,
    /// Changes of materials for this picture, at most 1,000; later ones follow earlier ones. The model stays. Omitted: none.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    #[schema(max_items = 1000)]
    pub materials: Vec<MaterialEdit>,
    /// Width, 1 to 4096 pixels.
    #[schema(minimum = 1, maximum = 4096)]
    #[serde(deserialize_with = "crate::lenient::pixels")]
    pub width: u32,
    /// Height, 1 to 4096 pixels.
    #[schema(minimum = 1, maximum = 4096)]
    #[serde(deserialize_with = "crate::lenient::pixels")]
    pub height: u32,
    /// Quality tier. `preview`: each Gaussian is shaded once. `standard`: shading from precomputed light
    /// tables. `high`: as `standard`, with per-pixel shadows of up to eight strong small lights.
    /// `monte_carlo`: sampled light, slow. Omitted: `standard`.
    #[serde(default)]
    #[schema(value_type = String, example = "standard")]
    pub tier: Tier,
    /// Sampled directions per pixel in the tier `monte_carlo`, 1 to 65,536. Samples times pixels must not
    /// exceed 2,097,152, or 134,217,728 if a GPU renders. Omitted: 64.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 1, maximum = 65536)]
    pub samples: Option<u32>,
    /// Seed of the sampled directions. Equal requests give equal bytes on one device. Omitted: 0.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub seed: Option<u64>,
    /// Outputs, each at most once: `rgb`, `albedo`, `normal`, `metallic`, `roughness`, `visibility`, `depth`,
    /// `alpha`, `diffuse`, `specular`, `radiance`, `confidence`, those of the ground below the model: `shadow`,
    /// `shadow_key`, `shadow_fill`, `bounce`, `contact`, and with lamps `lamp_light` and `lamp_shadow`,
    /// and those that need EXR: `position`, `material_id`, `cryptomatte` and, in exports of frames, `motion`. PNG and JPEG hold one output, EXR holds all. Omitted: `["rgb"]`.
    #[serde(default = "rgb_only")]
    #[schema(value_type = Vec<String>, example = json!(["rgb"]))]
    pub outputs: Vec<Output>,
    /// Height (z) of the ground for `shadow`, `bounce` and the other outputs of the ground, units of the capture. Omitted: the lowest visible
    /// point of the model.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub ground_height: Option<f64>,
    /// Background: `transparent` (JPEG shows white), `environment` (the light, in `rgb` only), or a display
    /// colour such as `#f4f4f4` (not for EXR). Omitted: `transparent`.
    #[serde(default)]
    #[schema(value_type = String, example = "transparent")]
    pub background: Background,
    /// Tone curve: `srgb` (clamped), `neutral` (Khronos PBR Neutral), `agx`, or `linear` (16-bit PNG). It
    /// does not apply to albedo or to EXR. Omitted: `srgb`.
    #[serde(default)]
    #[schema(value_type = String, pattern = "^(srgb|neutral|agx|linear)$", example = "srgb")]
    pub tone_curve: ToneCurve,
    /// Number type of colours in an EXR: `float` or `half`. Allowed only with EXR. Omitted: `float`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(inline)]
    pub colour_depth: Option<ColourDepth>,
}

/// A light: at most one of `id`, `builtin` and `inline_base64`. Without any of them it is the recovered light
/// of the capture.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentSpec {
    /// Identifier of an uploaded map.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>)]
    pub id: Option<EnvironmentId>,
    /// Name of a built-in map, `recovered`, or `recovered:GROUP` for a light group of the model.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub builtin: Option<String>,
    /// Contents of a `.hdr` or `.exr` file, Base64.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub inline_base64: Option<String>,
    /// Rotation about world +Z, degrees, counter-clockwise seen from above. Omitted: 0.
    #[serde(default)]
    pub rotation_deg: f64,
    /// Exposure, stops, -20 to 20. Omitted: 0.
    #[serde(default)]
    pub exposure_ev: f64,
}

fn rgb_only() -> Vec<Output> {
    vec![Output::Rgb]
}
