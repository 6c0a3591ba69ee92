//! Exports: files that the server makes of a model in the background, such as sequences of frames and files
//! for other programs.
//!
//! The database stores [`NewExport`] and [`ExportState`] of each export.

mod delight;
mod splats;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::cameras::CameraSpec;
use crate::jobs::JobError;
use crate::models::FileView;
use crate::renders::EnvironmentSpec;
use crate::{ExportId, ModelId, NerfstudioWorld};
use relume_spec::rendering::{
    AlphaMode, Background, ColourDepth, FrameFormat, Lamp, MaterialEdit, Output, Primaries, Tier, ToneCurve,
};

pub use delight::{DelightExport, DelightKind};
pub use splats::{SplatsExport, SplatsKind};

/// An export to create. `kind` selects one of the five forms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(untagged)]
pub enum NewExport {
    /// A sequence of frames.
    Frames(Box<FramesExport>),
    /// Gaussians in a file format of other programs.
    Splats(SplatsExport),
    /// A textured triangle mesh.
    Mesh(MeshExport),
    /// A light matrix.
    LightMatrix(Box<LightMatrixExport>),
    /// Photographs without their light.
    Delight(DelightExport),
}

impl NewExport {
    /// Kind of the export.
    pub fn kind(&self) -> ExportKind {
        match self {
            Self::Frames(_) => ExportKind::Frames,
            Self::Splats(splats) => match splats.kind {
                SplatsKind::Gltf => ExportKind::Gltf,
                SplatsKind::Usd => ExportKind::Usd,
                SplatsKind::Usdz => ExportKind::Usdz,
                SplatsKind::Ply => ExportKind::Ply,
            },
            Self::Mesh(_) => ExportKind::Mesh,
            Self::LightMatrix(_) => ExportKind::LightMatrix,
            Self::Delight(_) => ExportKind::Delight,
        }
    }

    /// Changes of materials.
    pub fn materials(&self) -> &[MaterialEdit] {
        match self {
            Self::Frames(frames) => &frames.materials,
            Self::Splats(splats) => &splats.materials,
            Self::Mesh(mesh) => &mesh.materials,
            Self::LightMatrix(matrix) => &matrix.materials,
            Self::Delight(_) => &[],
        }
    }
}

/// Kind of an export.
///
/// `frames`: a sequence of frames as a zip or a video. `gltf`: glTF with KHR_gaussian_splatting, `.glb`.
/// `usd`: OpenUSD as text, `.usda`. `usdz`: an OpenUSD package, `.usdz`. `ply`: PLY. `mesh`: a textured
/// triangle mesh, `.glb`. `light_matrix`: a frame for each lobe of light, multi-part `.exr`. `delight`:
/// photographs without their light, a zip of images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[cfg_attr(feature = "sqlx", derive(sqlx::Type), sqlx(type_name = "text", rename_all = "snake_case"))]
#[serde(rename_all = "snake_case")]
pub enum ExportKind {
    /// A sequence of frames as a zip or a video.
    Frames,
    /// glTF with KHR_gaussian_splatting, `.glb`.
    Gltf,
    /// OpenUSD as text, `.usda`.
    Usd,
    /// An OpenUSD package, `.usdz`.
    Usdz,
    /// PLY.
    Ply,
    /// A textured triangle mesh, `.glb`.
    Mesh,
    /// A frame for each lobe of light, multi-part `.exr`.
    LightMatrix,
    /// Photographs without their light, a zip of images.
    Delight,
}

impl ExportKind {
    /// Name in requests.
    pub fn name(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Gltf => "gltf",
            Self::Usd => "usd",
            Self::Usdz => "usdz",
            Self::Ply => "ply",
            Self::Mesh => "mesh",
            Self::LightMatrix => "light_matrix",
            Self::Delight => "delight",
        }
    }
}

/// Kind of an export of frames.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FramesKind {
    /// A sequence of frames.
    #[default]
    Frames,
}

