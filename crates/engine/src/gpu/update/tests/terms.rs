//! Terms on the parameters against f64 and its central differences.

use super::*;
use relume_scene::light::sh_eval;

/// A model out of view: the image does not contribute to its gradients.
fn unseen(shape: &Shape, seed: u64) -> UpdateCase {
    let mut case = UpdateCase::new(shape, seed, |_| ());
    case.records.iter_mut().for_each(|r| r.flags = 0);
    case
}

/// Eq. 24 as written, in f64.
fn aggregation(scores: &[f64]) -> f64 {
    let top = scores.iter().copied().fold(f64::MIN, f64::max);
    let total: f64 = scores.iter().map(|s| (s - top).exp()).sum();
    let p: Vec<f64> = scores.iter().map(|s| (s - top).exp() / total).collect();
    let others =
        |k: usize| p.iter().enumerate().filter(move |(j, _)| *j != k).map(|(_, p)| (1.0 - p).max(1e-6));
    let q: f64 = (0..p.len()).map(|k| p[k] * others(k).product::<f64>()).sum();
    -q.max(1e-6).ln()
}

/// Aggregation, residual, flatness and probe labels on planar `values`.
fn objective(values: &[f64], g: &Gaussians, labels: &[f32], terms: &ParameterWeights) -> [f64; 4] {
    let n = g.len();
    let of = |field: Field, i: usize| &values[range(g, field)][i * g.width(field)..(i + 1) * g.width(field)];
    let mut out = [0.0; 4];
    for i in 0..n {
        out[0] += aggregation(of(Field::ProtoLogits, i));
        out[1] += of(Field::Residual, i).iter().map(|e| e.abs()).sum::<f64>();
        out[2] += of(Field::LogScale, i).iter().copied().fold(f64::MAX, f64::min).exp();
        let c = of(Field::Visibility, i);
        let label = &labels[i * c.len()..(i + 1) * c.len()];
        out[3] += c.iter().zip(label).map(|(c, l)| (c - f64::from(*l)).powi(2)).sum::<f64>();
    }
    let weights = [terms.aggregation, terms.residual, terms.flatness, terms.probe_labels];
    let shares = [1.0, 1.0, 1.0, 0.25 / std::f64::consts::PI];
    std::array::from_fn(|k| out[k] * f64::from(weights[k]) * shares[k] / n as f64)
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn parameter_terms_and_gradients_match_the_formulas() {
    let gpu = Gpu::for_tests();
    for (at, prototypes) in [1usize, 2, 8, 40].into_iter().enumerate() {
        let case = unseen(&Shape { n: 20, prototypes, ..Default::default() }, 40 + at as u64);
        let g = &case.model.gaussians;
        let mut device = OnDevice::new(&gpu, &case);
        let labels: Vec<f32> = (0..g.field(Field::Visibility).len()).map(|i| (i as f32).cos()).collect();
        device.probe_labels = Some(gpu.upload("labels", &labels).unwrap());
        let terms = ParameterWeights {
            aggregation: 2.0,
            residual: 3.0,
            flatness: 5.0,
            probe_labels: 7.0,
            view_labels: 0.0,
        };
        let (got, by_globals) = device.gradients(&terms);
        assert!(by_globals.iter().all(|v| *v == 0.0));
        let values: Vec<f64> = device.params().into_iter().map(f64::from).collect();
        let total = |v: &[f64]| objective(v, g, &labels, &terms).iter().sum::<f64>();
        let derivative = |at: usize| {
            let moved = |by: f64| {
                let mut v = values.clone();
                v[at] += by;
                total(&v)
            };
            ((moved(1e-5) - moved(-1e-5)) / 2e-5) as f32
        };
        for field in Field::ALL {
            let r = range(g, field);
            let (mut numeric, mut analytic): (Vec<f32>, _) =
                (r.clone().map(derivative).collect(), got[r].to_vec());
            if field == Field::LogScale {
                // All scales of Gaussian 1 are equal, a kink for central differences: the first one counts as the smallest.
                assert!(analytic[3] > 0.0 && analytic[4..6] == [0.0; 2]);
                numeric[3..6].copy_from_slice(&[0.0; 3]);
                analytic[3] = 0.0;
            }
            if numeric.iter().all(|v| v.abs() < 1e-6) {
                assert!(analytic.iter().all(|v| v.abs() < 1e-6), "K = {prototypes} {field:?}");
                continue;
            }
            let error = error_of_entries(&analytic, &numeric);
            assert!(error < 1e-4, "K = {prototypes} {field:?}: {error:e}");
        }
        let expected = objective(&values, g, &labels, &terms);
        let losses = device.losses();
        for (slot, value) in [11usize, 12, 13, 14].into_iter().zip(expected) {
            let error = (f64::from(losses[slot]) - value).abs();
            assert!(error < 1e-5 * (1.0 + value.abs()), "{slot}: {losses:?} {value}");
        }
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn aggregation_of_one_hot_scores_is_finite() {
    let gpu = Gpu::for_tests();
    let mut case = unseen(&Shape { n: 5, ..Default::default() }, 50);
    case.model.gaussians.field_mut(Field::ProtoLogits).fill(-60.0);
    (0..5).for_each(|i| case.model.gaussians.row_mut(Field::ProtoLogits, i)[i] = 60.0);
    let device = OnDevice::new(&gpu, &case);
    let (got, _) = device.gradients(&ParameterWeights { aggregation: 1.0, ..Default::default() });
    assert!(got.iter().all(|v| v.abs() < 1e-4));
    assert!(device.losses()[11].abs() < 1e-5);
}

/// The label term of a Gaussian in f64: value and derivative by the visibility, before the weight.
fn label(raw: f64, p: f64, form: VisibilityForm) -> (f64, f64) {
    let loss = |v: f64| -(p * v.ln() + (1.0 - p) * (1.0 - v).ln());
    if form == VisibilityForm::Sigmoid {
        let v = 1.0 / (1.0 + (-raw).exp());
        return (loss(v), v - p);
    }
    let v = raw.clamp(1e-3, 1.0 - 1e-3);
    let derivative = (1.0 - p) / (1.0 - v) - p / v;
    let leads_away = (raw < v && derivative > 0.0) || (raw > v && derivative < 0.0);
    (loss(v), if leads_away { 0.0 } else { derivative })
}

/// A case whose image has no gradient but whose splats are visible, and labels for it; four in five have weight.
fn labelled(visibility: usize, form: VisibilityForm) -> (UpdateCase, Vec<[f32; 2]>) {
    let options = ShadingOptions { visibility: form, ..Default::default() };
    let channels = Channels::Full((visibility + 1) * (visibility + 1));
    let shape = Shape { n: 300, visibility, options, channels, ..Default::default() };
    // Values inside the interval of the clamp and beyond it on both sides.
    let spread = |m: &mut Model| m.gaussians.field_mut(Field::Visibility).iter_mut().for_each(|c| *c *= 4.0);
    let mut case = UpdateCase::new(&shape, 60, spread);
    case.rows.iter_mut().for_each(|v| *v *= 0.0);
    let mut rng = ChaCha8Rng::seed_from_u64(61);
    let mut one = |i: usize| {
        let weight = if i.is_multiple_of(5) { 5e-4 } else { rng.random_range(0.01f32..4.0) };
        let share = [0.0, 1.0, rng.random_range(0.0f32..1.0)][(i % 7).min(2)];
        let label = [weight * share, weight];
        if case.expected.visible[i] { label } else { [0.0; 2] }
    };
    let labels = (0..shape.n).map(&mut one).collect();
    (case, labels)
}

/// Value of the label term with weight 0.7, its gradient, and the number of labels without a gradient.
fn expected_pull(case: &UpdateCase, labels: &[[f32; 2]], form: VisibilityForm) -> (f64, Vec<f32>, usize) {
    let g = &case.model.gaussians;
    let counted = labels.iter().filter(|l| l[1] > 1e-3).count();
    let (mut gradient, mut value, mut held) = (Vec::new(), 0.0, 0);
    for (i, l) in labels.iter().enumerate() {
        let width = g.width(Field::Visibility);
        if !(l[1] > 1e-3) {
            gradient.extend(vec![0.0; width]);
            continue;
        }
        let mean: [f32; 3] = g.get(Field::Mean, i);
        let to: [f64; 3] = std::array::from_fn(|k| f64::from(mean[k]) - f64::from(case.view.centre[k]));
        let length = to.iter().map(|v| v * v).sum::<f64>().sqrt();
        let mut y = [0.0f64; 49];
        sh_eval(g.visibility_degree(), to.map(|v| v / length), &mut y);
        let raw = g.row(Field::Visibility, i).iter().zip(&y).map(|(c, y)| f64::from(*c) * y).sum::<f64>();
        let (loss, derivative) = label(raw, f64::from(l[0]) / f64::from(l[1]), form);
        let share = 0.7 / counted as f64;
        held += usize::from(derivative == 0.0);
        value += share * loss;
        gradient.extend(y[..width].iter().map(|y| (share * derivative * y) as f32));
    }
    (value, gradient, held)
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn backward_label_gradient_needs_weight_and_stays_bounded() {
    let gpu = Gpu::for_tests();
    use VisibilityForm::{Linear, Sigmoid};
    for (visibility, form) in [(2, Linear), (4, Sigmoid), (6, Linear), (0, Linear)] {
        let (case, labels) = labelled(visibility, form);
        let (value, expected, held) = expected_pull(&case, &labels, form);
        let mut device = OnDevice::new(&gpu, &case);
        device.view_labels = Some(gpu.upload("labels", &labels).unwrap());
        let (got, _) = device.gradients(&ParameterWeights { view_labels: 0.7, ..Default::default() });
        let r = range(&case.model.gaussians, Field::Visibility);
        let error = error_of_entries(&got[r.clone()], &expected);
        eprintln!("labels {form:?} {visibility}: {error:e}, {held} held");
        assert!(error < 1e-4, "{form:?} {visibility}: {error:e}");
        let loss = f64::from(device.losses()[14]);
        assert!((loss - value).abs() < 1e-5 * (1.0 + value), "{loss} {value}");
        assert!(form == Sigmoid || held > 0, "the control: some labels hold");
        let off = device.gradients(&ParameterWeights::default()).0;
        let control = error_of_entries(&off[r], &expected);
        assert!(control.is_finite() && control > 0.5, "the control: no weight, no gradient");
    }
}
