//! Exports of light matrices: one multi-part EXR, written strip by strip into the work folder.

use std::fs::File;
use std::io::BufWriter;

use tokio_util::sync::CancellationToken;

use crate::server::app::AppState;
use crate::server::exports::export_error::ExportError;
use crate::server::exports::light::light;
use crate::server::exports::splats;
use crate::server::memory::light_matrix_bytes;
use crate::server::models;
use crate::server::problem::Problem;
use crate::server::render_request::check_sides;
use crate::store::{ExportRecord, ExportedFile, make_private};
use crate::worker::LightSource;
use relume_api::TenantId;
use relume_api::exports::LightMatrixExport;
use relume_capture::formats::exr_matrix::MatrixFileError;
use relume_scene::light::{LightLobes, MAX_LOBES, dominant_lights};
use relume_scene::{Camera, MAX_LIGHTS, Model, SplitLight};
use relume_spec::rendering::ColourDepth;
use relume_train::render::{FrameMetadata, RenderError, Renderer};

/// Maximum number of lobes times pixels.
const MAX_LOBE_PIXELS: u64 = 1 << 28;

/// A validated light matrix.
#[derive(Clone)]
pub(super) struct MatrixPlan {
    camera: Camera,
    lobes: usize,
    /// Light whose strong small lights get a frame each, and its rotation, degrees.
    light: Option<(LightSource, f64)>,
    depth: ColourDepth,
}

impl MatrixPlan {
    /// The plan of a request.
    ///
    /// # Errors
    /// 422, which names the field.
    pub(super) async fn of(
        app: &AppState,
        tenant: &TenantId,
        spec: &LightMatrixExport,
    ) -> Result<Self, Problem> {
        let size = (spec.width, spec.height);
        check_sides(size)?;
        let most = MAX_LOBE_PIXELS / (u64::from(size.0) * u64::from(size.1)).max(1);
        let most = most.min(MAX_LOBES as u64);
        if !(1..=most).contains(&u64::from(spec.lobes)) {
            let detail = match most {
                0 => format!(
                    "a light matrix has at most {MAX_LOBE_PIXELS} pixels in all lobes; reduce width or height"
                ),
                most => format!("must be 1 to {most} at this width and height, got {}", spec.lobes),
            };
            return Err(Problem::invalid_field("/lobes", detail));
        }
        let refused = |error: relume_api::problem::FieldError| {
            Problem::invalid_field(format!("/camera{}", error.pointer), error.detail)
        };
        let camera = spec.camera.camera(size).map_err(refused)?;
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
        Ok(Self { camera, lobes: spec.lobes as usize, light, depth })
    }

    /// Greatest size of the file, bytes, without its header.
    fn most_bytes(&self) -> u64 {
        let channels = 3 * (self.lobes + self.light.as_ref().map_or(0, |_| MAX_LIGHTS)) as u64 + 1;
        let pixels = u64::from(self.camera.width) * u64::from(self.camera.height);
        let of_value = if self.depth == ColourDepth::Half { 2 } else { 4 };
        channels * pixels * of_value
    }

    /// The strong small lights of the environment.
    fn suns(&self, model: &Model) -> Result<Vec<SplitLight>, ExportError> {
        let Some((source, rotation_deg)) = &self.light else { return Ok(Vec::new()) };
        let unreadable = |why| ExportError::failed(format!("the environment cannot be read: {why}"));
        let light = source.illumination(model).map_err(unreadable)?;
        let light = light.rotated_and_scaled(*rotation_deg, 1.0);
        Ok(dominant_lights(&light).1.iter().map(SplitLight::from).collect())
    }

    /// Writes the matrix of `model`, named `name`, into `file`.
    fn write(
        &self,
        model: Model,
        name: String,
        file: File,
        token: &CancellationToken,
    ) -> Result<(), ExportError> {
        if !model.has_materials() {
            return Err(ExportError::failed("the model has no materials, so it cannot be relit"));
        }
        let suns = self.suns(&model)?;
        let renderer = Renderer::new(model.into());
        let lights = renderer.matrix_lights(&LightLobes::new(self.lobes), suns);
        let metadata = FrameMetadata {
            model: name,
            light: self.light.as_ref().map(|(source, _)| source.key()).unwrap_or_default(),
            rotation_deg: self.light.as_ref().map_or(0.0, |(_, rotation_deg)| *rotation_deg),
            ..FrameMetadata::default()
        };
        let refused = |error: RenderError| ExportError::failed(error.to_string());
        let frames = renderer.light_matrix(&self.camera, &lights).map_err(refused)?;
        let mut file = BufWriter::with_capacity(1 << 20, file);
        frames.write(&mut file, self.depth, &metadata, &|_| !token.is_cancelled()).map_err(failed)?;
        let file = file.into_inner().map_err(std::io::IntoInnerError::into_error)?;
        Ok(file.sync_all()?)
    }
}

/// Makes the file of a light matrix.
pub(super) async fn make(
    app: &AppState,
    export: &ExportRecord,
    spec: &LightMatrixExport,
    token: &CancellationToken,
) -> Result<ExportedFile, ExportError> {
    let plan = MatrixPlan::of(app, &export.tenant, spec).await?;
    app.store.admit_bytes(plan.most_bytes()).await?;
    let (source, _) = models::source(app, &export.tenant, &export.model_id).await?;
    let folder = app.store.export_folder(&export.id);
    make_private(&folder)?;
    let path = folder.join("file");
    let (at, name, token) = (path.clone(), export.model_id.to_string(), token.clone());
    let bytes_of = |size| light_matrix_bytes(size, spec.lobes, spec.width);
    splats::with_model(app, &app.exports.file_threads, &export.tenant, (&source, &bytes_of), move |model| {
        plan.write(model, name, File::create(&at)?, &token)
    })
    .await?;
    app.store.admit_bytes_of(&export.tenant, tokio::fs::metadata(&path).await?.len()).await?;
    let name = format!("{}-light-matrix.exr", export.model_id);
    Ok(ExportedFile { path, name, content_type: "image/x-exr" })
}

fn failed(error: MatrixFileError) -> ExportError {
    match error {
        MatrixFileError::Abandoned => ExportError::Unwanted,
        MatrixFileError::Io(error) => error.into(),
        MatrixFileError::Encode(error) => ExportError::failed(error.to_string()),
    }
}
