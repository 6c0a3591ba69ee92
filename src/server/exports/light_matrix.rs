//! Exports of light matrices: a multi-part EXR for each camera, written strip by strip into the work folder. Finished files stay there,
//! so that the next server can continue after a stop.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;

use crate::server::app::AppState;
use crate::server::exports::export_error::ExportError;
use crate::server::exports::frames::frame_name;
use crate::server::exports::light::light;
use crate::server::exports::work_folder::{bytes_there, prepared, record, run_blocking, write_whole};
use crate::server::exports::{model, plan, splats, zip};
use crate::server::memory::light_matrix_bytes;
use crate::server::models;
use crate::server::problem::Problem;
use crate::store::{ExportRecord, ExportedFile};
use crate::worker::LightSource;
use relume_api::TenantId;
use relume_api::exports::LightMatrixExport;
use relume_capture::Up;
use relume_capture::formats::exr_matrix::MatrixFileError;
use relume_scene::light::{LightLobes, MAX_LOBES, dominant_lights};
use relume_scene::{Camera, MAX_LIGHTS, Model, SplitLight};
use relume_spec::rendering::{ColourDepth, FrameFormat};
use relume_train::render::{FrameMetadata, MatrixLights, RenderError, Renderer};

/// Maximum number of lobes times pixels of a camera.
const MAX_LOBE_PIXELS: u64 = 1 << 28;
/// Maximum number of lobes times pixels of all cameras together.
const MAX_LOBE_PIXELS_OF_ALL: u64 = 1 << 32;
/// Time after which work on a camera path lets other files use its thread.
const SLICE: Duration = Duration::from_secs(30);

/// A validated light matrix.
pub(super) struct MatrixPlan {
    cameras: Vec<Camera>,
    /// Whether the result is a zip.
    is_path: bool,
    lobes: usize,
    /// Light whose strong small lights get a frame each, and its rotation, degrees.
    light: Option<(LightSource, f64)>,
    depth: ColourDepth,
}

impl MatrixPlan {
    /// The plan of a request, for a model whose capture was imported with `up`.
    ///
    /// # Errors
    /// 422, which names the field.
    pub(super) async fn of(
        app: &AppState,
        tenant: &TenantId,
        spec: &LightMatrixExport,
        up: Up,
    ) -> Result<Self, Problem> {
        let cameras = cameras(spec, up)?;
        check_lobes(spec.lobes, &cameras)?;
        let light = match &spec.environment {
            None => None,
            Some(environment) if environment.exposure_ev != 0.0 => {
                let detail =
                    "must be 0: frames of a light matrix have no exposure; multiply the weights instead";
                return Err(Problem::invalid_field("/environment/exposure_ev", detail));
            }
            Some(environment) => Some((light(app, tenant, environment).await?, environment.rotation_deg)),
        };
        let depth = spec.colour_depth.unwrap_or(ColourDepth::Half);
        Ok(Self { cameras, is_path: spec.path.is_some(), lobes: spec.lobes as usize, light, depth })
    }

    /// Number of cameras.
    pub(super) fn cameras(&self) -> usize {
        self.cameras.len()
    }

    /// Greatest size of the file of a camera, bytes, without its header.
    fn most_bytes(&self) -> u64 {
        let channels = 3 * (self.lobes + self.light.as_ref().map_or(0, |_| MAX_LIGHTS)) as u64 + 1;
        let of_value = if self.depth == ColourDepth::Half { 2 } else { 4 };
        channels * self.cameras.iter().map(pixels).max().unwrap_or(0) * of_value
    }

    /// The strong small lights of the environment.
    fn suns(&self, model: &Model) -> Result<Vec<SplitLight>, ExportError> {
        let Some((source, rotation_deg)) = &self.light else { return Ok(Vec::new()) };
        let unreadable = |why| ExportError::failed(format!("the environment cannot be read: {why}"));
        let light = source.illumination(model).map_err(unreadable)?;
        let light = light.rotated_and_scaled(*rotation_deg, 1.0);
        Ok(dominant_lights(&light).1.iter().map(SplitLight::from).collect())
    }

    /// Writes the missing files of `model`, named `name`, into `folder` in order, for about [`SLICE`]. Returns the number of files that
    /// are there then, from the first on.
    fn write(
        &self,
        model: Model,
        name: &str,
        folder: &Path,
        token: &CancellationToken,
    ) -> Result<usize, ExportError> {
        if !model.has_materials() {
            return Err(ExportError::failed("the model has no materials, so it cannot be relit"));
        }
        let start = Instant::now();
        let suns = self.suns(&model)?;
        let renderer = Renderer::new(model.into());
        let lights = renderer.matrix_lights(&LightLobes::new(self.lobes), suns);
        for (index, camera) in self.cameras.iter().enumerate() {
            let file = PathBuf::from(file_name(index));
            if folder.join(&file).exists() {
                continue;
            }
            self.write_one((&renderer, camera), &lights, name, (folder, &file), token)?;
            if start.elapsed() > SLICE {
                return Ok(index + 1);
            }
        }
        Ok(self.cameras.len())
    }

    fn write_one(
        &self,
        (renderer, camera): (&Renderer, &Camera),
        lights: &MatrixLights,
        name: &str,
        (folder, file): (&Path, &Path),
        token: &CancellationToken,
    ) -> Result<(), ExportError> {
        let metadata = FrameMetadata {
            model: name.to_owned(),
            light: self.light.as_ref().map(|(source, _)| source.key()).unwrap_or_default(),
            rotation_deg: self.light.as_ref().map_or(0.0, |(_, rotation_deg)| *rotation_deg),
            ..FrameMetadata::default()
        };
        let refused = |error: RenderError| ExportError::failed(error.to_string());
        let frames = renderer.light_matrix(camera, lights).map_err(refused)?;
        write_whole(folder, file, |file| {
            frames.write(file, self.depth, &metadata, &|_| !token.is_cancelled()).map_err(failed)
        })
    }