/// A sequence of frames, as from `relume render --turntable` and `--path`. Exactly one of `turntable` and
/// `path` is required.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FramesExport {
    /// `frames`.
    pub kind: FramesKind,
    /// Cameras on a circle around the model.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub turntable: Option<TurntableSpec>,
    /// One camera per frame, 1 to 10,000 cameras. Accepted forms: an object with `cameras`, as
    /// `GET /v1/captures/{id}/cameras` returns it; nerfstudio's `camera_path`; an object with the `frames` of
    /// a `transforms.json`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<Object>)]
    pub path: Option<Value>,
    /// nerfstudio's `dataparser_transforms.json` of the training in which the `camera_path` was made.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub path_world: Option<NerfstudioWorld>,
    /// Light. Omitted: the light of the capture. `inline_base64` is not accepted.
    #[serde(default)]
    pub environment: EnvironmentSpec,
    /// Lamps beside the environment, at most 16. `environment.exposure_ev` does not change them. Omitted: none.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    #[schema(max_items = 16)]
    pub lamps: Vec<Lamp>,
    /// Rotation of the light from the first frame to one frame after the last, added to
    /// `environment.rotation_deg`, degrees counter-clockwise seen from above. Omitted: 0.
    #[serde(default)]
    pub environment_turn_deg: f64,
    /// Width, 1 to 4096 pixels. Must be given together with `height`. Omitted: 512 for a turntable; the size
    /// that the path states.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[serde(deserialize_with = "crate::lenient::optional_pixels")]
    #[schema(minimum = 1, maximum = 4096)]
    pub width: Option<u32>,
    /// Height, 1 to 4096 pixels. Must be given together with `width`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[serde(deserialize_with = "crate::lenient::optional_pixels")]
    #[schema(minimum = 1, maximum = 4096)]
    pub height: Option<u32>,
    /// Quality tier: `preview`, `standard`, `high` or `monte_carlo`, as in a render request. Omitted:
    /// `standard`.
    #[serde(default)]
    #[schema(value_type = String, example = "standard")]
    pub tier: Tier,
    /// Sampled directions per pixel in the tier `monte_carlo`, 1 to 65,536, limited as in a render request.
    /// Omitted: 64.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 1, maximum = 65536)]
    pub samples: Option<u32>,
    /// Seed of the sampled directions. Omitted: 0.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub seed: Option<u64>,
    /// Outputs, as in a render request. Omitted: `["rgb"]`. PNG and JPEG hold one output, EXR holds all.
    #[serde(default = "rgb_only")]
    #[schema(value_type = Vec<String>, example = json!(["rgb"]))]
    pub outputs: Vec<Output>,
    /// Height (z) of the ground for `shadow`, `bounce` and the other outputs of the ground, units of the capture. Omitted: the lowest visible
    /// point of the model.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub ground_height: Option<f64>,
    /// File format of the frames: `png`, `jpeg` or `exr`. Omitted: `png`. A video needs `png` or `jpeg`.
    #[serde(default)]
    pub format: FrameFormat,
    /// Background, as in a render request. Omitted: `transparent`. A video has no alpha and shows white in
    /// place of `transparent`.
    #[serde(default)]
    #[schema(value_type = String, example = "transparent")]
    pub background: Background,
    /// Tone curve, as in a render request. Omitted: `srgb`. A video does not accept `linear`.
    #[serde(default)]
    #[schema(value_type = String, pattern = "^(srgb|neutral|agx|linear)$", example = "srgb")]
    pub tone_curve: ToneCurve,
    /// Number type of colours in an EXR: `float` or `half`. Allowed only with EXR. Omitted: `float`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(inline)]
    pub colour_depth: Option<ColourDepth>,
    /// Alpha of colours in an EXR: `premultiplied` or `straight`. Allowed only with EXR. Omitted:
    /// `premultiplied`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>, pattern = "^(premultiplied|straight)$")]
    pub alpha: Option<AlphaMode>,
    /// Primaries of colours in an EXR: `rec709` or `acescg`. Allowed only with EXR. Omitted: `rec709`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>, pattern = "^(rec709|acescg)$")]
    pub primaries: Option<Primaries>,
    /// Container: `zip` or `mp4`. Omitted: `zip`. `mp4` requires ffmpeg on the server and an even width and
    /// height.
    #[serde(default)]
    pub package: Package,
    /// Frames per second, 1 to 100,000. A video has at most 240; omitted: 24. An EXR stores the value as an
    /// attribute.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 1, maximum = 100_000)]
    pub frames_per_second: Option<u32>,
    /// Changes of materials, as in a render request. Omitted: none.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    #[schema(max_items = 1000)]
    pub materials: Vec<MaterialEdit>,
}

impl FramesExport {
    /// A turntable of `frames` frames. All other fields have their defaults.
    pub fn turntable(frames: u32) -> Self {
        let turntable =
            TurntableSpec { frames, azimuth_deg: None, elevation_deg: None, camera_turn_deg: full_turn() };
        Self { turntable: Some(turntable), outputs: rgb_only(), ..Self::default() }
    }
}

/// Cameras on a circle around the model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TurntableSpec {
    /// Number of frames, 1 to 10,000.
    #[schema(minimum = 1, maximum = 10_000)]
    pub frames: u32,
    /// Azimuth of the first frame, degrees counter-clockwise seen from above. 0, and omitted: as in a
    /// thumbnail.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub azimuth_deg: Option<f64>,
    /// Elevation, degrees above the horizon, -90 to 90. Omitted: as in a thumbnail.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = -90, maximum = 90)]
    pub elevation_deg: Option<f64>,
    /// Rotation of the camera from the first frame to one frame after the last, degrees counter-clockwise
    /// seen from above. 0 keeps the camera fixed. Omitted: 360.
    #[serde(default = "full_turn")]
    pub camera_turn_deg: f64,
}

/// Container of the frames. `zip`: numbered image files. `mp4`: an H.264 video.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Package {
    /// A zip of numbered image files.
    #[default]
    Zip,
    /// An H.264 video.
    Mp4,
}

/// Kind of a mesh export.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum MeshKind {
    /// A textured triangle mesh.
    #[default]
    Mesh,
}

