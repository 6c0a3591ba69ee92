//! Models of published systems, re-created with settings of this program.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Model to train. A method selects other settings; settings that the caller gives take precedence.
///
/// Methods other than `relume` re-create the *model* of a published system in this program and do not use its
/// code. Initialisation, density control, restarts and step sizes are those of Relume, so that only the
/// models differ in a comparison.
///
/// `3dgs`: 3D Gaussian splatting, view-dependent colour without materials; it cannot be relit.
/// `gaussian-shader`: GaussianShader. `gs-ir`: GS-IR. `r3dg`: Relightable 3D Gaussian. `article`: the model
/// of the article. `relume`: the model of Relume.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// 3D Gaussian splatting: view-dependent colour with spherical harmonics of degree 3. It has no materials
    /// and cannot be relit.
    #[serde(rename = "3dgs")]
    Splatting,
    /// As `GaussianShader`: shading at each Gaussian from its own material, without occlusion and without
    /// indirect light. Its residual colour is omitted.
    GaussianShader,
    /// As `GS-IR`: shading in the pixel, diffuse light times ambient occlusion. `GS-IR` bakes occlusion once,
    /// after a warm-up; Relume measures it with probes, again at every refresh. The baked indirect light of
    /// `GS-IR` is omitted.
    GsIr,
    /// As `Relightable 3D Gaussian`: shading at each Gaussian with traced directional visibility and learned
    /// indirect light. Visibility is learned from probes and camera rays. Indirect light is that of the
    /// article.
    R3dg,
    /// The article's listing: shading in the pixel, sigmoid visibility with backward labels, ambient
    /// occlusion, learned indirect light, albedo prototypes.
    Article,
    /// The model of Relume: no setting changes.
    #[default]
    Relume,
}

impl Method {
    /// All methods, simplest first.
    pub const ALL: [Self; 6] =
        [Self::Splatting, Self::GaussianShader, Self::GsIr, Self::R3dg, Self::Article, Self::Relume];

    /// True for the model of Relume.
    pub(super) fn is_relume(&self) -> bool {
        *self == Self::Relume
    }

    /// The settings of the method, as JSON of [`TrainOverrides`](super::TrainOverrides).
    pub(super) fn overrides(self) -> Value {
        let mut changes = self.model_changes();
        if let Some(changes) = changes.as_object_mut().filter(|_| !self.is_relume()) {
            // Parts of a published model are not omitted, and its light is trained.
            changes.insert("complexity".to_owned(), json!("full"));
            changes.insert("surrounding_light".to_owned(), json!(false));
            changes.insert("environment_restarts".to_owned(), json!(false));
        }
        changes
    }

    fn model_changes(self) -> Value {
        match self {
            Self::Splatting => json!({
                "warm_up": 1.0, "radiance_order": 3,
                // Only the image loss shapes the Gaussians.
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
