//! Exports of photographs without their light. Finished files stay in the work folder, so that the next server can continue after a stop.

use std::collections::HashSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;

use crate::server::app::AppState;
use crate::server::exports::export_error::{BusyRetry, ExportError};
use crate::server::exports::work_folder::{bytes_there, prepared, record, run_blocking, write_whole};
use crate::server::exports::{model, splats, zip};
use crate::server::memory::{MemoryPermit, export_bytes};
use crate::server::problem::Problem;
use crate::server::{models, photographs};
use crate::store::{CaptureRecord, ExportRecord, ExportedFile, ModelRecord};
use crate::worker::ModelContent;
use relume_api::TenantId;
use relume_api::exports::DelightExport;
use relume_capture::{Capture, CaptureError, CaptureView, ImportOptions, UndecodedCapture};
use relume_engine::Device;
use relume_scene::Model;
use relume_spec::rendering::LayerFormat;
use relume_train::delight::{Delighter, file_stems, layer_path, layers_of};
use relume_train::{import_options_of_card, light_like_card};

/// Permitted longest sides of the layers, pixels.
const SIDES: std::ops::RangeInclusive<u32> = 16..=8192;
/// Maximum number of named photographs.
const MAX_NAMES: usize = 10_000;
/// Bytes of memory per pixel of the photograph whose layers are computed.
const LAYER_PIXEL: u64 = 250;
/// Maximum bytes of the files of a photograph per pixel: 16 half floats.
const FILE_PIXEL: u64 = 32;
/// Time after which the work lets other files use its thread.
const SLICE: Duration = Duration::from_secs(30);

/// Checks that an export of a model can be made. Returns the number of its photographs.
///
/// # Errors
/// 422, which names the field; 409 if the capture of the model was deleted.
pub(super) async fn check(
    app: &AppState,
    tenant: &TenantId,
    model: &ModelRecord,
    spec: &DelightExport,
) -> Result<i64, Problem> {
    if spec.resolution.is_some_and(|side| !SIDES.contains(&side)) {
        return Err(Problem::invalid_field("/resolution", "must be 16 to 8192"));
    }
    let capture = capture_of(app, tenant, model).await?;
    let count = match &spec.photographs {
        None => capture.report.train_images + capture.report.test_images,
        Some(names) => {
            if !(1..=MAX_NAMES).contains(&names.len()) {
                return Err(Problem::invalid_field("/photographs", "must have 1 to 10000 names"));
            }
            let opened = photographs::open(app, tenant, &capture).await?;
            if let Some(i) = names.iter().position(|name| !opened.photographs.contains(name)) {
                let detail = format!("{:?} is not a photograph of the model's capture", names[i]);
                return Err(Problem::invalid_field(format!("/photographs/{i}"), detail));
            }
            names.iter().collect::<HashSet<_>>().len()
        }
    };
    Ok(i64::try_from(count).unwrap_or(i64::MAX))
}

/// The capture of a model.
async fn capture_of(
    app: &AppState,
    tenant: &TenantId,
    model: &ModelRecord,
) -> Result<CaptureRecord, Problem> {
    let deleted = || {
        let detail = format!(
            "capture {:?} was deleted, and with it the photographs of this model; download model.safetensors and run `relume delight` \
             with the photographs, or train the capture again",
            model.capture_id.as_str()
        );
        Problem::conflict("capture-deleted", detail)
    };
    app.store.capture(tenant, &model.capture_id).await?.ok_or_else(deleted)
}

