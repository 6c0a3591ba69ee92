//! `relume weights`: the weights of an environment map for the parts of a light matrix.

mod fusion;
mod nuke;

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::cli::error::CommandResult;
use crate::cli::light::{illumination, named_light};
use crate::cli::render::{finite, up_to};
use crate::cli::{input, output};
use relume_capture::formats::exr_matrix::{MatrixHeader, MatrixLightPart, read_header};
use relume_scene::light::{LightLobes, MatrixWeights};
use relume_scene::{Illumination, SplitLight};

/// Options of `relume weights`.
#[derive(Debug, clap::Args)]
pub(super) struct WeightsArgs {
    /// The light: a `.hdr` or `.exr` file or the name of a built-in map; with `--model` also `recovered`, or `recovered:GROUP` for a
    /// light group of the capture.
    env: String,
    /// The light matrix for which to compute the weights: a file of `relume render --light-matrix`, any of them for a sequence.
    #[arg(long, value_name = "MATRIX")]
    like: PathBuf,
    /// The model that contains the light `recovered`.
    #[arg(long)]
    model: Option<PathBuf>,
    /// Rotation of the light about +Z, degrees counter-clockwise.
    #[arg(long, visible_alias = "environment-rotation", default_value_t = 0.0, allow_negative_numbers = true, value_parser = finite)]
    rotation: f64,
    /// Exposure of the light, stops, -20 to 20.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, value_parser = up_to::<20>)]
    exposure: f64,
    /// Form of the output: `json`, or `nuke` or `fusion` for nodes of that program that read and add the parts.
    #[arg(long, value_enum, default_value_t = WeightsFormat::Json)]
    format: WeightsFormat,
    /// The file to write; without it the weights are printed.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// Form of the weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum WeightsFormat {
    Json,
    Nuke,
    Fusion,
}

/// The weights of a light for the parts of a matrix.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct PartWeights {
    /// File of the matrix.
    matrix: String,
    /// Name of the light.
    environment: String,
    rotation_deg: f64,
    exposure_ev: f64,
    parts: Vec<PartWeight>,
}

/// The weight of a part.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct PartWeight {
    /// Name of the part and its layer.
    part: String,
    /// Factor of each channel, linear Rec.709.
    rgb: [f32; 3],
}

pub(super) fn run(args: &WeightsArgs) -> CommandResult {
    let named = |why: String| format!("{}: {why}", args.like.display());
    let header = matrix_header(&args.like).map_err(named)?;
    let light = args.light()?.rotated_and_scaled(args.rotation, args.exposure.exp2() as f32);
    let weights = PartWeights {
        matrix: args.like.display().to_string(),
        environment: args.env.clone(),
        rotation_deg: args.rotation,
        exposure_ev: args.exposure,
        parts: part_weights(&light, &header).map_err(named)?,
    };
    let text = match args.format {
        WeightsFormat::Json => serde_json::to_string_pretty(&weights)? + "\n",
        WeightsFormat::Nuke => nuke::script(&weights, (header.width, header.height))?,
        WeightsFormat::Fusion => fusion::tools(&weights),
    };
    match &args.out {
        Some(path) => output::write_named(path, text.as_bytes())?,
        None => print!("{text}"),
    }
    Ok(())
}

impl WeightsArgs {
    fn light(&self) -> Result<Illumination, String> {
        match &self.model {
            Some(path) => illumination(&self.env, &input::read_model(path)?),
            None if self.env.starts_with("recovered") => {
                Err("recovered: is a light of a model; name the model with --model".to_owned())
            }
            None => Ok(named_light(&self.env, "")?.into()),
        }
    }
}

fn matrix_header(path: &Path) -> Result<MatrixHeader, String> {
    let file = File::open(path).map_err(|error| error.to_string())?;
    read_header(BufReader::new(file)).map_err(|error| error.to_string())
}

