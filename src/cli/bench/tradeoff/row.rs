//! The measurements that the table, the CSV file and the plot show.

use relume_spec::rendering::{Quality, Tier};

/// The measurements of a model on a device with one quality, over all views and lights.
pub(super) struct Row {
    pub(super) model: String,
    pub(super) preset: String,
    pub(super) training_seconds: Option<f64>,
    pub(super) device: String,
    pub(super) quality: Quality,
    /// Mean time of a frame, ms.
    pub(super) frame_ms: f64,
    /// Mean additional time of the first frame under a light, ms: preparation of the light for the tier.
    pub(super) first_ms: f64,
    /// Root mean squared error of linear radiance relative to the Monte-Carlo tier on the same model.
    pub(super) linear: f64,
    /// The same error for the display-referred image on white.
    pub(super) shown: f64,
    /// The error relative to ground truth, display-referred on white.
    pub(super) truth: Option<f64>,
}

/// For each model, the exponent of the linear error of its Monte-Carlo rows as a power of the samples.
pub(super) fn exponents(rows: &[Row]) -> Vec<(String, f64)> {
    let mut models: Vec<&str> = rows.iter().map(|r| r.model.as_str()).collect();
    models.dedup();
    let points = |model: &str| -> Vec<(f64, f64)> {
        let own = rows.iter().filter(|r| r.model == model && r.quality.tier == Tier::MonteCarlo);
        own.map(|r| (f64::from(r.quality.samples), r.linear)).collect()
    };
    models.into_iter().filter_map(|m| Some((m.to_owned(), exponent(&points(m))?))).collect()
}

/// Least-squares fit in logarithms; `None` for fewer than two different abscissae.
fn exponent(points: &[(f64, f64)]) -> Option<f64> {
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
    fn exponent_of_a_power_law_is_fitted() {
        let points: Vec<(f64, f64)> = [4.0f64, 16.0, 64.0].iter().map(|n| (*n, 3.0 * n.powf(-0.5))).collect();
        assert!((exponent(&points).unwrap() + 0.5).abs() < 1e-12);
        assert_eq!(exponent(&points[..1]), None);
    }
}
