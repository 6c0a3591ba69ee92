//! A validated request for a sequence of frames: cameras, light, quality and encoding.

use serde_json::Value;

use crate::camera_path::path_views;
use crate::server::app::AppState;
use crate::server::exports::light::light;
use crate::server::exports::video;
use crate::server::problem::Problem;
use crate::server::render_request::{
    check_finish, check_ground, check_lamps, check_outputs, check_sides, quality,
};
use crate::worker::LightSource;
use relume_api::exports::{FramesExport, Package, TurntableSpec};
use relume_api::{NerfstudioWorld, TenantId};
use relume_capture::Up;
use relume_scene::Model;
use relume_spec::rendering::{Background, FrameFormat, Quality, ToneCurve, is_colour};
use relume_train::render::{
    EncodeOptions, FrameMetadata, FrameView, Turntable, linked, resized, rotate_light,
};

/// Maximum number of frames of an export.
const MOST_FRAMES: usize = 10_000;
/// Size of frames without a given size, pixels.
pub(super) const SIZE: (u32, u32) = (512, 512);
/// Maximum frames per second of a video.
const MOST_FPS: u32 = 240;

/// A validated sequence of frames.
pub(super) struct FramesPlan {
    pub(super) light: LightSource,
    pub(super) quality: Quality,
    /// The encoding of all frames, without the metadata of a single frame.
    pub(super) encoding: EncodeOptions,
    pub(super) format: FrameFormat,
    cameras: Cameras,
    environment_turn_deg: f64,
}

enum Cameras {
    Turntable(Turntable),
    Path(Vec<FrameView>),
}

impl FramesPlan {
    /// The plan for a model whose capture was imported with `up`.
    ///
    /// # Errors
    /// 422, which names the field.
    pub(super) async fn of(
        app: &AppState,
        tenant: &TenantId,
        spec: &FramesExport,
        up: Up,
    ) -> Result<Self, Problem> {
        let cameras = cameras(spec, up)?;
        check_outputs(&spec.outputs, spec.format)?;
        check_ground(spec.ground_height, &spec.outputs)?;
        check_lamps(&spec.lamps, &spec.outputs, (spec.tier, cameras.largest()))?;
        if !spec.environment_turn_deg.is_finite() {
            return Err(Problem::invalid_field("/environment_turn_deg", "must be finite"));
        }
        if spec.frames_per_second.is_some_and(|fps| !(1..=100_000).contains(&fps)) {
            return Err(Problem::invalid_field("/frames_per_second", "must be 1 to 100000"));
        }
        let quality = quality(spec.tier, spec.samples, spec.seed, cameras.largest(), app.device.has_gpu())?;
        let encoding = finish(spec);
        check_finish(&encoding, &spec.outputs, spec.format)?;
        if spec.package == Package::Mp4 {
            check_video(app, spec, &cameras)?;
        }
        let light = light(app, tenant, &spec.environment).await?;
        let (format, environment_turn_deg) = (spec.format, spec.environment_turn_deg);
        Ok(Self { light, quality, encoding, format, cameras, environment_turn_deg })
    }

    /// Number of frames.
    pub(super) fn frames(&self) -> usize {
        match &self.cameras {
            Cameras::Turntable(turntable) => turntable.frames as usize,
            Cameras::Path(views) => views.len(),
        }
    }

    /// Whether the cameras depend on the model.
    pub(super) fn needs_model(&self) -> bool {
        matches!(self.cameras, Cameras::Turntable(_))
    }

    /// The views of a camera path.
    pub(super) fn path_views(&self) -> Vec<FrameView> {
        match &self.cameras {
            Cameras::Turntable(_) => Vec::new(),
            Cameras::Path(views) => self.turned(views.clone()),
        }
    }

    /// The views, of `model` if they depend on it.
    ///
    /// # Errors
    /// 422 if a turntable has no valid cameras.
    pub(super) fn views(&self, model: &Model) -> Result<Vec<FrameView>, Problem> {
        let Cameras::Turntable(turntable) = &self.cameras else { return Ok(self.path_views()) };
        let refused = |error: relume_scene::CameraError| {
            Problem::invalid_field(format!("/turntable/{}", error.field), error.reason)
        };
        Ok(self.turned(turntable.views(model).map_err(refused)?))
    }

    fn turned(&self, mut views: Vec<FrameView>) -> Vec<FrameView> {
        rotate_light(&mut views, self.environment_turn_deg);
        linked(views)
    }
}

impl Cameras {
    /// The size of the frame with the most pixels.
    fn largest(&self) -> (u32, u32) {
        let pixels = |(width, height): &(u32, u32)| u64::from(*width) * u64::from(*height);
        match self {
            Self::Turntable(turntable) => turntable.size,
            Self::Path(views) => {
                let sizes = views.iter().map(|view| (view.camera.width, view.camera.height));
                sizes.max_by_key(pixels).unwrap_or(SIZE)
            }
        }
    }
}

/// The size in a request, if it is given.
///
/// # Errors
/// 422, which names the field.
pub(super) fn size_of(width: Option<u32>, height: Option<u32>) -> Result<Option<(u32, u32)>, Problem> {
    let size = match (width, height) {
        (None, None) => None,
        (Some(width), Some(height)) => Some((width, height)),
        (None, Some(_)) => return Err(Problem::invalid_field("/width", "is required with height")),
        (Some(_), None) => return Err(Problem::invalid_field("/height", "is required with width")),
    };
    size.map_or(Ok(()), check_sides)?;
    Ok(size)
}

