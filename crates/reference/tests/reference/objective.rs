//! The trainer's objective, f32 with manual gradients, against the reference's terms.

use glam::DVec3;
use relume_compare::relative_error;
use relume_engine::{
    Branches, ImageWeights, LightWeights, ParameterWeights, Photo, PhotoId, PhotoLight, PhotoSize, Step,
    StepCounts, StepSizes, StepWeights, SurfaceWeights, TrainState, TurnedLight, cpu,
};
use relume_reference::{
    Array, Arrays, LIGHT_COLOUR_TOLERANCE, Options, ReferenceModel, TableOperators, Tape, Target, forward,
    objective,
};
use relume_scene::light::{DAYLIGHT, EnvOperators, LightColour, TableResolution};
use relume_scene::{Camera, DisplayRange, Field, Model, ShadingOptions};

use super::parity::{BACKGROUND, GAUSSIANS, Noise, SIZE, as_arrays, camera, distance, model, wide};

/// Every term with a different weight, so that a mix-up fails.
const WEIGHTS: [(&str, f64); 16] = [
    ("img_mae", 1.0),
    ("img_dssim", 0.25),
    ("radiance_mae", 0.5),
    ("radiance_dssim", 0.125),
    ("coverage", 0.7),
    ("depth_normal", 0.9),
    ("smooth_metal", 0.3),
    ("smooth_rough", 0.1),
    ("smooth_normal", 0.2),
    ("light", 0.2),
    ("agg", 0.15),
    ("res", 0.35),
    ("occ", 0.4),
    ("exposure", 0.05),
    ("light_colour", 0.07),
    ("flatness", 0.8),
];
const PROBES: f64 = 0.6;

fn weight(name: &str) -> f32 {
    WEIGHTS.iter().find(|(n, _)| *n == name).unwrap().1 as f32
}

/// A thin wall of overlapping Gaussians with uneven normals, whose depths form a surface.
fn wall() -> Model {
    let mut model = model(5, ShadingOptions::default());
    let mut noise = Noise(9);
    let g = &mut model.gaussians;
    for i in 0..GAUSSIANS {
        let (u, v) = ((i % 8) as f32 * 0.3 - 1.05, (i / 8) as f32 * 0.4 - 0.8);
        g.row_mut(Field::Mean, i).copy_from_slice(&[u, 0.2 * u, v]);
        g.row_mut(Field::LogScale, i).copy_from_slice(&[-1.4, -3.5, -1.3]);
        g.row_mut(Field::Quaternion, i).copy_from_slice(&[1.0, 0.0, 0.0, 0.1]);
        g.row_mut(Field::OpacityLogit, i)[0] = 1.0 + noise.next();
    }
    noise.fill(g.field_mut(Field::Normal), 0.0, 0.2);
    model
}

fn facing_the_wall() -> Camera {
    Camera::look_at(DVec3::new(0.3, -3.0, 0.4), DVec3::ZERO, DVec3::Z, 0.5, SIZE).unwrap()
}

/// A random photograph, and random probe labels.
fn photograph(camera: &Camera, seed: u64) -> (Photo, Vec<f32>) {
    let mut noise = Noise(seed);
    let count = (SIZE.0 * SIZE.1) as usize;
    let mut unit = || 0.5 + 0.5 * noise.next();
    let pixels = (0..count).map(|_| [unit(), unit(), unit()]).collect();
    let alpha = (0..count).map(|_| unit()).collect();
    (
        Photo { camera: *camera, pixels, alpha, light: Default::default(), range: DisplayRange::Unit },
        (0..GAUSSIANS * 25).map(|_| unit()).collect(),
    )
}

