//! Requests for relit frames and G-buffers.

use serde::{Deserialize, Serialize};

use crate::api::EnvironmentId;
use crate::api::cameras::CameraSpec;
use crate::render::{Background, ColourDepth, Output, Tier, ToneCurve};

/// A frame to render.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct RenderRequest {
    /// From where.
    pub camera: CameraSpec,
    /// Under which light; the light of the capture, as it was recovered, when absent.
    #[serde(default)]
    pub environment: EnvironmentSpec,
    /// 1 to 4096 pixels.
    #[cfg_attr(feature = "server", schema(minimum = 1, maximum = 4096))]
    pub width: u32,
    /// 1 to 4096 pixels.
    #[cfg_attr(feature = "server", schema(minimum = 1, maximum = 4096))]
    pub height: u32,
    /// `preview`, `standard` (the default), `high` (shadows of strong small lights in every pixel) or `monte_carlo` (slow).
    #[serde(default)]
    #[cfg_attr(feature = "server", schema(value_type = String, example = "standard"))]
    pub tier: Tier,
    /// Directions a pixel that the tier `monte_carlo` draws; 64 when absent. Times the pixels at most 2,097,152, or 134,217,728
    /// where a GPU renders.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(minimum = 1, maximum = 65536))]
    pub samples: Option<u32>,
    /// Seed of those directions; 0 when absent. Equal requests give equal bytes on one device.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub seed: Option<u64>,
    /// `rgb albedo normal metallic roughness visibility depth alpha diffuse specular radiance`; `["rgb"]` when
    /// absent. PNG and JPEG hold one, EXR holds all.
    #[serde(default = "rgb_only")]
    #[cfg_attr(feature = "server", schema(value_type = Vec<String>, example = json!(["rgb"])))]
    pub outputs: Vec<Output>,
    /// What stands behind the model: `transparent` (the default; JPEG shows white), `environment` (the light, in `rgb`), or a display
    /// colour like `#f4f4f4`, which an EXR does not take.
    #[serde(default)]
    #[cfg_attr(feature = "server", schema(value_type = String, example = "transparent"))]
    pub background: Background,
    /// How colours come to a display: `srgb` (the default; clamped), `neutral` (Khronos PBR Neutral), `agx` or `linear` (16-bit PNG).
    /// Albedo is not tone-mapped, and an EXR never.
    #[serde(default)]
    #[cfg_attr(feature = "server", schema(value_type = String, pattern = "^(srgb|neutral|agx|linear)$", example = "srgb"))]
    pub tone_curve: ToneCurve,
    /// How an EXR stores colours: `float` (the default) or `half`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(inline))]
    pub colour_depth: Option<ColourDepth>,
}

/// A light: at most one of `id`, `builtin` and `inline_base64`; none of them means the capture's own.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct EnvironmentSpec {
    /// Identifier of an uploaded map.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>))]
    pub id: Option<EnvironmentId>,
    /// Name of a built-in map, or `recovered`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub builtin: Option<String>,
    /// A `.hdr` or `.exr` file in base64.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub inline_base64: Option<String>,
    /// Turn about world +Z, degrees counter-clockwise seen from above.
    #[serde(default)]
    pub rotation_deg: f64,
    /// Exposure, stops, -20 to 20.
    #[serde(default)]
    pub exposure_ev: f64,
}

fn rgb_only() -> Vec<Output> {
    vec![Output::Rgb]
}
