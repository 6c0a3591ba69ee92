//! The values and gradients of the article's own listing, computed in f64, tensor by tensor (tests/fixtures/README.md).

use std::collections::BTreeMap;
use std::path::Path;

use glam::{DMat3, DVec3};
use relume_compare::worst;
use relume_reference::{
    Array, LISTING_WEIGHTS, Options, Quadrature, ReferenceModel, Tape, Target, fibonacci_sphere, forward,
    losses, normal_related_sh, objective, parameter_names, real_sh,
};
use relume_scene::Camera;
use safetensors::{Dtype, SafeTensors};

/// Largest relative error of the reference engine, elementwise.
const RELATIVE: f64 = 1e-9;
/// Absolute floor of the error, relative to min(1, the tensor's largest value).
const FLOOR: f64 = 1e-12;

type Fixture = BTreeMap<String, Array>;

/// A file of tests/fixtures.
fn committed(name: &str) -> Fixture {
    read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name))
}

fn read(path: &Path) -> Fixture {
    let bytes = std::fs::read(path).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let array = |(name, tensor): (String, safetensors::tensor::TensorView<'_>)| {
        let value = |bytes: &[u8; 8]| match tensor.dtype() {
            Dtype::I64 => i64::from_le_bytes(*bytes) as f64,
            _ => f64::from_le_bytes(*bytes),
        };
        let values = tensor.data().as_chunks::<8>().0.iter().map(value).collect();
        (name, Array::new(tensor.shape(), values))
    };
    file.tensors().into_iter().map(array).collect()
}

fn scene_of(fixture: &Fixture) -> ReferenceModel {
    let named = parameter_names().filter_map(|n| Some((n, fixture.get(&format!("param.{n}"))?.clone())));
    ReferenceModel::new(named.collect()).unwrap()
}

fn camera_of(fixture: &Fixture) -> Camera {
    let [h, w] = [0, 1].map(|i| fixture["out.rgb"].shape()[i] as u32);
    let k = fixture["cam.K"].data();
    let rows: [f64; 9] = fixture["cam.R"].data().try_into().unwrap();
    Camera {
        width: w,
        height: h,
        fx: k[0],
        fy: k[1],
        cx: k[2],
        cy: k[3],
        rotation: DMat3::from_cols_array(&rows).transpose(),
        translation: DVec3::from_slice(fixture["cam.t"].data()),
    }
}

fn options_of(fixture: &Fixture) -> Options {
    Options::listing(Quadrature {
        directions: fixture["env_dirs"].clone(),
        solid_angles: fixture["env_solid_angle"].reshaped(&[1, 512]),
        brdf: fixture["lut"].clone(),
    })
}

/// The engine's values of all tensors of the fixtures, by the fixtures' names.
fn computed(fixture: &Fixture) -> BTreeMap<String, Array> {
    let (scene, camera, tape) = (scene_of(fixture), camera_of(fixture), Tape::new());
    let options = options_of(fixture);
    let pass = forward(&tape, &scene, &camera, &options);
    let target = Target::from(fixture["target.rgb"].clone());
    let terms = objective(&pass, &camera, &target, &options, &LISTING_WEIGHTS);
    let (labels, totals) = losses::backward_labels(&pass.weights);
    let indices = pass.splats.indices.iter().map(|&i| i as f64).collect();
    let mut out = BTreeMap::from([("out.idx".into(), Array::new(&[pass.splats.indices.len()], indices))]);
    let values = [
        ("rgb", pass.image),
        ("normal", pass.shaded.normal),
        ("albedo", pass.buffer.albedo),
        ("metal", pass.buffer.metal),
        ("rough", pass.buffer.rough),
        ("ao", pass.shaded.ambient_occlusion),
        ("alpha", pass.buffer.coverage),
        ("w", pass.weights.weights),
        ("T_hat", pass.weights.backward),
        ("p_hat", labels),
        ("w_sum", totals),
    ];
    out.extend(values.map(|(name, var)| (format!("out.{name}"), (*var.value()).clone())));
    for (name, term) in &terms {
        out.insert(format!("loss.{name}"), (*term.value()).clone());
        let gradients = pass.parameters.gradients(&tape.gradients(*term));
        out.extend(gradients.into_iter().map(|(p, g)| (format!("grad_{name}.{p}"), g)));
    }
    out
}

