//! The result of every importer.

use std::collections::BTreeMap;

use glam::DVec3;

use crate::{MeasuredChart, WorldUp};
use relume_scene::{Camera, EnvMap, ImageRgba, PackedImage, Plane};

/// Ground truth that a synthetic set may have for a view.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GroundTruthView {
    /// The view under other lights, by light name: sRGB, straight alpha.
    pub relit: BTreeMap<String, ImageRgba>,
    /// Base colour, **linear** Rec.709 (importers decode sRGB-encoded albedo).
    pub albedo: Option<Plane<3>>,
    /// World-space unit shading normal; zero without a surface.
    pub normal: Option<Plane<3>>,
    /// Metalness and roughness, linear.
    pub metallic_roughness: Option<Plane<2>>,
    /// Cosine-weighted sky visibility in [0, 1].
    pub ambient_occlusion: Option<Plane<1>>,
    /// Distance along the view axis, capture units; 0 without a surface.
    pub depth: Option<Plane<1>>,
}

/// One photograph with its pose.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureView {
    /// The image's name in the capture, e.g. `train_007/rgba.png`.
    pub name: String,
    /// Pose and intrinsics at the image's resolution, distortion already removed.
    pub camera: Camera,
    /// The photograph: 3 or 4 bytes a pixel if its file has 8 bits a channel. Linear light brighter than white is kept: see
    /// [`PackedImage::range`].
    pub image: PackedImage,
    /// Rotation of the light about +Z relative to the other photographs, degrees counter-clockwise seen from above; 0
    /// if the light did not move.
    pub light_rotation_deg: f64,
    /// Name of the group of photographs that share this photograph's light; `None` for photographs that name none.
    pub light_group: Option<String>,
    /// Ground-truth layers, when the set has them.
    pub truth: GroundTruthView,
}

/// Position and size of the scene, capture units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneBounds {
    /// Centre of the region of interest.
    pub centre: DVec3,
    /// Radius of the region of interest.
    pub radius: f64,
}

/// A grey card in a photograph.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredCard {
    /// Its colour in the photograph, linear Rec.709.
    pub colour: [f32; 3],
    /// The camera that sees only the card, if its reflectance is known.
    pub camera: Option<Camera>,
}

/// A capture ready for training: +Z up, OpenCV cameras, no distortion.
#[derive(Debug, Clone, PartialEq)]
pub struct Capture {
    /// The recognised layout: `nerf-synthetic`, `tensoir`, `nerfstudio`, `colmap`, `llff`, `polycam`, `synthetic`.
    pub layout: String,
    /// Training views.
    pub train: Vec<CaptureView>,
    /// Held-out views.
    pub test: Vec<CaptureView>,
    /// Sparse points with linear Rec.709 colours, when the capture has them.
    pub points: Vec<(DVec3, [f32; 3])>,
    /// Position and size of the object.
    pub bounds: SceneBounds,
    /// True when the images' alpha channel is a mask.
    pub has_alpha: bool,
    /// Environment maps of the lights that the ground truth names, if found.
    pub lights: BTreeMap<String, EnvMap>,
    /// The measured light of the photographs; no importer sets it.
    pub measured_light: Option<EnvMap>,
    /// The grey card in the photographs; no importer sets it.
    pub grey_card: Option<MeasuredCard>,
    /// The colour chart whose matrix the photographs have; no importer sets it.
    pub colour_chart: Option<MeasuredChart>,
    /// The direction in the files that became +Z.
    pub up: WorldUp,
    /// Note that the importer derived the rotations of the light from the poses; `None` if it did not.
    pub turntable: Option<String>,
    /// Problems that did not stop the import, e.g. missing images by name.
    pub warnings: Vec<String>,
}
