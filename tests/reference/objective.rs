//! The objective of the trainer, f32 with gradients by hand, against the reference's terms.

use glam::DVec3;
use relume::engine::channel::Channels;
use relume::engine::constants::EarlyStop;
use relume::engine::cpu::objective::{aggregation, geometry, image, parameters};
use relume::engine::cpu::{AttributeSource, BranchImages, BufferGradient, Pass, SurfaceShader};
use relume::engine::reference::{
    Array, Arrays, Options, ReferenceModel, TableOperators, Tape, Target, forward, objective,
};
use relume::engine::{ImageWeights, RasterCamera};
use relume::light::{EnvOperators, TableResolution};
use relume::scene::{Camera, Field, Model, ShadingOptions, softplus, texel_directions};

use super::parity::{BACKGROUND, GAUSSIANS, Noise, SIZE, as_arrays, camera, distance, model, wide};

/// Every term with a weight of its own, so that none can stand in for another.
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
    ("daylight", 0.07),
    ("flatness", 0.8),
];
const PROBES: f64 = 0.6;

fn weight(name: &str) -> f32 {
    WEIGHTS.iter().find(|(n, _)| *n == name).unwrap().1 as f32
}

/// A thin wall of overlapping Gaussians, so that depths form a surface, with uneven normals.
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

struct Photograph {
    pixels: Vec<[f32; 3]>,
    alpha: Vec<f32>,
    probes: Vec<f32>,
}

impl Photograph {
    fn new(seed: u64) -> Self {
        let mut noise = Noise(seed);
        let count = (SIZE.0 * SIZE.1) as usize;
        let mut unit = || 0.5 + 0.5 * noise.next();
        Self {
            pixels: (0..count).map(|_| [unit(), unit(), unit()]).collect(),
            alpha: (0..count).map(|_| unit()).collect(),
            probes: (0..GAUSSIANS * 25).map(|_| unit()).collect(),
        }
    }
}

fn by_reference(model: &Model, camera: &Camera, photo: &Photograph) -> (f64, Arrays) {
    let tape = Tape::new();
    let tables = TableOperators::new(32, 16, TableResolution::TRAINING);
    let options = Options { background: BACKGROUND.map(f64::from), ..Options::model(model.shading, tables) };
    let pass = forward(&tape, &ReferenceModel::from_model(model), camera, &options);
    let [width, height] = [SIZE.0, SIZE.1].map(|n| n as usize);
    let floats = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect();
    let target = Target {
        image: wide(&photo.pixels).reshaped(&[height, width, 3]),
        coverage: Some(Array::new(&[height, width, 1], floats(&photo.alpha))),
        probes: Some(Array::new(&[GAUSSIANS, 25], floats(&photo.probes))),
    };
    let weights: Vec<_> = WEIGHTS.into_iter().chain([("probes", PROBES)]).collect();
    let terms = objective(&pass, camera, &target, &options, &weights);
    for (name, term) in &terms {
        let value = term.value().data()[0];
        println!("{name:14} {value:.6}");
        assert!(value > 1e-6 || *name == "total", "{name} = {value} tests nothing");
    }
    let total = terms["total"];
    (total.value().data()[0], pass.parameters.gradients(&tape.gradients(total)))
}

