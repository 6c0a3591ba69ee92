//! What every importer produces.

use std::collections::BTreeMap;

use glam::DVec3;

use relume_scene::{Camera, EnvMap, ImageRgba, PackedImage, Plane};

/// Ground truth that a synthetic set may have for a view.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GroundTruthView {
    /// The view under other lights, by light name: sRGB, straight alpha.
    pub relit: BTreeMap<String, ImageRgba>,
    /// Base colour, **linear** Rec.709 (importers decode sRGB-encoded albedo).
    pub albedo: Option<Plane<3>>,
    /// World-space unit shading normal; zero where no surface is.
    pub normal: Option<Plane<3>>,
    /// Metalness and roughness, linear.
    pub metallic_roughness: Option<Plane<2>>,
    /// Cosine-weighted sky visibility in [0, 1].
    pub ambient_occlusion: Option<Plane<1>>,
    /// Distance along the view axis, capture units; 0 where no surface is.
    pub depth: Option<Plane<1>>,
}

/// One photograph with its pose.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureView {
    /// The image's name in the capture, e.g. `train_007/rgba.png`.
    pub name: String,
    /// Pose and intrinsics at the image's resolution, distortion already removed.
    pub camera: Camera,
    /// The photograph, 3 or 4 bytes a pixel where its file has 8 bits a channel.
    pub image: PackedImage,
    /// Turn of the light about +Z against the other photographs, degrees counter-clockwise seen from above; 0 where the
    /// light stood still.
    pub light_rotation_deg: f64,
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

/// A capture ready to train on: +Z up, OpenCV cameras, no distortion left.
#[derive(Debug, Clone, PartialEq)]
pub struct Capture {
    /// What was recognised: `nerf-synthetic`, `tensoir`, `nerfstudio`, `colmap`, `llff`, `synthetic`.
    pub layout: String,
    /// Views to train on.
    pub train: Vec<CaptureView>,
    /// Held-out views.
    pub test: Vec<CaptureView>,
    /// Sparse points with linear Rec.709 colours, when the capture has them.
    pub points: Vec<(DVec3, [f32; 3])>,
    /// Position and size of the subject.
    pub bounds: SceneBounds,
    /// True when the images' alpha channel is a mask.
    pub has_alpha: bool,
    /// Lights named in the ground truth, when found beside the capture.
    pub lights: BTreeMap<String, EnvMap>,
    /// The light of the photographs, where it was measured; no importer sets it.
    pub measured_light: Option<EnvMap>,
    /// Linear Rec.709 colour of a grey card in the photographs, where one was measured; no importer sets it.
    pub grey_card: Option<[f32; 3]>,
    /// Problems that did not stop the import, e.g. missing images by name.
    pub warnings: Vec<String>,
}
