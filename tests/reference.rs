//! The f64 reference engine against the values and gradients of the article's own listing, and against
//! central differences.

use std::collections::BTreeMap;
use std::path::PathBuf;

use glam::{DMat3, DVec3};
use relume::engine::reference::{
    AlphaLimits, Array, LISTING_WEIGHTS, Options, Quadrature, Scene, Tape, forward, normal_related_sh,
    objective, parameter_names, real_sh,
};
use relume::scene::Camera;
use safetensors::{Dtype, SafeTensors};

/// The promise of the reference engine, elementwise.
const RELATIVE: f64 = 1e-9;
const FLOOR: f64 = 1e-12;

type Fixture = BTreeMap<String, Array>;

/// A fixture file by name, or None (said aloud) when the fixtures are not there.
fn fixture(name: &str) -> Option<Fixture> {
    let folder = std::env::var_os("RELUME_TEST_FIXTURES")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/fixtures"), PathBuf::from);
    let path = folder.join(name);
    let Ok(bytes) = std::fs::read(&path) else {
        eprintln!("SKIPPED: no fixture {}", path.display());
        return None;
    };
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let array = |(name, tensor): (String, safetensors::tensor::TensorView<'_>)| {
        let words = tensor.data().as_chunks::<8>().0;
        let value = |w: &[u8; 8]| match tensor.dtype() {
            Dtype::I64 => i64::from_le_bytes(*w) as f64,
            _ => f64::from_le_bytes(*w),
        };
        (name, Array::new(tensor.shape(), words.iter().map(value).collect()))
    };
    Some(file.tensors().into_iter().map(array).collect())
}

fn scene_of(fixture: &Fixture) -> Scene {
    let named = parameter_names().filter_map(|n| Some((n, fixture.get(&format!("param.{n}"))?.clone())));
    Scene::new(named.collect()).unwrap()
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
    Options {
        low_pass: 0.3,
        low_pass_compensation: false,
        alpha: AlphaLimits::default(),
        background: [1.0; 3],
        light: Quadrature {
            directions: fixture["env_dirs"].clone(),
            solid_angles: fixture["env_solid_angle"].reshaped(&[1, 512]),
            brdf: fixture["lut"].clone(),
            indirect_directions: fixture["ind_dirs"].clone(),
        },
    }
}

/// Everything the engine computes that the fixtures hold, under the fixtures' names.
fn computed(fixture: &Fixture) -> BTreeMap<String, Array> {
    let (scene, camera, tape) = (scene_of(fixture), camera_of(fixture), Tape::new());
    let pass = forward(&tape, &scene, &camera, &options_of(fixture));
    let terms = objective(&pass, &camera, &fixture["target.rgb"], &LISTING_WEIGHTS);
    let (labels, totals) = relume::engine::reference::losses::backward_labels(&pass.weights);
    let indices = pass.splats.indices.iter().map(|&i| i as f64).collect();
    let mut out = BTreeMap::from([
        ("out.rgb".to_owned(), (*pass.image.value()).clone()),
        ("out.normal".to_owned(), (*pass.shaded.normal.value()).clone()),
        ("out.albedo".to_owned(), (*pass.buffer.albedo.value()).clone()),
        ("out.metal".to_owned(), (*pass.buffer.metal.value()).clone()),
        ("out.rough".to_owned(), (*pass.buffer.rough.value()).clone()),
        ("out.ao".to_owned(), (*pass.shaded.ambient_occlusion.value()).clone()),
        ("out.alpha".to_owned(), (*pass.weights.alpha.value()).clone()),
        ("out.w".to_owned(), (*pass.weights.weights.value()).clone()),
        ("out.T_hat".to_owned(), (*pass.weights.backward.value()).clone()),
        ("out.idx".to_owned(), Array::new(&[pass.splats.indices.len()], indices)),
        ("out.p_hat".to_owned(), labels),
        ("out.w_sum".to_owned(), totals),
    ]);
    for (name, term) in &terms {
        out.insert(format!("loss.{name}"), (*term.value()).clone());
        let gradients = pass.parameters.gradients(&tape.gradients(*term));
        out.extend(gradients.into_iter().map(|(p, g)| (format!("grad_{name}.{p}"), g)));
    }
    out
}