fn reference_result(model: &Model, photo: &Photo, probes: &[f32]) -> (f64, Arrays) {
    let tape = Tape::new();
    let tables = TableOperators::new(32, 16, TableResolution::TRAINING);
    let background = BACKGROUND.map(f64::from);
    let options = Options { background, range: photo.range, ..Options::model(model.shading, tables) };
    let pass = forward(&tape, &ReferenceModel::from_model(model), &photo.camera, &options);
    let [width, height] = [SIZE.0, SIZE.1].map(|n| n as usize);
    let floats = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect();
    let target = Target {
        image: wide(&photo.pixels).reshaped(&[height, width, 3]),
        coverage: Some(Array::new(&[height, width, 1], floats(&photo.alpha))),
        probes: Some(Array::new(&[GAUSSIANS, 25], floats(probes))),
    };
    let weights: Vec<_> = WEIGHTS.into_iter().chain([("probes", PROBES)]).collect();
    let terms = objective(&pass, &photo.camera, &target, &options, &weights);
    for (name, term) in &terms {
        let value = term.value().data()[0];
        println!("{name:14} {value:.6}");
        assert!(value > 1e-6 || *name == "total", "{name} = {value} tests nothing");
    }
    let total = terms["total"];
    (total.value().data()[0], pass.parameters.gradients(&tape.gradients(total)))
}

fn outcome(model: &Model, photo: &Photo, probes: &[f32]) -> cpu::ObjectiveResult {
    let operators = EnvOperators::new(32, 16, 4, TableResolution::TRAINING);
    let state = TrainState { labels: probes.to_vec(), ..TrainState::new(model.clone()) };
    let image = |l1, ssim| ImageWeights { l1: weight(l1), ssim: weight(ssim) };
    let weights = StepWeights {
        physical: image("img_mae", "img_dssim"),
        radiance: image("radiance_mae", "radiance_dssim"),
        surface: SurfaceWeights {
            coverage: weight("coverage"),
            depth_normal: weight("depth_normal"),
            smoothness: ["smooth_metal", "smooth_rough", "smooth_normal"].map(weight),
        },
        light: LightWeights {
            neutrality: weight("light"),
            exposure: weight("exposure"),
            colour: weight("light_colour"),
            wanted: LightColour::of(DAYLIGHT),
            tolerance: LIGHT_COLOUR_TOLERANCE as f32,
        },
        parameters: ParameterWeights {
            aggregation: weight("agg"),
            residual: weight("res"),
            flatness: weight("flatness"),
            probe_labels: PROBES as f32,
            view_labels: weight("occ"),
        },
    };
    let step = Step {
        photo,
        photo_id: PhotoId { index: 0, size: PhotoSize::Full, revision: 0 },
        background: BACKGROUND,
        branches: Branches::BothWithVisibility,
        weights,
        sizes: StepSizes::default(),
        counts: StepCounts { geometry: 1, material: 1 },
    };
    cpu::objective(&step, &state, &operators)
}

fn by_trainer(model: &Model, photo: &Photo, probes: &[f32]) -> (f64, Arrays) {
    let found = outcome(model, photo, probes);
    let by_raw = found.gradients.env_raw.clone();
    (found.loss.into(), as_arrays(model, &found.gradients, &by_raw))
}

#[test]
fn trainer_objective_and_gradient_match_the_reference() {
    let (wall, camera_of_wall) = (wall(), facing_the_wall());
    let (photo, probes) = photograph(&camera_of_wall, 3);
    let (value, reference) = reference_result(&wall, &photo, &probes);
    let (ours, gradients) = by_trainer(&wall, &photo, &probes);
    assert!((ours / value - 1.0).abs() < 1e-5, "{ours} {value}");
    for (parameter, theirs) in &reference {
        let worst = distance(&gradients[parameter], theirs);
        println!("{parameter:14} {worst:.1e}");
        assert!(worst < 1e-3, "{parameter}: {worst:e}");
    }
    // Negative control: another view has another gradient.
    let (_, other) = by_trainer(&wall, &Photo { camera: camera(2), ..photo }, &probes);
    let control = distance(&other["means"], &reference["means"]);
    assert!(control.is_finite() && control > 0.1, "{control}");
}

fn turned_light(radians: f64) -> PhotoLight {
    PhotoLight { light: TurnedLight { group: 0, radians }, block: 0 }
}