    fn files(&self) -> Vec<PathBuf> {
        (0..self.cameras.len()).map(|index| file_name(index).into()).collect()
    }
}

/// Makes the file of a light matrix, or a zip of files.
pub(super) async fn make(
    app: &AppState,
    export: &ExportRecord,
    spec: &LightMatrixExport,
    token: &CancellationToken,
) -> Result<ExportedFile, ExportError> {
    let up = models::world_of(app, &export.tenant, &export.model_id).await?;
    let plan = Arc::new(MatrixPlan::of(app, &export.tenant, spec, up).await?);
    let (source, sha256) = model::source(app, export, &spec.materials).await?;
    let folder = prepared(app, export, sha256).await?;
    let width = plan.cameras.iter().map(|camera| camera.width).max().unwrap_or(0);
    let bytes_of = |size| light_matrix_bytes(size, spec.lobes, width);
    let files = plan.files();
    let mut recorded = bytes_there(&folder, &files).await;
    loop {
        app.store.admit_bytes(plan.most_bytes()).await?;
        let (plan, at, name, token) =
            (plan.clone(), folder.clone(), export.model_id.to_string(), token.clone());
        let cameras = plan.cameras();
        let work = move |model| plan.write(model, &name, &at, &token);
        let threads = &app.exports.file_threads;
        let done = splats::with_model(app, threads, &export.tenant, (&source, &bytes_of), work).await?;
        let bytes = bytes_there(&folder, &files[..done]).await;
        record(app, export, done, bytes, recorded).await?;
        recorded = bytes;
        if done == cameras {
            break;
        }
    }
    let model = &export.model_id;
    if !plan.is_path {
        let (path, name) = (folder.join(file_name(0)), format!("{model}-light-matrix.exr"));
        return Ok(ExportedFile { path, name, content_type: "image/x-exr" });
    }
    // The disk contains both for a while; the quota of the tenant counts only one of them.
    app.store.admit_bytes(recorded).await?;
    let path = folder.join("matrices.zip");
    let (to, names, token) =
        (path.clone(), (0..plan.cameras()).map(file_name).collect::<Vec<_>>(), token.clone());
    run_blocking(move || Ok(zip::pack(&folder, &names, &to, &|| !token.is_cancelled())?)).await?;
    Ok(ExportedFile { path, name: format!("{model}-light-matrix.zip"), content_type: "application/zip" })
}

/// The cameras of a request.
fn cameras(spec: &LightMatrixExport, up: Up) -> Result<Vec<Camera>, Problem> {
    let size = plan::size_of(spec.width, spec.height)?;
    match (&spec.camera, &spec.path) {
        (Some(camera), None) => {
            let refused = |error: relume_api::problem::FieldError| {
                Problem::invalid_field(format!("/camera{}", error.pointer), error.detail)
            };
            Ok(vec![camera.camera(size.unwrap_or(plan::SIZE)).map_err(refused)?])
        }
        (None, Some(json)) => {
            let views = plan::path((json, spec.path_world.as_ref()), size, up)?;
            let is_turned = |degrees: f64| degrees.rem_euclid(360.0) != 0.0;
            let turned = views.iter().position(|view| is_turned(view.light_rotation_deg));
            match (turned, &spec.environment) {
                (Some(i), Some(_)) => {
                    let detail = format!(
                        "camera {} turns the light, but the small lights of the environment have one place in all files; omit environment or light_rotation_deg",
                        i + 1
                    );
                    Err(Problem::invalid_field("/path", detail))
                }
                _ => Ok(views.iter().map(|view| view.camera).collect()),
            }
        }
        (Some(_), Some(_)) => Err(Problem::invalid_field("/path", "must not be combined with camera")),
        (None, None) => Err(Problem::invalid_field("/camera", "either camera or path is required")),
    }
}

/// Refuses a number of lobes with which the images would be too large.
fn check_lobes(lobes: u32, cameras: &[Camera]) -> Result<(), Problem> {
    let largest = cameras.iter().map(pixels).max().unwrap_or(0).max(1);
    let all = cameras.iter().map(pixels).sum::<u64>().max(1);
    let most = (MAX_LOBE_PIXELS / largest).min(MAX_LOBE_PIXELS_OF_ALL / all).min(MAX_LOBES as u64);
    if (1..=most).contains(&u64::from(lobes)) {
        return Ok(());
    }
    let detail = match most {
        0 => format!(
            "a light matrix has at most {MAX_LOBE_PIXELS_OF_ALL} pixels in all cameras and lobes; reduce the size or the number of cameras"
        ),
        most => format!("must be 1 to {most} for these cameras and sizes, got {lobes}"),
    };
    Err(Problem::invalid_field("/lobes", detail))
}

fn pixels(camera: &Camera) -> u64 {
    u64::from(camera.width) * u64::from(camera.height)
}

fn file_name(index: usize) -> String {
    frame_name(index, FrameFormat::Exr)
}

fn failed(error: MatrixFileError) -> ExportError {
    match error {
        MatrixFileError::Abandoned => ExportError::Unwanted,
        MatrixFileError::Io(error) => error.into(),
        MatrixFileError::Encode(error) => ExportError::failed(error.to_string()),
    }
}