/// The worst elementwise relative error; for values below a thousandth of min(1, the tensor's largest) the error is relative
/// to that thousandth. A result of at most [`RELATIVE`] means 1e-9 relative with a floor of 1e-12.
fn worst_error(ours: &Array, theirs: &Array) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    let largest = theirs.data().iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    let floor = FLOOR / RELATIVE * if largest > 0.0 { largest.min(1.0) } else { 1.0 };
    let error = |(a, b): (&f64, &f64)| (a - b).abs() / b.abs().max(floor);
    worst(ours.data().iter().zip(theirs.data()).map(error))
}

/// The tensors of a fixture that the engine must reproduce.
fn expected(fixture: &Fixture) -> impl Iterator<Item = (&String, &Array)> {
    let kinds = ["out.", "loss.", "grad_"];
    fixture.iter().filter(move |(name, _)| kinds.iter().any(|k| name.starts_with(k)))
}

fn matches(fixture: &Fixture) {
    let ours = computed(fixture);
    let mut failed = Vec::new();
    assert!(expected(fixture).count() > 3, "the fixture has too few tensors to compare");
    for (tensor, theirs) in expected(fixture) {
        let worst = worst_error(&ours[tensor], theirs);
        println!("{tensor:32} worst relative error {worst:.1e}");
        if !(worst <= RELATIVE) {
            failed.push(tensor);
        }
    }
    // Gradients of a single term that the file omits are zero.
    for (tensor, gradient) in &ours {
        let radiance = tensor.ends_with("radiance_sh");
        let stored = ["img_mae", "img_dssim", "occ", "agg", "light", "total"];
        let in_file = stored.iter().any(|s| tensor.starts_with(&format!("grad_{s}.")));
        if in_file && !fixture.contains_key(tensor) && !radiance {
            assert!(gradient.data().iter().all(|g| *g == 0.0), "{tensor} should be zero");
        }
    }
    assert!(failed.is_empty(), "{failed:?}");
}

#[test]
fn small_scene_matches_the_fixture_tensor_by_tensor() {
    matches(&committed("reference_small.safetensors"));
}

mod with_data {
    #[test]
    #[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
    fn medium_scene_matches_the_fixture_tensor_by_tensor() {
        let path = relume_fixtures::data("../fixtures/reference_medium.safetensors");
        super::matches(&super::read(&path));
    }
}

#[test]
fn comparison_detects_a_relative_change_of_1e_7() {
    let mut fixture = committed("reference_small.safetensors");
    let truth = computed(&fixture);
    let moved = |fixture: &Fixture, tensor: &str| worst_error(&computed(fixture)[tensor], &truth[tensor]);
    assert_eq!(moved(&fixture, "grad_total.means"), 0.0);
    let coefficients = fixture.get_mut("param.occ_sh").unwrap();
    coefficients.data_mut()[0] *= 1.0 + 1e-7;
    for tensor in ["out.rgb", "grad_total.occ_sh"] {
        let error = moved(&fixture, tensor);
        assert!(error.is_finite() && error > RELATIVE, "{tensor}: {error:e}");
    }
    let flipped = truth["grad_total.quats"].map(|g| -g);
    assert!(worst_error(&flipped, &truth["grad_total.quats"]) > 1.0);
    let poisoned = truth["out.rgb"].map(|_| f64::NAN);
    assert_eq!(worst_error(&poisoned, &truth["out.rgb"]), f64::INFINITY);
}

#[test]
fn indirect_directions_match_the_fixture() {
    let fixture = committed("reference_small.safetensors");
    let worst = worst_error(&fibonacci_sphere(32), &fixture["ind_dirs"]);
    assert!(worst <= RELATIVE, "{worst:e}");
    assert!(worst_error(&fibonacci_sphere(32), &fixture["ind_dirs"].map(|v| v + 1e-8)) > RELATIVE);
}

#[test]
fn spherical_harmonics_match_the_fixture_to_degree_six() {
    let fixture = committed("sh.safetensors");
    let tape = Tape::new();
    let directions = tape.input(fixture["dirs"].clone());
    let ours = [("sh", real_sh(directions, 6)), ("nrsh", normal_related_sh(directions, 4))];
    for (name, values) in ours {
        let worst = worst_error(&values.value(), &fixture[name]);
        println!("{name} worst relative error {worst:.1e}");
        assert!(worst <= RELATIVE, "{name}: {worst}");
        let flipped = values.value().map(|v| -v);
        assert!(worst_error(&flipped, &fixture[name]) > 1.0, "a flipped sign must be noticed");
    }
}