/// A textured triangle mesh in a `.glb`, as from `relume export --mesh`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MeshExport {
    /// `mesh`.
    pub kind: MeshKind,
    /// Grid cells along each axis of the model's world, from which the surface is extracted, 16 to 512.
    /// Omitted: 192.
    #[serde(default = "cells")]
    #[schema(minimum = 16, maximum = 512)]
    pub cells: u32,
    /// Changes of materials, as in a render request. Omitted: none.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    #[schema(max_items = 1000)]
    pub materials: Vec<MaterialEdit>,
}

/// Kind of a light matrix export.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LightMatrixKind {
    /// A light matrix.
    #[default]
    LightMatrix,
}

/// A frame for each lobe of light in one multi-part EXR, as from `relume render --light-matrix`. Exactly one of
/// `camera` and `path` is required. The file of one camera has at most (3 x parts + 1) x width x height x 2
/// bytes (4 with `float`), where parts are the lobes and the strong small lights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LightMatrixExport {
    /// `light_matrix`.
    pub kind: LightMatrixKind,
    /// Camera, as in a render request. The result is one `.exr`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub camera: Option<CameraSpec>,
    /// Cameras, 1 to 10,000, as in an export of frames. The result is a zip with one `.exr` for each.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<Object>)]
    pub path: Option<Value>,
    /// nerfstudio's `dataparser_transforms.json` of the training in which the `camera_path` was made.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub path_world: Option<NerfstudioWorld>,
    /// Width, 1 to 4096 pixels. Must be given together with `height`. Omitted: 512 for `camera`; the size that
    /// the path states.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[serde(deserialize_with = "crate::lenient::optional_pixels")]
    #[schema(minimum = 1, maximum = 4096)]
    pub width: Option<u32>,
    /// Height, 1 to 4096 pixels. Must be given together with `width`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[serde(deserialize_with = "crate::lenient::optional_pixels")]
    #[schema(minimum = 1, maximum = 4096)]
    pub height: Option<u32>,
    /// Number of lobes, 1 to 512. Lobes times pixels must not exceed 268,435,456 for a camera and
    /// 4,294,967,296 for all cameras together. Omitted: 128.
    #[serde(default = "lobes")]
    #[schema(minimum = 1, maximum = 512)]
    pub lobes: u32,
    /// Environment whose strong small lights also get a frame each. `inline_base64` is not accepted, and
    /// `exposure_ev` must be 0. Omitted: lobes only.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub environment: Option<EnvironmentSpec>,
    /// Number type of the colours: `half` or `float`. Omitted: `half`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(inline)]
    pub colour_depth: Option<ColourDepth>,
    /// Changes of materials, as in a render request. Omitted: none.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    #[schema(max_items = 1000)]
    pub materials: Vec<MaterialEdit>,
}

impl LightMatrixExport {
    /// A matrix of `camera`. All other fields have their defaults.
    pub fn of(camera: CameraSpec) -> Self {
        Self {
            kind: LightMatrixKind::LightMatrix,
            camera: Some(camera),
            path: None,
            path_world: None,
            width: None,
            height: None,
            lobes: lobes(),
            environment: None,
            colour_depth: None,
            materials: Vec::new(),
        }
    }
}

/// State of an export: `queued`, `running`, or one of the final states `succeeded`, `failed` and `cancelled`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[derive(utoipa::ToSchema)]
#[cfg_attr(feature = "sqlx", derive(sqlx::Type), sqlx(type_name = "text", rename_all = "snake_case"))]
pub enum ExportState {
    /// The export is in the queue.
    Queued,
    /// The server makes the export.
    Running,
    /// The file is available.
    Succeeded,
    /// The export failed; `error` has the reason.
    Failed,
    /// A caller cancelled the export.
    Cancelled,
}

impl ExportState {
    /// True if the state is final.
    pub fn is_terminal(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }
}

/// Progress of an export.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[cfg_attr(feature = "sqlx", derive(sqlx::FromRow))]
pub struct ExportProgress {
    /// Completed frames or photographs. Other kinds: 0, or 1 after success.
    pub done: i64,
    /// Total number of frames or photographs. Other kinds: 1.
    pub total: i64,
}

/// An export.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ExportView {
    /// Identifier.
    #[schema(value_type = String)]
    pub id: ExportId,
    /// Identifier of the model.
    #[schema(value_type = String)]
    pub model: ModelId,
    /// Kind.
    pub kind: ExportKind,
    /// The request. Absent if its JSON is longer than about 4,096 bytes, as with a long camera path.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub request: Option<NewExport>,
    /// State.
    pub state: ExportState,
    /// Progress.
    pub progress: ExportProgress,
    /// The file, in the state `succeeded`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub file: Option<FileView>,
    /// Reason of the state `failed`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub error: Option<JobError>,
    /// Creation time, RFC 3339.
    pub created_at: String,
    /// Time of the first start, RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub started_at: Option<String>,
    /// Time of the final state, RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub finished_at: Option<String>,
}

fn rgb_only() -> Vec<Output> {
    vec![Output::Rgb]
}

fn full_turn() -> f64 {
    360.0
}

fn lobes() -> u32 {
    128
}

fn cells() -> u32 {
    192
}