fn by_trainer(model: &Model, camera: &Camera, photo: &Photograph) -> (f64, Arrays) {
    let operators = EnvOperators::new(32, 16, 4, TableResolution::TRAINING);
    let radiance: Vec<[f32; 3]> = model.env_raw.iter().map(|t| t.map(softplus)).collect();
    let tables = operators.apply(&radiance);
    let source = AttributeSource {
        gaussians: &model.gaussians,
        prototypes: &model.prototypes,
        options: &model.shading,
        gathered: &[],
        indirect_basis: &[[0.0; 3]; 16],
        light: None,
    };
    let shader = SurfaceShader { tables: &tables, options: &model.shading, order: 4 };
    let source = source.under(shader);
    let channels = Channels::Full(25);
    let count = channels.count();
    let pass = Pass::forward(&source, RasterCamera::new(camera, &model.shading), channels, EarlyStop::Never);
    let images = shader.images(&pass, BACKGROUND);
    let target = image::Target::new(SIZE.0 as usize, SIZE.1 as usize, photo.pixels.clone());
    let image_weights = |l1, ssim| ImageWeights { l1: weight(l1), ssim: weight(ssim) };
    let physical_weights = image_weights("img_mae", "img_dssim");
    let radiance_weights = image_weights("radiance_mae", "radiance_dssim");
    let physical = target.compare(&images.physical, physical_weights);
    let branch = target.compare(&images.radiance, radiance_weights);
    let mut buffers = vec![BufferGradient::default(); photo.pixels.len()];
    let mut total = physical.value(physical_weights) + branch.value(radiance_weights);
    total += geometry::depth_normal(&pass, weight("depth_normal"), &mut buffers);
    let smooth = ["smooth_metal", "smooth_rough", "smooth_normal"].map(weight);
    total += geometry::smoothness(&pass, &photo.pixels, smooth, &mut buffers);
    total += geometry::coverage(&pass, &photo.alpha, weight("coverage"), &mut buffers);

    let by = BranchImages { physical: physical.gradient, radiance: branch.gradient };
    let (by_gbuffer, mut by_tables) = shader.images_backward(&pass, BACKGROUND, &by, &buffers, count);
    let stored = count.next_multiple_of(4);
    let mut found = pass.backward(&source, &by_gbuffer, stored, count, Some(&mut by_tables));
    let (neutrality, by_neutrality) = parameters::light_neutrality(&radiance, weight("light"));
    let texels = texel_directions(32, 16);
    let (exposure, by_exposure) = parameters::exposure(&radiance, &texels, weight("exposure"));
    let (daylight, by_daylight) = parameters::daylight(&radiance, &texels, weight("daylight"));
    total += neutrality + exposure + daylight;
    total += parameters::backward_labels(
        &model.gaussians,
        &pass,
        model.shading.visibility,
        weight("occ"),
        &mut found,
    );
    total += parameters::flatness(&model.gaussians, weight("flatness"), &mut found);
    total += aggregation::aggregation(&model.gaussians, weight("agg"), &mut found);
    total += parameters::residual(&model.gaussians, weight("res"), &mut found);
    total += parameters::probe_labels(&model.gaussians, &photo.probes, PROBES as f32, &mut found);

    let by_radiance = operators.apply_transposed(&by_tables);
    let by_raw: Vec<[f32; 3]> = (0..radiance.len())
        .map(|t| {
            let derivative = model.env_raw[t].map(|raw| 1.0 / (1.0 + (-raw).exp()));
            let terms = [by_radiance[t], by_neutrality[t], by_exposure[t], by_daylight[t]];
            std::array::from_fn(|c| terms.iter().map(|term| term[c]).sum::<f32>() * derivative[c])
        })
        .collect();
    (total.into(), as_arrays(model, &found, &by_raw))
}

#[test]
fn the_trainers_objective_and_its_gradient_are_the_references() {
    let photo = Photograph::new(3);
    let (wall, eye) = (wall(), facing_the_wall());
    let (value, reference) = by_reference(&wall, &eye, &photo);
    let (ours, gradients) = by_trainer(&wall, &eye, &photo);
    assert!((ours / value - 1.0).abs() < 1e-5, "{ours} {value}");
    for (parameter, theirs) in &reference {
        let worst = distance(&gradients[parameter], theirs);
        println!("{parameter:14} {worst:.1e}");
        assert!(worst < 1e-3, "{parameter}: {worst:e}");
    }
    // And the comparison can fail: another view has another gradient.
    let (_, other) = by_trainer(&wall, &camera(2), &photo);
    assert!(distance(&other["means"], &reference["means"]) > 0.1);
}
