//! Exports: files that a server makes of a model in the background: sequences of frames, and what other programs open.
//!
//! [`NewExport`] and [`ExportState`] are also what the database holds of an export.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::api::camera_path::NerfstudioWorld;
use crate::api::jobs::JobError;
use crate::api::models::FileView;
use crate::api::renders::EnvironmentSpec;
use crate::api::{ExportId, ModelId};
use crate::render::{
    AlphaMode, Background, ColourDepth, FrameFormat, MOST_BAKED_DEGREE, Output, Primaries, Shown, Tier,
    ToneCurve,
};

/// What to make of a model; `kind` says which of the three it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(untagged)]
pub enum NewExport {
    /// Frames.
    Frames(Box<FramesExport>),
    /// Gaussians for other programs.
    Splats(SplatsExport),
    /// A surface.
    Mesh(MeshExport),
}

impl NewExport {
    /// Its kind.
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
        }
    }
}

/// Kinds of exports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(
    feature = "server",
    derive(utoipa::ToSchema, sqlx::Type),
    sqlx(type_name = "text", rename_all = "snake_case")
)]
#[serde(rename_all = "snake_case")]
pub enum ExportKind {
    /// A sequence of frames: a zip or a video.
    Frames,
    /// glTF with KHR_gaussian_splatting, `.glb`.
    Gltf,
    /// OpenUSD as text, `.usda`.
    Usd,
    /// OpenUSD in a package, `.usdz`.
    Usdz,
    /// PLY.
    Ply,
    /// The surface as triangles with textures, `.glb`.
    Mesh,
}

impl ExportKind {
    /// Its name in requests.
    pub fn name(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Gltf => "gltf",
            Self::Usd => "usd",
            Self::Usdz => "usdz",
            Self::Ply => "ply",
            Self::Mesh => "mesh",
        }
    }
}

/// The kind of a [`FramesExport`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum FramesKind {
    /// A sequence of frames.
    #[default]
    Frames,
}

/// A sequence of frames, as `relume render --turntable` and `--path` make it. It has either `turntable` or `path`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct FramesExport {
    /// `frames`.
    pub kind: FramesKind,
    /// Cameras on a circle around the model.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub turntable: Option<TurntableSpec>,
    /// Cameras, one for each frame, at most 10,000: an object with `cameras` (as an answer of `/v1/captures/{id}/cameras`), nerfstudio's
    /// `camera_path`, or the `frames` of a transforms.json.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(value_type = Option<Object>))]
    pub path: Option<Value>,
    /// nerfstudio's dataparser_transforms.json of the training that a `camera_path` was made in.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub path_world: Option<NerfstudioWorld>,
    /// Under which light; the light of the capture when absent. An inline map is not taken.
    #[serde(default)]
    pub environment: EnvironmentSpec,
    /// How far the light turns from the first frame to after the last, beside `environment.rotation_deg`, degrees counter-clockwise.
    #[serde(default)]
    pub environment_turn_deg: f64,
    /// 1 to 4096 pixels, with `height`. When absent 512 for a turntable, and what a path states.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(minimum = 1, maximum = 4096))]
    pub width: Option<u32>,
    /// 1 to 4096 pixels, with `width`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(minimum = 1, maximum = 4096))]
    pub height: Option<u32>,
    /// `preview`, `standard` (the default), `high` or `monte_carlo`.
    #[serde(default)]
    #[cfg_attr(feature = "server", schema(value_type = String, example = "standard"))]
    pub tier: Tier,
    /// Directions a pixel that the tier `monte_carlo` draws, as in a render.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(minimum = 1, maximum = 65536))]
    pub samples: Option<u32>,
    /// Seed of those directions; 0 when absent.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub seed: Option<u64>,
    /// As in a render; `["rgb"]` when absent. PNG and JPEG hold one, EXR holds all.
    #[serde(default = "rgb_only")]
    #[cfg_attr(feature = "server", schema(value_type = Vec<String>, example = json!(["rgb"])))]
    pub outputs: Vec<Output>,
    /// `png` (the default), `jpeg` or `exr`.
    #[serde(default)]
    pub format: FrameFormat,
    /// As in a render. A video has no alpha: it shows white where that is `transparent`.
    #[serde(default)]
    #[cfg_attr(feature = "server", schema(value_type = String, example = "transparent"))]
    pub background: Background,
    /// As in a render.
    #[serde(default)]
    #[cfg_attr(feature = "server", schema(value_type = String, pattern = "^(srgb|neutral|agx|linear)$", example = "srgb"))]
    pub tone_curve: ToneCurve,
    /// How an EXR stores colours: `float` (the default) or `half`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(inline))]
    pub colour_depth: Option<ColourDepth>,
    /// Colours of an EXR: `premultiplied` (the default) or `straight`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>, pattern = "^(premultiplied|straight)$"))]
    pub alpha: Option<AlphaMode>,
    /// Primaries of an EXR's colours: `rec709` (the default) or `acescg`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>, pattern = "^(rec709|acescg)$"))]
    pub primaries: Option<Primaries>,
    /// `zip` (the default) or `mp4`, for which the server needs ffmpeg.
    #[serde(default)]
    pub package: Package,
    /// Frames a second, 1 to 100,000: of a video, at most 240 and 24 when absent; an EXR notes it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(minimum = 1, maximum = 100_000))]
    pub frames_per_second: Option<u32>,
}

