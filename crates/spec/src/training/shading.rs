//! Changes of the forward model.

use relume_scene::{DiffuseForm, IndirectForm, NormalForm, ShadeAt, ShadingOptions, VisibilityForm};

use crate::training::group::changes;

changes! {
    /// The forward model.
    ShadingOptions changed by ShadingChanges as ShadingOptions {
        /// Form of the visibility field: `linear`, `sigmoid` or `off`.
        visibility: VisibilityForm = "linear";
        /// Form of the diffuse term: `directional` or `ambient_occlusion`.
        diffuse: DiffuseForm = "directional";
        /// Whether the diffuse term receives only the light that the highlight leaves, so that no surface reflects more than what
        /// arrives. Trainings recover albedo and light less well with it.
        conserves_energy: bool = false;
        /// Where surfaces are shaded: `gaussian` or `pixel`.
        #[serde(alias = "diffuse_at")]
        shade_at: ShadeAt = "gaussian";
        /// Source of normals: `shortest_axis` or `free`.
        normal: NormalForm = "shortest_axis";
        /// Indirect light: `gathered`, `learned` or `off`.
        indirect: IndirectForm = "gathered";
        /// Whether the diffuse term has the shadows of the sky in single directions. false: only through the visibility field. Without
        /// effect unless indirect light is gathered.
        sky_shadows: bool = true;
        /// Screen-space low-pass added to the projected covariance, 0 to 100 px^2.
        low_pass: f32 = 0.3;
        /// Whether opacity compensates for the low-pass, so that it does not change the total weight of a splat (Mip-Splatting).
        /// Without it, splats become too wide in small images.
        low_pass_compensation: bool = true;
        /// Maximum distance of an occluder, above 0, world units. Omitted: any distance; for captures without masks, a distance that the
        /// training chooses.
        occluder_reach: f32;
        /// True: images are clamped and sRGB-encoded. False: images are only clamped.
        srgb: bool = true;
    }
}