#[test]
fn light_of_a_group_is_its_environment_alone() {
    let (alone, (photo, probes)) = (wall(), photograph(&facing_the_wall(), 3));
    let mut groups = alone.clone();
    let first: Vec<[f32; 3]> = alone.env_raw.iter().map(|raw| raw.map(|v| 0.5 - v)).collect();
    groups.env_raw = [first, alone.env_raw.clone()].concat();
    let of_group = |group| {
        let light = PhotoLight { light: TurnedLight { group, radians: 0.0 }, block: 0 };
        outcome(&groups, &Photo { light, ..photo.clone() }, &probes)
    };
    let (found, expected, other) = (of_group(1), outcome(&alone, &photo, &probes), of_group(0));
    assert_eq!(found.loss, expected.loss);
    assert_eq!(found.gradients.rows, expected.gradients.rows);
    let (of_first, of_second) = found.gradients.env_raw.split_at(alone.env_raw.len());
    assert_eq!(of_second, expected.gradients.env_raw);
    assert!(of_first.iter().all(|v| *v == [0.0; 3]), "the other group has no gradient");
    assert!((other.loss - expected.loss).abs() > 1e-4, "the control: {} {}", other.loss, expected.loss);
}

#[test]
fn rotated_photograph_light_equals_a_rotated_environment() {
    let wall = wall();
    let (photo, probes) = photograph(&facing_the_wall(), 3);
    let columns = 5;
    let radians = std::f64::consts::TAU * columns as f64 / 32.0;
    let turned = Photo { light: turned_light(radians), ..photo.clone() };
    let found = outcome(&wall, &turned, &probes);
    let mut rolled = wall.clone();
    rolled.env_raw.chunks_exact_mut(32).for_each(|row| row.rotate_left(columns));
    let mut expected = outcome(&rolled, &photo, &probes);
    expected.gradients.env_raw.chunks_exact_mut(32).for_each(|row| row.rotate_right(columns));
    let by_light = |found: &cpu::ObjectiveResult, expected: &cpu::ObjectiveResult| {
        let [found, expected] = [found, expected].map(|o| o.gradients.env_raw.as_flattened());
        relative_error(found, expected)
    };
    assert!((found.loss - expected.loss).abs() < 1e-5, "{} {}", found.loss, expected.loss);
    let error = by_light(&found, &expected);
    assert!(error < 1e-3, "{error}");
    let still = outcome(&wall, &photo, &probes);
    assert!((found.loss - still.loss).abs() > 1e-4, "the control: {} {}", found.loss, still.loss);
    let control = by_light(&found, &still);
    assert!(control.is_finite() && control > 0.05, "the control: {control}");
}

#[test]
fn gradient_under_fractional_column_rotation_is_correct() {
    let wall = wall();
    let (photo, probes) = photograph(&facing_the_wall(), 3);
    let photo = Photo { light: turned_light(2.1), ..photo };
    let found = outcome(&wall, &photo, &probes).gradients.env_raw;
    // Along the gradient itself, so that the difference exceeds rounding.
    let length = found.as_flattened().iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
    let at = |step: f64| {
        let mut moved = wall.clone();
        for (raw, by) in moved.env_raw.as_flattened_mut().iter_mut().zip(found.as_flattened()) {
            *raw += (step * f64::from(*by) / length) as f32;
        }
        f64::from(outcome(&moved, &photo, &probes).loss)
    };
    let slope = (at(0.5) - at(-0.5)) / 1.0;
    assert!((slope / length - 1.0).abs() < 0.05, "{slope} {length}");
    let still = outcome(&wall, &Photo { light: PhotoLight::default(), ..photo.clone() }, &probes);
    let along = still.gradients.env_raw.as_flattened().iter().zip(found.as_flattened());
    let wrong = along.map(|(a, b)| f64::from(a * b)).sum::<f64>() / length;
    assert!(
        (wrong / length - 1.0).abs() > 0.07,
        "the control: the gradient without a turn, {wrong} {length}"
    );
}
