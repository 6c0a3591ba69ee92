//! Changes of the forward model.

use relume_scene::{DiffuseForm, IndirectForm, NormalForm, ShadeAt, ShadingOptions, VisibilityForm};
use serde::{Deserialize, Serialize};

/// The forward model. Omitted fields keep the value of the preset or method.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = ShadingOptions)]
#[serde(default, deny_unknown_fields)]
pub struct ShadingChanges {
    /// Form of the visibility field.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = VisibilityForm, required = false, default = json!("linear"))]
    pub visibility: Option<VisibilityForm>,
    /// Form of the diffuse term.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = DiffuseForm, required = false, default = json!("directional"))]
    pub diffuse: Option<DiffuseForm>,
    /// Place of shading.
    #[serde(alias = "diffuse_at", skip_serializing_if = "Option::is_none")]
    #[schema(value_type = ShadeAt, required = false, default = json!("gaussian"))]
    pub shade_at: Option<ShadeAt>,
    /// Source of normals.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = NormalForm, required = false, default = json!("shortest_axis"))]
    pub normal: Option<NormalForm>,
    /// Indirect light.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = IndirectForm, required = false, default = json!("gathered"))]
    pub indirect: Option<IndirectForm>,
    /// Screen-space low-pass added to the projected covariance, px^2.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = f32, required = false, default = 0.3)]
    pub low_pass: Option<f32>,
    /// Scales the opacity so that the low-pass does not change the total weight of a splat (Mip-Splatting).
    /// Without it, splats become too wide in small images.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = bool, required = false, default = true)]
    pub low_pass_compensation: Option<bool>,
    /// Maximum distance of an occluder, world units. Omitted: any distance; for captures without masks, a
    /// distance that the training chooses.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub occluder_reach: Option<f32>,
    /// True: images are clamped and sRGB-encoded. False: images are only clamped.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = bool, required = false, default = true)]
    pub srgb: Option<bool>,
}

impl ShadingChanges {
    /// Sets the fields that are given.
    pub(crate) fn apply(&self, options: &mut ShadingOptions) {
        fn set<T: Copy>(field: &mut T, change: Option<T>) {
            if let Some(value) = change {
                *field = value;
            }
        }
        set(&mut options.visibility, self.visibility);
        set(&mut options.diffuse, self.diffuse);
        set(&mut options.shade_at, self.shade_at);
        set(&mut options.normal, self.normal);
        set(&mut options.indirect, self.indirect);
        set(&mut options.low_pass, self.low_pass);
        set(&mut options.low_pass_compensation, self.low_pass_compensation);
        set(&mut options.srgb, self.srgb);
        if self.occluder_reach.is_some() {
            options.occluder_reach = self.occluder_reach;
        }
    }
}

/// Name, type and documentation of each field.
pub(crate) fn declared() -> Vec<(&'static str, &'static str, &'static str)> {
    vec![
        ("visibility", "VisibilityForm", "Form of the visibility field: `linear`, `sigmoid` or `off`."),
        ("diffuse", "DiffuseForm", "Form of the diffuse term: `directional` or `ambient_occlusion`."),
        ("shade_at", "ShadeAt", "Where surfaces are shaded: `gaussian` or `pixel`."),
        ("normal", "NormalForm", "Source of normals: `shortest_axis` or `free`."),
        ("indirect", "IndirectForm", "Indirect light: `gathered`, `learned` or `off`."),
        ("low_pass", "f32", "Screen-space low-pass added to the projected covariance, px^2."),
        ("low_pass_compensation", "bool", "Whether opacity compensates the low-pass."),
        ("occluder_reach", "f32", "Largest distance of an occluder, world units. Omitted: any distance."),
        ("srgb", "bool", "True: images are clamped and sRGB-encoded. False: they are only clamped."),
    ]
}

impl From<ShadingOptions> for ShadingChanges {
    fn from(options: ShadingOptions) -> Self {
        Self {
            visibility: Some(options.visibility),
            diffuse: Some(options.diffuse),
            shade_at: Some(options.shade_at),
            normal: Some(options.normal),
            indirect: Some(options.indirect),
            low_pass: Some(options.low_pass),
            low_pass_compensation: Some(options.low_pass_compensation),
            occluder_reach: options.occluder_reach,
            srgb: Some(options.srgb),
        }
    }
}