/// Makes a zip of the layers.
pub(super) async fn make(
    app: &AppState,
    export: &ExportRecord,
    spec: &DelightExport,
    token: &CancellationToken,
) -> Result<ExportedFile, ExportError> {
    let (source, sha256) = model::source(app, export, &[]).await?;
    let folder = prepared(app, export, sha256).await?;
    let ModelContent::File(path) = &source.content else {
        return Err(ExportError::failed("the model is not a file"));
    };
    let model_bytes = export_bytes(tokio::fs::metadata(path).await?.len(), 0);
    let plan = Arc::new(LayersPlan::read(app, export, spec, model_bytes).await?);
    let files = plan.files();
    let mut recorded = bytes_there(&folder, &files).await;
    loop {
        app.store.admit_bytes(plan.most_bytes()).await?;
        let (of, at, stop) = (plan.clone(), folder.clone(), token.clone());
        let work = move |model| of.write(model, &at, &stop);
        let threads = &app.exports.file_threads;
        // The memory is reserved already.
        let done = splats::with_model(app, threads, &export.tenant, (&source, &|_| 0), work).await?;
        let bytes = bytes_there(&folder, &files).await;
        record(app, export, done, bytes, recorded).await?;
        recorded = bytes;
        if done == plan.photographs.len() {
            break;
        }
    }
    // The disk contains both for a while; the quota of the tenant counts only one of them.
    app.store.admit_bytes(recorded).await?;
    let path = folder.join("layers.zip");
    let (to, token) = (path.clone(), token.clone());
    let names: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
    run_blocking(move || Ok(zip::pack(&folder, &names, &to, &|| !token.is_cancelled())?)).await?;
    Ok(ExportedFile {
        path,
        name: format!("{}-layers.zip", export.model_id),
        content_type: "application/zip",
    })
}

/// The photographs of an export, and their memory.
struct LayersPlan {
    capture: Capture,
    /// Index of each photograph in the capture, and its file name without an ending.
    photographs: Vec<(usize, String)>,
    format: LayerFormat,
    _memory: MemoryPermit,
}

impl LayersPlan {
    /// Reads the capture of the model, and reserves memory for it and for `model_bytes`.
    async fn read(
        app: &AppState,
        export: &ExportRecord,
        spec: &DelightExport,
        model_bytes: u64,
    ) -> Result<Self, ExportError> {
        let model = models::find(app, &export.tenant, &export.model_id).await?;
        let record = capture_of(app, &export.tenant, &model).await?;
        photographs::verify(app, &export.tenant, &record).await?;
        let path = app.store.artifacts().local_path(&record.artifact);
        let options = import_options_of_card(&model.card, spec.resolution, app.import_limits);
        let options = options.map_err(|error| ExportError::failed(error.to_string()))?;
        let options = ImportOptions { load_truth: false, ..options };
        let open = move || {
            let mut undecoded = UndecodedCapture::open(&path, &options)?;
            let bytes = photograph_bytes(&mut undecoded)?;
            Ok((undecoded, bytes))
        };
        let opened = app.decoders.run(&export.tenant, open).await?;
        let (undecoded, bytes) = opened.map_err(|error: CaptureError| photographs::unreadable(&error))?;
        let memory = reserve(app, bytes + model_bytes).await?;
        let decode = move || {
            let mut capture = undecoded.decode()?;
            light_like_card(&mut capture, &model.card)?;
            Ok(capture)
        };
        let decoded = app.exports.file_threads.run(&export.tenant, decode).await?;
        let capture = decoded.map_err(|error: CaptureError| photographs::unreadable(&error))?;
        let photographs = wanted(&capture, spec.photographs.as_deref())?;
        Ok(Self { capture, photographs, format: spec.format, _memory: memory })
    }

    fn view(&self, index: usize) -> Option<&CaptureView> {
        views(&self.capture).nth(index)
    }

    /// The files of the layers of a photograph, relative to the work folder.
    fn files_of(&self, stem: &str) -> impl Iterator<Item = PathBuf> {
        layers_of(self.format).iter().map(move |layer| layer_path(layer, stem, self.format))
    }

    /// The files of the layers of all photographs.
    fn files(&self) -> Vec<PathBuf> {
        self.photographs.iter().flat_map(|(_, stem)| self.files_of(stem)).collect()
    }

