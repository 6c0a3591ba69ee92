//! `relume capture next`: places for further photographs.

use std::path::PathBuf;

use serde_json::json;

use crate::camera_path::path_views;
use crate::cli::error::CommandResult;
use crate::cli::{input, output};
use relume_scene::{Camera, Model};
use relume_train::trust::{
    MAX_CANDIDATES, NextPhotograph, NextPhotographError, next_photographs, places_around,
};
use relume_train::up_of_card;

/// Width and height of cameras without a size, pixels.
const SIDE: u32 = 512;

/// Options of `relume capture next`.
#[derive(Debug, clap::Args)]
pub(super) struct NextArgs {
    /// The model of the photographs so far.
    model: PathBuf,
    /// Number of places.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1000))]
    count: u32,
    /// Choose among the cameras of this JSON file (as for `relume render --path`, at most 2,000) in place of a grid around the subject.
    #[arg(long, value_name = "FILE")]
    among: Option<PathBuf>,
    /// Write the places as cameras, for `relume render --path`.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

pub(super) fn run(args: &NextArgs) -> CommandResult {
    let model = input::read_model(&args.model)?;
    let named = |error: NextPhotographError| format!("{}: {error}", args.model.display());
    let candidates = match &args.among {
        Some(file) => cameras_of(file, &model)?,
        None => places_around(&model)?,
    };
    let next = next_photographs(&model, &candidates, args.count as usize).map_err(named)?;
    println!("place  camera  azimuth  elevation  nearest  lack of confidence");
    for (place, next) in next.iter().enumerate() {
        let NextPhotograph { candidate, lack, nearest_deg, .. } = next;
        // Whole numbers have no negative zero.
        let [azimuth, elevation] =
            [next.azimuth_deg, next.elevation_deg].map(|degrees| degrees.round() as i64);
        println!(
            "{:>5}  {candidate:>6}  {azimuth:>6}°  {elevation:>8}°  {nearest_deg:>6.0}°  {lack:>18.2}",
            place + 1
        );
    }
    eprintln!(
        "azimuths are counter-clockwise from the first photograph, seen from above; nearest is the angle to the nearest photograph or earlier place"
    );
    if let Some(file) = &args.out {
        let chosen: Vec<&Camera> = next.iter().map(|next| &candidates[next.candidate]).collect();
        output::write_named(file, path_of(&chosen).as_bytes())?;
        eprintln!("wrote {}", file.display());
    }
    Ok(())
}

fn cameras_of(file: &std::path::Path, model: &Model) -> CommandResult<Vec<Camera>> {
    let named = |error: String| format!("{}: {error}", file.display());
    let json = serde_json::from_slice(&input::read(file)?).map_err(|error| named(error.to_string()))?;
    let views = path_views(&json, (SIDE, SIDE), None, up_of_card(&model.card)?);
    let views = views.map_err(|error| named(format!("{}: {}", error.pointer, error.detail)))?;
    if views.len() > MAX_CANDIDATES {
        return Err(
            named(format!("has {} cameras; at most {MAX_CANDIDATES} can be compared", views.len())).into()
        );
    }
    Ok(views.into_iter().map(|view| view.camera).collect())
}

/// Cameras as a JSON file for `relume render --path`.
fn path_of(cameras: &[&Camera]) -> String {
    let camera = |camera: &&Camera| {
        let rows: [[f64; 4]; 4] = camera.to_opengl().transpose().to_cols_array_2d();
        let (width, height) = (camera.width, camera.height);
        let intrinsics = json!({ "fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy });
        json!({ "camera": { "camera_to_world": rows, "intrinsics": intrinsics }, "width": width, "height": height })
    };
    let cameras: Vec<_> = cameras.iter().map(camera).collect();
    format!("{:#}\n", json!({ "cameras": cameras }))
}
