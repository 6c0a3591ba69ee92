//! The figures as Markdown and CSV.

use std::fmt::Write as _;

use super::{Args, Row};
use crate::eval::psnr_of;
use crate::render::Tier;

/// The tier, with its samples where it has some.
pub(super) fn tier_name(row: &Row) -> String {
    match row.quality.tier {
        Tier::MonteCarlo => format!("monte_carlo, {}", row.quality.samples),
        tier => tier.name().to_owned(),
    }
}

pub(super) fn markdown(args: &Args, rows: &[Row]) -> Result<String, std::fmt::Error> {
    let mut text = String::new();
    let threads = rayon::current_num_threads();
    writeln!(
        text,
        "{threads} threads; {} px, {} held-out views; errors are root mean squares over all pixels, against the reference tier \
         with {} samples on the same model and against ground truth, display-referred on white.\n",
        args.resolution, args.views, args.truth_samples
    )?;
    writeln!(
        text,
        "| model | preset | training, s | device | tier | ms a frame | first frame more, ms | error, linear | error, shown | against truth | dB |"
    )?;
    writeln!(text, "|---|---|---:|---|---|---:|---:|---:|---:|---:|---:|")?;
    for r in rows {
        writeln!(
            text,
            "| {} | {} | {} | {} | {} | {:.1} | {:.0} | {:.4} | {:.4} | {} | {} |",
            r.model,
            r.preset,
            r.training_seconds.map_or("-".to_owned(), |s| format!("{s:.0}")),
            r.device,
            tier_name(r),
            r.frame_ms,
            r.first_ms,
            r.linear,
            r.shown,
            r.truth.map_or("-".to_owned(), |e| format!("{e:.4}")),
            r.truth.map_or("-".to_owned(), |e| format!("{:.2}", psnr_of(e * e))),
        )?;
    }
    for (model, slope) in slopes(rows) {
        writeln!(text, "\n{model}: the linear error of the reference tier falls as samples^{slope:.2}.")?;
    }
    Ok(text)
}

pub(super) fn csv(rows: &[Row]) -> Result<String, std::fmt::Error> {
    let mut text = "model,preset,training_seconds,device,tier,samples,frame_ms,first_frame_ms,\
                    rmse_linear,rmse_shown,rmse_truth\n"
        .to_owned();
    for r in rows {
        let optional = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
        let samples = match r.quality.tier {
            Tier::MonteCarlo => r.quality.samples.to_string(),
            _ => String::new(),
        };
        writeln!(
            text,
            "\"{}\",{},{},\"{}\",{},{samples},{},{},{},{},{}",
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
        )?;
    }
    Ok(text)
}

/// Per model, the slope of log error by log samples of its reference rows.
pub(super) fn slopes(rows: &[Row]) -> Vec<(String, f64)> {
    let mut models: Vec<&str> = rows.iter().map(|r| r.model.as_str()).collect();
    models.dedup();
    let points = |model: &str| -> Vec<(f64, f64)> {
        let own = rows.iter().filter(|r| r.model == model && r.quality.tier == Tier::MonteCarlo);
        own.map(|r| (f64::from(r.quality.samples), r.linear)).collect()
    };
    models.into_iter().filter_map(|m| Some((m.to_owned(), slope(&points(m))?))).collect()
}

/// Least squares in logarithms; none for fewer than two different abscissae.
fn slope(points: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (x.ln(), y.max(1e-300).ln())).collect();
    let n = logs.len().max(1) as f64;
    let (mx, my) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
    let across: f64 = logs.iter().map(|p| (p.0 - mx).powi(2)).sum();
    (across > 0.0).then(|| logs.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>() / across)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_of_a_power_is_its_exponent() {
        let points: Vec<(f64, f64)> = [4.0f64, 16.0, 64.0].iter().map(|n| (*n, 3.0 * n.powf(-0.5))).collect();
        assert!((slope(&points).unwrap() + 0.5).abs() < 1e-12);
        assert_eq!(slope(&points[..1]), None);
    }
}
