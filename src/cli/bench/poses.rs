//! `relume bench poses`: compares the poses that COLMAP finds for the photographs of a capture with the capture's poses.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use crate::cli::bench::input::file_name;
use crate::cli::bench::table::{head, publish, row};
use crate::cli::error::CommandResult;
use relume_capture::poses::{PoseOptions, RunControl, find_poses};
use relume_capture::{ImportLimits, PhotoCamera, PhotosWithoutPoses, cameras};
use relume_scene::Camera;
use relume_spec::training::UpAxis;
use relume_train::eval::PoseErrors;

/// Options of `relume bench poses`.
#[derive(Debug, clap::Args)]
pub(super) struct BenchPosesArgs {
    /// Captures whose poses are taken as ground truth.
    #[arg(required = true)]
    captures: Vec<PathBuf>,
    /// Time limit for each capture, minutes.
    #[arg(long, default_value_t = 240)]
    time_limit: u64,
    /// The Markdown file to write. The report is also printed.
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(super) fn run(args: &BenchPosesArgs) -> CommandResult {
    let columns = ["photographs", "placed", "agree within 5°", "rotation, median °", "position, median", "s"];
    let mut text = format!(
        "Poses found from the photographs alone, compared with those of the capture after a similarity alignment. Positions in \
         units of the median distance of the cameras from their mean.\n\n{}",
        head(&["capture"], columns)
    );
    for path in &args.captures {
        let stated: BTreeMap<String, Camera> =
            cameras(path, &ImportLimits::default(), UpAxis::Auto)?.into_iter().map(named).collect();
        let none = || format!("{}: contains no photographs", path.display());
        let photographs =
            PhotosWithoutPoses::ignoring_poses(path, &ImportLimits::default())?.ok_or_else(none)?;
        let folder = tempfile::tempdir()?;
        let mut report = |_| {};
        let started = Instant::now();
        let mut run_control =
            RunControl::new(Duration::from_secs(60 * args.time_limit), &mut report, &|| false);
        let into = folder.path().join("capture");
        find_poses(&photographs, &into, &PoseOptions::default(), &mut run_control)?;
        let seconds = started.elapsed().as_secs();
        let found = cameras(&into, &ImportLimits::default(), UpAxis::Auto)?.into_iter().map(named);
        let (found, truth): (Vec<Camera>, Vec<Camera>) =
            found.filter_map(|(name, camera)| Some((camera, *stated.get(&name)?))).unzip();
        let few = || format!("{}: fewer than three poses to compare", path.display());
        let errors = PoseErrors::of(&found, &truth).ok_or_else(few)?;
        let (rotation, position) = errors.medians();
        text += &row([
            file_name(path),
            photographs.photos().len().to_string(),
            found.len().to_string(),
            errors.agreeing().to_string(),
            format!("{rotation:.3}"),
            format!("{position:.4}"),
            seconds.to_string(),
        ]);
    }
    Ok(publish(&text, args.out.as_deref())?)
}

/// A camera, by the name of its file without folders, because the folders have other names.
fn named(photo: PhotoCamera) -> (String, Camera) {
    let name = photo.name.rsplit('/').next().unwrap_or_default().to_owned();
    (name, photo.camera)
}
