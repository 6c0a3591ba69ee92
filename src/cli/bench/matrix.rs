//! `relume bench matrix`: trains each capture once per variant of the settings and writes one table.

use std::path::PathBuf;

use serde::Deserialize;
use serde_json::{Map, Value, json};

use crate::cli::args::named;
use crate::cli::bench::input::{file_name, read_capture};
use crate::cli::bench::table::{head, row};
use crate::cli::bench::training::{Trained, train_and_evaluate};
use crate::cli::error::CommandResult;
use crate::cli::light::illuminate;
use crate::cli::output;
use relume_capture::Capture;
use relume_capture::formats::model_file;
use relume_engine::{Device, DeviceChoice};
use relume_spec::training::{Method, Preset, TrainConfig, TrainOverrides};
use relume_train::eval::figure;

/// Options of `relume bench matrix`.
#[derive(Debug, clap::Args)]
pub(super) struct MatrixArgs {
    /// Captures with held-out views and, for the relit columns, ground-truth relit pictures.
    #[arg(required = true)]
    captures: Vec<PathBuf>,
    /// `ablation` (the rows of the article and additional features), `orders` (SH degrees of visibility, 0 to 6), `methods`
    /// (models of published systems, as in `train --method`), or a JSON file: `[{"name": "...", "overrides": {...}}, ...]`.
    #[arg(long, default_value = "ablation")]
    variants: String,
    /// Only the variants with these names, separated by commas.
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
    /// Preset: `draft`, `standard` or `high`.
    #[arg(long, default_value = "draft", value_parser = named::<Preset>)]
    preset: Preset,
    /// Longest image side in training and comparison, pixels.
    #[arg(long, default_value_t = 128, value_parser = clap::value_parser!(u32).range(16..=8192))]
    resolution: u32,
    /// Optimisation steps. Default: the number of the preset.
    #[arg(long)]
    iterations: Option<u32>,
    /// Held-out views to compare.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    views: u32,
    /// Seed of all random choices.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Device: `auto`, `cpu`, `gpu` or `gpu:N`.
    #[arg(long, default_value_t)]
    device: DeviceChoice,
    /// The Markdown file to write, row by row. The report is also printed.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// One variant of the settings.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Variant {
    name: String,
    overrides: Map<String, Value>,
}

/// The columns after the capture and the variant.
const COLUMNS: [&str; 10] = [
    "novel, dB",
    "radiance, dB",
    "relit, dB",
    "relit aligned, dB",
    "albedo aligned, dB",
    "normals, deg",
    "AO MAE",
    "roughness MAE",
    "floats a Gaussian",
    "s",
];

pub(super) fn run(args: &MatrixArgs) -> CommandResult {
    let device = Device::open(args.device)?;
    let variants = variants(args)?;
    let mut text = format!(
        "Device: {}; preset `{}`, {} px, {} held-out views, seed {}.\n\n{}",
        device.name(),
        serde_json::to_value(args.preset)?.as_str().unwrap_or_default(),
        args.resolution,
        args.views,
        args.seed,
        head(&["capture", "variant"], COLUMNS)
    );
    println!("{text}");
    for path in &args.captures {
        let mut capture = read_capture(path, args.resolution)?;
        for variant in &variants {
            let trained = train(args, &device, &mut capture, variant)?;
            let line = row(cells(file_name(path), variant, &trained));
            print!("{line}");
            text += &line;
            // The file is written after each row, so that an interrupted run keeps its results.
            if let Some(out) = &args.out {
                output::write_named(out, text.as_bytes())?;
            }
        }
    }
    Ok(())
}

/// Trains and measures one variant.
fn train(
    args: &MatrixArgs,
    device: &Device,
    capture: &mut Capture,
    variant: &Variant,
) -> CommandResult<Trained> {
    let mut fields = variant.overrides.clone();
    // A table compares the parts of the model, so none is omitted unless the variant says so.
    fields.entry("complexity").or_insert_with(|| "full".into());
    fields.insert("resolution".to_owned(), args.resolution.into());
    fields.insert("seed".to_owned(), args.seed.into());
    if let Some(iterations) = args.iterations {
        fields.insert("iterations".to_owned(), iterations.into());
    }
    let overrides: TrainOverrides = serde_path_to_error::deserialize(Value::Object(fields))
        .map_err(|e| format!("variant {}: {}: {}", variant.name, e.path(), e.inner()))?;
    let config = TrainConfig::new(args.preset, &overrides)?;
    illuminate(capture, &config).map_err(|e| format!("variant {}: light: {e}", variant.name))?;
    train_and_evaluate(capture, config, device, args.views as usize)
}

fn cells(capture: String, variant: &Variant, trained: &Trained) -> [String; 12] {
    let r = &trained.report;
    [
        capture,
        variant.name.clone(),
        figure(r.novel_view.psnr, 2),
        figure(r.novel_view_radiance.psnr, 2),
        figure(r.relit.mean.psnr, 2),
        figure(r.relit_aligned.mean.psnr, 2),
        figure(r.albedo.psnr_aligned, 2),
        figure(r.normal_mae_deg.foreground, 1),
        figure(r.ao_mae, 3),
        figure(r.roughness_mae, 3),
        model_file::floats_a_gaussian(&trained.model).to_string(),
        format!("{:.0}", trained.seconds),
    ]
}