impl FramesExport {
    /// So many frames around a model, with everything else left out.
    pub fn turntable(frames: u32) -> Self {
        let turntable =
            TurntableSpec { frames, azimuth_deg: None, elevation_deg: None, camera_turn_deg: full_turn() };
        Self { turntable: Some(turntable), outputs: rgb_only(), ..Self::default() }
    }
}

/// Cameras on a circle around a model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct TurntableSpec {
    /// 1 to 10,000.
    #[cfg_attr(feature = "server", schema(minimum = 1, maximum = 10_000))]
    pub frames: u32,
    /// Of the first frame, degrees counter-clockwise seen from above; as in a thumbnail when absent.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub azimuth_deg: Option<f64>,
    /// Degrees above the horizon, -90 to 90; as in a thumbnail when absent.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(minimum = -90, maximum = 90))]
    pub elevation_deg: Option<f64>,
    /// How far the camera turns from the first frame to after the last, degrees counter-clockwise; 360 when absent, 0 for a camera
    /// that stands still.
    #[serde(default = "full_turn")]
    pub camera_turn_deg: f64,
}

/// What frames come in.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Package {
    /// A zip of numbered image files.
    #[default]
    Zip,
    /// A video, H.264.
    Mp4,
}

/// The kind of a [`SplatsExport`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum SplatsKind {
    /// glTF with KHR_gaussian_splatting, `.glb`.
    Gltf,
    /// OpenUSD as text, `.usda`.
    Usd,
    /// OpenUSD in a package, `.usdz`.
    Usdz,
    /// PLY.
    Ply,
}

/// Gaussians for other programs, as `relume export` makes them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct SplatsExport {
    /// `gltf`, `usd`, `usdz` or `ply`.
    pub kind: SplatsKind,
    /// What the colour shows: `radiance` (the photographs), `relit`, `albedo`, `normal`, `roughness` or `metallic`. When absent
    /// `relit` with an `environment`, else `radiance`; a PLY then has the materials as well.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>, pattern = "^(radiance|relit|albedo|normal|roughness|metallic)$"))]
    pub layer: Option<Shown>,
    /// The light of `relit`; that of the capture when absent. An inline map is not taken.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub environment: Option<EnvironmentSpec>,
    /// SH degree of `relit`, 0 to 3: how much of the highlights follows the camera; 3 when absent.
    #[serde(default = "most_degree")]
    #[cfg_attr(feature = "server", schema(minimum = 0, maximum = 3))]
    pub relit_degree: u32,
    /// Turn each Gaussian until its shortest axis is its shading normal, for programs that take that axis for the normal.
    #[serde(default)]
    pub flatten: bool,
}

impl SplatsExport {
    /// Of a kind, with everything else left out.
    pub fn of(kind: SplatsKind) -> Self {
        Self { kind, layer: None, environment: None, relit_degree: most_degree(), flatten: false }
    }
}

/// The kind of a [`MeshExport`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum MeshKind {
    /// The surface.
    #[default]
    Mesh,
}

/// The surface as triangles with textures in a `.glb`, as `relume export --mesh` makes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct MeshExport {
    /// `mesh`.
    pub kind: MeshKind,
    /// Cells of the grid behind it along the model's world, 16 to 512; 192 when absent.
    #[serde(default = "cells")]
    #[cfg_attr(feature = "server", schema(minimum = 16, maximum = 512))]
    pub cells: u32,
}

/// Where an export stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(
    feature = "server",
    derive(utoipa::ToSchema, sqlx::Type),
    sqlx(type_name = "text", rename_all = "snake_case")
)]
pub enum ExportState {
    /// It waits.
    Queued,
    /// It is being made.
    Running,
    /// Its file is there.
    Succeeded,
    /// It cannot be made; the error says why.
    Failed,
    /// Stopped on request.
    Cancelled,
}

impl ExportState {
    /// Whether it will not change any more.
    pub fn is_terminal(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }
}

/// How much of an export is done.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema, sqlx::FromRow))]
pub struct ExportProgress {
    /// Frames that are there; of other kinds 0, or 1 in the end.
    pub done: i64,
    /// Frames in all; of other kinds 1.
    pub total: i64,
}

/// An export.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct ExportView {
    /// Identifier.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub id: ExportId,
    /// The model that it is made of.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub model: ModelId,
    /// What is made.
    pub kind: ExportKind,
    /// Where it stands.
    pub state: ExportState,
    /// How much is done.
    pub progress: ExportProgress,
    /// The file, once it succeeded.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub file: Option<FileView>,
    /// Why it failed.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub error: Option<JobError>,
    /// RFC 3339.
    pub created_at: String,
    /// RFC 3339; when it was begun first.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub started_at: Option<String>,
    /// RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub finished_at: Option<String>,
}

fn rgb_only() -> Vec<Output> {
    vec![Output::Rgb]
}

fn full_turn() -> f64 {
    360.0
}

fn most_degree() -> u32 {
    MOST_BAKED_DEGREE as u32
}

fn cells() -> u32 {
    192
}