fn cameras(spec: &FramesExport, up: Up) -> Result<Cameras, Problem> {
    let size = size_of(spec.width, spec.height)?;
    match (&spec.turntable, &spec.path) {
        (Some(table), None) => turntable(table, size.unwrap_or(SIZE)).map(Cameras::Turntable),
        (None, Some(json)) => path((json, spec.path_world.as_ref()), size, up).map(Cameras::Path),
        (Some(_), Some(_)) => Err(Problem::invalid_field("/path", "must not be combined with turntable")),
        (None, None) => Err(Problem::invalid_field("/turntable", "either turntable or path is required")),
    }
}

fn turntable(spec: &TurntableSpec, size: (u32, u32)) -> Result<Turntable, Problem> {
    let refused = |field: &str, why: String| Err(Problem::invalid_field(format!("/turntable/{field}"), why));
    let &TurntableSpec { frames, azimuth_deg, elevation_deg, camera_turn_deg } = spec;
    if !(1..=MOST_FRAMES).contains(&(frames as usize)) {
        return refused("frames", format!("must be 1 to {MOST_FRAMES}, got {frames}"));
    }
    if !azimuth_deg.is_none_or(f64::is_finite) {
        return refused("azimuth_deg", "must be finite".to_owned());
    }
    if !elevation_deg.is_none_or(|degrees| (-90.0..=90.0).contains(&degrees)) {
        return refused("elevation_deg", "must be -90 to 90".to_owned());
    }
    if !camera_turn_deg.is_finite() {
        return refused("camera_turn_deg", "must be finite".to_owned());
    }
    Ok(Turntable { frames, azimuth_deg, elevation_deg, camera_turn_deg, size })
}

/// The views of a camera path, scaled to `size` if it is given.
///
/// # Errors
/// 422, which names the field of `path` or `path_world`.
pub(in crate::server) fn path(
    (json, world): (&Value, Option<&NerfstudioWorld>),
    size: Option<(u32, u32)>,
    up: Up,
) -> Result<Vec<FrameView>, Problem> {
    let refused = |pointer: String, why: String| Problem::invalid_field(format!("/path{pointer}"), why);
    if let Some(world) = world {
        world.check().map_err(|why| Problem::invalid_field("/path_world", why))?;
    }
    let views = path_views(json, size.unwrap_or(SIZE), world, up);
    let views = views.map_err(|error| refused(error.pointer, error.detail))?;
    if !(1..=MOST_FRAMES).contains(&views.len()) {
        let why = format!("must have 1 to {MOST_FRAMES} cameras, got {}", views.len());
        return Err(refused(String::new(), why));
    }
    let views = match size {
        Some(size) => resized(views, size)
            .map_err(|(i, why)| refused(String::new(), format!("camera {} {why}", i + 1)))?,
        None => views,
    };
    for (i, view) in views.iter().enumerate() {
        let sides = check_sides((view.camera.width, view.camera.height));
        sides.map_err(|_| refused(String::new(), format!("camera {} is larger than 4096 pixels", i + 1)))?;
    }
    Ok(views)
}

/// The encoding of frames. A video has no alpha, so its background is white as in a JPEG.
fn finish(spec: &FramesExport) -> EncodeOptions {
    let shows_colour = spec.outputs.first().is_some_and(|output| is_colour(*output));
    let background = match (spec.background, spec.package) {
        (Background::Transparent, Package::Mp4) if shows_colour => Background::Colour([255; 3]),
        (background, _) => background,
    };
    EncodeOptions {
        background,
        tone_curve: spec.tone_curve,
        colour_depth: spec.colour_depth,
        alpha: spec.alpha,
        primaries: spec.primaries,
        frame_metadata: FrameMetadata {
            frames_per_second: spec.frames_per_second,
            ..FrameMetadata::default()
        },
    }
}

fn check_video(app: &AppState, spec: &FramesExport, cameras: &Cameras) -> Result<(), Problem> {
    let refused = |field: &str, why: &str| Err(Problem::invalid_field(field, why));
    if video::find(&app.exports.policy.ffmpeg).is_none() {
        let why = "mp4 requires ffmpeg, which is not installed on this server; use zip, or ask the operator to install ffmpeg";
        return refused("/package", why);
    }
    if spec.format == FrameFormat::Exr {
        return refused("/format", "must be png or jpeg for a video");
    }
    if spec.tone_curve == ToneCurve::Linear {
        return refused("/tone_curve", "must not be linear for a video");
    }
    if spec.frames_per_second.is_some_and(|fps| fps > MOST_FPS) {
        return refused("/frames_per_second", &format!("must be 1 to {MOST_FPS} for a video"));
    }
    let (width, height) = cameras.largest();
    let is_stated = spec.width.is_some() || spec.turntable.is_some();
    for (field, side) in [("/width", width), ("/height", height)] {
        if !side.is_multiple_of(2) {
            return refused(if is_stated { field } else { "/path" }, "must be even for a video");
        }
    }
    if let Cameras::Path(views) = cameras
        && views.iter().any(|view| (view.camera.width, view.camera.height) != (width, height))
    {
        return refused(
            "/path",
            "has cameras of different sizes, but a video has one size: set width and height",
        );
    }
    Ok(())
}