fn variants(args: &MatrixArgs) -> CommandResult<Vec<Variant>> {
    let mut all = match args.variants.as_str() {
        "ablation" => ablation(),
        "orders" => orders(),
        "methods" => methods(),
        file => {
            let text = std::fs::read_to_string(file).map_err(|e| format!("--variants {file}: {e}"))?;
            serde_json::from_str(&text).map_err(|e| format!("--variants {file}: {e}"))?
        }
    };
    if let Some(unknown) = args.only.iter().find(|name| all.iter().all(|v| v.name != **name)) {
        return Err(format!("--only {unknown}: no variant has this name").into());
    }
    all.retain(|v| args.only.is_empty() || args.only.contains(&v.name));
    Ok(all)
}

fn variant(name: &str, overrides: Value) -> Variant {
    let overrides = match overrides {
        Value::Object(fields) => fields,
        _ => Map::new(),
    };
    Variant { name: name.to_owned(), overrides }
}

/// The rows of the article's ablation, from no occlusion to all features, then one row for each addition of this engine.
fn ablation() -> Vec<Variant> {
    // All settings of the forward model, with shading per pixel as in the article.
    let form = |visibility: &str, diffuse: &str, indirect: &str| {
        let (visibility, diffuse, indirect) = (json!(visibility), json!(diffuse), json!(indirect));
        json!({"visibility": visibility, "diffuse": diffuse, "indirect": indirect, "shade_at": "pixel"})
    };
    let ao = form("linear", "ambient_occlusion", "learned");
    let listing = form("sigmoid", "ambient_occlusion", "learned");
    let open = form("off", "ambient_occlusion", "off");
    let directional = form("linear", "directional", "off");
    let gathered = form("linear", "directional", "gathered");
    let open_at_gaussians = json!({"visibility": "off", "indirect": "off"});
    vec![
        variant("no occlusion", json!({"shading": open, "labels": "none", "bounces": 0})),
        variant("field without label", json!({"shading": ao, "labels": "none", "bounces": 0})),
        variant("backward labels", json!({"shading": ao, "labels": "backward", "bounces": 0})),
        variant("backward, sigmoid field", json!({"shading": listing, "labels": "backward", "bounces": 0})),
        variant("backward and probe labels", json!({"shading": ao, "labels": "both", "bounces": 0})),
        variant("probes", json!({"shading": ao, "labels": "probes", "bounces": 0})),
        variant(
            "probes, directional diffuse",
            json!({"shading": directional, "labels": "probes", "bounces": 0}),
        ),
        variant("everything, in the pixel", json!({"shading": gathered})),
        variant("everything (default)", json!({})),
        variant("without sheen", json!({"sheen": false})),
        variant(
            "no occlusion, at the Gaussians",
            json!({"shading": open_at_gaussians, "labels": "none", "bounces": 0}),
        ),
        variant("one prototype", json!({"prototypes": 1})),
        variant("prototypes without losses", json!({"weights": {"aggregation": 0.0, "residual": 0.0}})),
    ]
}

/// SH degrees of visibility.
fn orders() -> Vec<Variant> {
    let one = |order: u32| variant(&format!("order {order}"), json!({"visibility_order": order}));
    [0, 2, 3, 4, 5, 6].map(one).into()
}

/// Models of published systems and of Relume.
fn methods() -> Vec<Variant> {
    let one = |method: Method| {
        let name = json!(method);
        variant(name.as_str().unwrap_or_default(), json!({"method": name}))
    };
    Method::ALL.map(one).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_capture::{SyntheticOptions, synthetic};

    #[test]
    fn every_built_in_variant_has_a_distinct_configuration() {
        let mut seen = Vec::new();
        for v in ablation().into_iter().chain(orders()).chain(methods()) {
            let overrides: TrainOverrides = serde_json::from_value(Value::Object(v.overrides)).unwrap();
            let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
            // These two equal the default configuration.
            let is_default = ["order 4", "relume"].contains(&v.name.as_str());
            assert!(is_default || !seen.contains(&config), "{} repeats another", v.name);
            seen.push(config);
        }
        assert!(seen.len() > 10);
    }

    #[test]
    fn every_method_trains_and_only_3dgs_has_no_relit_metrics() {
        let options =
            SyntheticOptions { size: 24, train_views: 3, test_views: 1, paths: 4, ..Default::default() };
        let capture = synthetic(&options).unwrap();
        for v in methods() {
            let small = json!({"iterations": 24, "initial_gaussians": 64, "max_gaussians": 64, "probe_directions": 8});
            let fields = variant("", small).overrides.into_iter().chain(v.overrides.clone()).collect();
            let overrides: TrainOverrides = serde_json::from_value(Value::Object(fields)).unwrap();
            let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
            let trained = train_and_evaluate(&capture, config, &Device::Cpu, 1).unwrap();
            let [_, _, novel, radiance, relit, aligned, albedo, normals, ..] =
                cells(String::new(), &v, &trained);
            for figure in [radiance, normals] {
                assert_ne!(figure, "-", "{}", v.name);
            }
            for figure in [novel, relit, aligned, albedo] {
                assert_eq!(figure == "-", v.name == "3dgs", "{}: {figure}", v.name);
            }
        }
    }
}
