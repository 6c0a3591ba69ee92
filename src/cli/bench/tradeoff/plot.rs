//! The plot of the tiers: three panels.

use super::row::{Row, exponents};
use crate::cli::bench::plot::{self, Panel, Series};
use crate::cli::error::CommandResult;
use relume_spec::rendering::Tier;

/// The panels that have points, side by side.
pub(super) fn svg(rows: &[Row]) -> CommandResult<String> {
    plot::svg(vec![time_against_error(rows), samples_against_error(rows), training_against_truth(rows)])
}

fn time_against_error(rows: &[Row]) -> Panel {
    let mut groups: Vec<(&str, &str)> = rows.iter().map(|r| (r.model.as_str(), r.device.as_str())).collect();
    groups.dedup();
    let series = groups.into_iter().map(|(model, device)| {
        let own = || rows.iter().filter(|r| (r.model.as_str(), r.device.as_str()) == (model, device));
        Series {
            name: format!("{model}, {device}"),
            // A line joins the sample counts of the Monte-Carlo tier; the other tiers are single points.
            unjoined: own().take_while(|r| r.quality.tier != Tier::MonteCarlo).count(),
            points: own().map(|r| (r.frame_ms, r.shown, label(r))).collect(),
        }
    });
    Panel {
        title: "Tiers: time against error",
        x_label: "milliseconds a frame",
        y_label: "error against Monte Carlo (shown)",
        series: series.collect(),
    }
}

/// The samples per pixel of the Monte-Carlo tier, or the name of another tier.
fn label(row: &Row) -> String {
    match row.quality.tier {
        Tier::MonteCarlo => format!("{} samples", row.quality.samples),
        tier => tier.name().to_owned(),
    }
}

fn samples_against_error(rows: &[Row]) -> Panel {
    let series = exponents(rows).into_iter().map(|(model, exponent)| {
        let own = rows.iter().filter(|r| r.model == model && r.quality.tier == Tier::MonteCarlo);
        let points = own.map(|r| (f64::from(r.quality.samples), r.linear, String::new())).collect();
        Series { name: format!("{model}: samples^{exponent:.2}"), unjoined: 0, points }
    });
    Panel {
        title: "Monte Carlo: samples against error",
        x_label: "samples a pixel",
        y_label: "error (linear)",
        series: series.collect(),
    }
}

fn training_against_truth(rows: &[Row]) -> Panel {
    let series = [Tier::Standard, Tier::High].map(|tier| {
        let own = rows.iter().filter(|r| r.quality.tier == tier && r.device == "cpu");
        let points = own.filter_map(|r| Some((r.training_seconds?, r.truth?, r.preset.clone())));
        Series { name: format!("rendered with {}", tier.name()), unjoined: 0, points: points.collect() }
    });
    Panel {
        title: "Training: time against truth",
        x_label: "seconds of training",
        y_label: "error against ground truth (shown)",
        series: series.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_spec::rendering::Quality;

    #[test]
    fn plot_has_a_panel_per_known_metric_and_escapes_names() {
        let row = |quality: Quality| Row {
            model: "a<b".to_owned(),
            preset: "draft".to_owned(),
            training_seconds: None,
            device: "cpu".to_owned(),
            quality,
            frame_ms: 5.0,
            first_ms: 0.0,
            linear: 0.1,
            shown: 0.1,
            truth: Some(0.1),
        };
        let rows = [row(Tier::Standard.into()), row(Quality::monte_carlo(4)), row(Quality::monte_carlo(16))];
        let figure = svg(&rows).unwrap();
        assert!(figure.contains("Tiers: time") && figure.contains("Monte Carlo: samples"));
        assert!(!figure.contains("Training: time"), "no training time is known");
        assert!(figure.contains("a&lt;b, cpu") && !figure.contains("a<b"));
    }
}
