//! Models of published systems, re-created with the settings of this program.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Whose model a training has: settings under those that a caller gives. All but `relume` are re-creations of the *model* of
/// a published system inside this program, not its code: initialisation, density control, restarts and step sizes are ours,
/// so that a comparison is one of models.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// 3D Gaussian splatting: colour that depends on the view, harmonics of degree 3. It has no materials and cannot be relit.
    #[serde(rename = "3dgs")]
    Splatting,
    /// As `GaussianShader`: shaded at each Gaussian from its own material, without occlusion and without indirect light. Its
    /// residual colour is left out.
    GaussianShader,
    /// As `GS-IR`: shaded in the pixel, diffuse light times ambient occlusion. `GS-IR` bakes occlusion once, after a warm-up;
    /// ours is measured by probes, again at every refresh. Its baked indirect light is left out.
    GsIr,
    /// As `Relightable 3D Gaussian`: shaded at each Gaussian with traced visibility by direction and learned indirect light.
    /// Visibility is learned from probes and camera rays, and indirect light is that of the article.
    R3dg,
    /// The article as its listing has it: shaded in the pixel, sigmoid visibility with backward labels, ambient occlusion,
    /// learned indirect light, albedo prototypes.
    Article,
    /// Everything of this program: no setting changes.
    #[default]
    Relume,
}

impl Method {
    /// All of them, simplest first.
    pub const ALL: [Self; 6] =
        [Self::Splatting, Self::GaussianShader, Self::GsIr, Self::R3dg, Self::Article, Self::Relume];

    /// Whether nothing is re-created.
    pub(super) fn is_relume(&self) -> bool {
        *self == Self::Relume
    }

    /// The overrides that make the model, as JSON.
    pub(super) fn overrides(self) -> Value {
        match self {
            Self::Splatting => json!({
                "warm_up": 1.0, "radiance_order": 3,
                // Nothing but the picture shapes the Gaussians.
                "weights": {"depth_normal": 0.0, "flatness": 0.0},
                "lights": 0
            }),
            Self::GaussianShader => json!({
                "shading": {"visibility": "off", "indirect": "off"},
                "labels": "none", "bounces": 0, "prototypes": 1, "lights": 0, "sheen": false
            }),
            Self::GsIr => json!({
                "shading": {"diffuse": "ambient_occlusion", "indirect": "off", "shade_at": "pixel"},
                "labels": "probes", "bounces": 0, "prototypes": 1, "lights": 0, "sheen": false
            }),
            // Probes alone would leave learned indirect light at its first value.
            Self::R3dg => json!({
                "shading": {"diffuse": "directional", "indirect": "learned"},
                "labels": "both", "bounces": 0, "prototypes": 1, "lights": 0, "sheen": false
            }),
            Self::Article => json!({
                "shading": {
                    "visibility": "sigmoid", "diffuse": "ambient_occlusion", "indirect": "learned", "shade_at": "pixel"
                },
                "labels": "backward", "bounces": 0, "lights": 0, "sheen": false
            }),
            Self::Relume => json!({}),
        }
    }
}