/// How often the largest deviation exceeds what is allowed, elementwise: at most 1 passes.
fn excess(ours: &Array, theirs: &Array) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    let pairs = ours.data().iter().zip(theirs.data());
    let excess = |(a, b): (&f64, &f64)| (a - b).abs() / FLOOR.max(RELATIVE * b.abs());
    pairs.map(excess).fold(0.0, |worst, e| if e > worst || e.is_nan() { e } else { worst })
}

/// The tensors of a fixture that the engine must reproduce.
fn expected(fixture: &Fixture) -> impl Iterator<Item = (&String, &Array)> {
    let kinds = ["out.", "loss.", "grad_"];
    fixture.iter().filter(move |(name, _)| kinds.iter().any(|k| name.starts_with(k)))
}

fn matches_fixture(name: &str) {
    let Some(fixture) = fixture(name) else { return };
    let ours = computed(&fixture);
    let mut failed = Vec::new();
    for (tensor, theirs) in expected(&fixture) {
        let worst = excess(&ours[tensor], theirs);
        println!("{name} {tensor:32} {:.1e} of the allowance", worst);
        if worst.is_nan() || worst > 1.0 {
            failed.push(tensor);
        }
    }
    // What the file leaves out of a single term's gradients is zero.
    for (tensor, gradient) in &ours {
        let radiance = tensor.ends_with("radiance_sh");
        let stored = ["img_mae", "img_dssim", "occ", "agg", "light", "total"];
        let in_file = stored.iter().any(|s| tensor.starts_with(&format!("grad_{s}.")));
        if in_file && !fixture.contains_key(tensor) && !radiance {
            assert!(gradient.data().iter().all(|g| *g == 0.0), "{tensor} should be zero");
        }
    }
    assert!(failed.is_empty(), "{name}: {failed:?}");
}

#[test]
fn the_small_fixture_is_matched_tensor_by_tensor() {
    matches_fixture("reference_small.safetensors");
}

#[test]
fn the_medium_fixture_is_matched_tensor_by_tensor() {
    matches_fixture("reference_medium.safetensors");
}

#[test]
fn the_comparison_notices_one_part_in_a_hundred_million() {
    let Some(mut fixture) = fixture("reference_small.safetensors") else { return };
    let truth = computed(&fixture);
    let moved = |fixture: &Fixture, tensor: &str| excess(&computed(fixture)[tensor], &truth[tensor]);
    assert_eq!(moved(&fixture, "grad_total.means"), 0.0);
    let coefficients = fixture.get_mut("param.occ_sh").unwrap();
    coefficients.data_mut()[0] *= 1.0 + 1e-7;
    assert!(moved(&fixture, "out.rgb") > 1.0);
    assert!(moved(&fixture, "grad_total.occ_sh") > 1.0);
    let flipped = truth["grad_total.quats"].map(|g| -g);
    assert!(excess(&flipped, &truth["grad_total.quats"]) > 1e6);
    let poisoned = truth["out.rgb"].map(|_| f64::NAN);
    assert!(excess(&poisoned, &truth["out.rgb"]).is_nan());
}

#[test]
fn spherical_harmonics_match_to_order_six() {
    let Some(fixture) = fixture("sh.safetensors") else { return };
    let tape = Tape::new();
    let directions = tape.input(fixture["dirs"].clone());
    let ours = [("sh", real_sh(directions, 6)), ("nrsh", normal_related_sh(directions, 4))];
    for (name, values) in ours {
        let worst = excess(&values.value(), &fixture[name]);
        println!("{name} {worst:.1e} of the allowance");
        assert!(worst <= 1.0, "{name}: {worst}");
        let flipped = values.value().map(|v| -v);
        assert!(excess(&flipped, &fixture[name]) > 1.0, "a flipped sign must be noticed");
    }
}