    /// Greatest size of the files of a photograph, bytes, without headers.
    fn most_bytes(&self) -> u64 {
        views(&self.capture).map(|view| view.image.len() as u64 * FILE_PIXEL).max().unwrap_or(0)
    }

    /// Writes missing files into `folder` in order, for about [`SLICE`]. Returns the number of photographs whose files are there then,
    /// from the first on.
    fn write(&self, model: Model, folder: &Path, token: &CancellationToken) -> Result<usize, ExportError> {
        if !model.has_materials() {
            return Err(ExportError::failed(
                "the model has no materials, so photographs cannot be separated",
            ));
        }
        let failed = |error: &dyn std::fmt::Display| ExportError::failed(error.to_string());
        let start = Instant::now();
        let mut delighter = Delighter::new(Arc::new(model), &Device::Cpu).map_err(|error| failed(&error))?;
        for (done, (index, stem)) in self.photographs.iter().enumerate() {
            if token.is_cancelled() {
                return Err(ExportError::Unwanted);
            }
            if self.files_of(stem).all(|file| folder.join(file).exists()) {
                continue;
            }
            if start.elapsed() > SLICE {
                return Ok(done);
            }
            let Some(view) = self.view(*index) else { continue };
            let layers = delighter.delight(view).map_err(|error| failed(&error))?;
            for (layer, bytes) in layers.files(self.format).map_err(|error| failed(&error))? {
                let name = layer_path(layer, stem, self.format);
                write_whole(folder, &name, |file| Ok(file.write_all(&bytes)?))?;
            }
        }
        Ok(self.photographs.len())
    }
}

/// Bytes of all photographs in memory, and of the layers of the largest.
fn photograph_bytes(undecoded: &mut UndecodedCapture) -> Result<u64, CaptureError> {
    let bytes_a_pixel = undecoded.bytes_a_pixel()?;
    let pixels = |(width, height): &(u32, u32)| u64::from(*width) * u64::from(*height);
    let all: u64 = undecoded.sizes().iter().map(pixels).sum();
    let largest = undecoded.sizes().iter().map(pixels).max().unwrap_or(0);
    Ok((all as f64 * bytes_a_pixel).ceil() as u64 + largest * LAYER_PIXEL)
}

/// Reserves memory, and waits while the server is busy.
async fn reserve(app: &AppState, bytes: u64) -> Result<MemoryPermit, ExportError> {
    let busy_retry = BusyRetry::new();
    loop {
        match app.memory.reserve(bytes).await {
            Ok(memory) => return Ok(memory),
            Err(refusal) if refusal.status == 413 => {
                return Err(match ExportError::from(refusal) {
                    ExportError::Failed { code, detail } => ExportError::Failed {
                        code,
                        detail: format!("{detail}; a smaller `resolution` needs less"),
                    },
                    other => other,
                });
            }
            Err(refusal) => busy_retry.wait(refusal).await?,
        }
    }
}

/// The photographs of a capture, training photographs first.
fn views(capture: &Capture) -> impl Iterator<Item = &CaptureView> {
    capture.train.iter().chain(&capture.test)
}

/// Index and file name of the photographs with these names; of all photographs without `names`.
fn wanted(capture: &Capture, names: Option<&[String]>) -> Result<Vec<(usize, String)>, ExportError> {
    let mut stems = file_stems(&views(capture).collect::<Vec<_>>());
    let mut names: Option<HashSet<&str>> = names.map(|names| names.iter().map(String::as_str).collect());
    let mut is_wanted = |name: &str| names.as_mut().is_none_or(|names| names.remove(name));
    let photographs = views(capture)
        .enumerate()
        .filter(|(_, view)| is_wanted(&view.name))
        .filter_map(|(index, view)| Some((index, stems.remove(&view.name)?)))
        .collect();
    match names.and_then(|names| names.into_iter().min()) {
        None => Ok(photographs),
        Some(name) => Err(ExportError::failed(format!("photograph {name:?} cannot be read"))),
    }
}