/// The weight of each part. Lights without a part of their own are named on standard error.
fn part_weights(light: &Illumination, header: &MatrixHeader) -> Result<Vec<PartWeight>, String> {
    let lobes = lobes_of(&header.lights)?;
    let suns = |light: &MatrixLightPart| match light {
        MatrixLightPart::Sun(sun) => Some(*sun),
        MatrixLightPart::Lobe { .. } => None,
    };
    let suns: Vec<SplitLight> = header.lights.iter().filter_map(suns).collect();
    let found = MatrixWeights::of(light, &lobes, &suns);
    for (direction, lobe) in &found.in_lobes {
        let part = header.names.get(*lobe).map_or("a lobe", String::as_str);
        eprintln!(
            "note: a strong small light of the map towards ({:.2}, {:.2}, {:.2}) has no part of its own; {part} has its power, with a soft shadow",
            direction.x, direction.y, direction.z
        );
    }
    let named = header.names.iter().cloned().zip(found.columns());
    Ok(named.map(|(part, rgb)| PartWeight { part, rgb }).collect())
}

/// `text` without breaks of lines.
fn one_line(text: &str) -> String {
    text.replace(['\n', '\r'], " ")
}

/// The lobes of a matrix, which must be the first of its lights.
fn lobes_of(lights: &[MatrixLightPart]) -> Result<LightLobes, String> {
    let is_lobe = |light: &&MatrixLightPart| matches!(light, MatrixLightPart::Lobe { .. });
    let count = lights.iter().take_while(is_lobe).count();
    let lobes = LightLobes::new(count);
    let agree = |(light, direction): (&MatrixLightPart, &glam::DVec3)| {
        direction.as_vec3().distance(light.direction().into()) < 1e-4
    };
    let fits = count == lights.iter().filter(is_lobe).count() && count == lobes.directions().len();
    match fits && lights.iter().zip(lobes.directions()).all(agree) {
        true => Ok(lobes),
        false => Err("has other lobes than this version of Relume; render the matrix again".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_capture::formats::exr_matrix::names;
    use relume_scene::EnvMap;

    fn header(lights: Vec<MatrixLightPart>) -> MatrixHeader {
        MatrixHeader { width: 4, height: 3, names: names(&lights), lights }
    }

    fn lights(count: usize) -> Vec<MatrixLightPart> {
        let lobes = LightLobes::new(count);
        let lobe = |(d, w): (&glam::DVec3, &f64)| MatrixLightPart::Lobe {
            direction: d.to_array().map(|v| v as f32),
            solid_angle: *w as f32,
        };
        lobes.directions().iter().zip(lobes.solid_angles()).map(lobe).collect()
    }

    #[test]
    fn every_part_of_an_even_light_has_its_radiance_as_weight() {
        let mut lights = lights(12);
        lights.push(MatrixLightPart::Sun(SplitLight { direction: [0.0, 0.0, 1.0], radius: 0.01 }));
        let light = EnvMap::constant(64, 32, [2.0, 1.0, 0.5]).into();
        let weights = part_weights(&light, &header(lights)).unwrap();
        assert_eq!(weights.len(), 13);
        assert!(weights[0].part.starts_with("lobe001_az"), "{weights:?}");
        for weight in &weights[..12] {
            assert!(weight.rgb.iter().zip([2.0, 1.0, 0.5]).all(|(a, b)| (a - b).abs() < 1e-5));
        }
        assert_eq!((weights[12].part.as_str(), weights[12].rgb), ("sun001_az000_ze000", [0.0; 3]));
    }

    #[test]
    fn a_matrix_with_other_lobes_is_refused() {
        let mut other = lights(12);
        assert!(lobes_of(&other).is_ok(), "the control");
        other.swap(0, 1);
        assert!(lobes_of(&other).unwrap_err().contains("render the matrix again"));
        let mut missing = lights(12);
        missing.pop();
        assert!(lobes_of(&missing).is_err());
    }
}
