//! Writes the measurements as Markdown and CSV.

use super::row::{Row, exponents};
use crate::cli::bench::table::row;
use relume_spec::rendering::Tier;
use relume_train::eval::{figure, psnr_of};

const HEAD: &str = "| model | preset | training, s | device | tier | ms a frame | first frame more, ms | error, linear | error, shown | against truth | dB |
|---|---|---:|---|---|---:|---:|---:|---:|---:|---:|
";

/// The name of the tier; for the Monte-Carlo tier, with its samples per pixel.
fn tier_name(r: &Row) -> String {
    match r.quality.tier {
        Tier::MonteCarlo => format!("{}, {}", r.quality.tier.name(), r.quality.samples),
        tier => tier.name().to_owned(),
    }
}

/// The table below `introduction`, then the convergence rate of the Monte-Carlo tier.
pub(super) fn markdown(introduction: &str, rows: &[Row]) -> String {
    let mut text = format!("{introduction}\n\n{HEAD}");
    for r in rows {
        text += &row([
            r.model.clone(),
            r.preset.clone(),
            figure(r.training_seconds, 0),
            r.device.clone(),
            tier_name(r),
            format!("{:.1}", r.frame_ms),
            format!("{:.0}", r.first_ms),
            format!("{:.4}", r.linear),
            format!("{:.4}", r.shown),
            figure(r.truth, 4),
            figure(r.truth.map(|e| psnr_of(e * e)), 2),
        ]);
    }
    for (model, exponent) in exponents(rows) {
        text +=
            &format!("\n{model}: the linear error of the Monte-Carlo tier falls as samples^{exponent:.2}.\n");
    }
    text
}

/// A header line with column names, then one line per row.
pub(super) fn csv(rows: &[Row]) -> String {
    let mut text = "model,preset,training_seconds,device,tier,samples,frame_ms,first_frame_ms,\
                    rmse_linear,rmse_shown,rmse_truth\n"
        .to_owned();
    for r in rows {
        let optional = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
        let samples = match r.quality.tier {
            Tier::MonteCarlo => r.quality.samples.to_string(),
            _ => String::new(),
        };
        text += &format!(
            "\"{}\",{},{},\"{}\",{},{samples},{},{},{},{},{}\n",
            r.model.replace('"', "\"\""),
            r.preset,
            optional(r.training_seconds),
            r.device.replace('"', "\"\""),
            r.quality.tier.name(),
            r.frame_ms,
            r.first_ms,
            r.linear,
            r.shown,
            optional(r.truth),
        );
    }
    text
}
