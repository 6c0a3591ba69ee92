//! Every gradient of every parameter against central differences, under every form of the forward model.
//!
//! The scene avoids kinks (alpha cut-offs, clamps), at which central differences are wrong. Training treats visibility labels
//! as constants, in the listing and in docs/MODEL.md. Here they are part of the function, so that the gradients through them
//! are checked as well.

use glam::DVec3;
use relume_compare::worst;
use relume_reference::{
    AlphaLimits, Array, Arrays, ENVIRONMENT, Gathered, Labels, Light, Options, Parameters, Quadrature,
    ReferenceModel, TableOperators, Tape, Target, Var, forward, objective, occlusion, parameter_names,
    weighted_sum,
};
use relume_scene::light::TableResolution;
use relume_scene::{
    Camera, DiffuseForm, Field, IndirectForm, LightSplit, MAX_LIGHTS, NormalForm, ShadeAt, ShadingOptions,
    SplitLight, VisibilityForm, texel_directions,
};

const GAUSSIANS: usize = 7;
const OUTSIDE: usize = GAUSSIANS - 2;
/// Largest error, relative to the largest gradient of a parameter.
const TOLERANCE: f64 = 1e-7;
const ENV: (usize, usize) = (8, 4);

/// Evenly spread numbers in [-1, 1], another sequence for each `seed`.
fn noise(shape: &[usize], seed: f64, centre: f64, spread: f64) -> Array {
    let count = shape.iter().product();
    let value =
        |i: usize| 2.0 * ((i as f64 + 1.0) * (0.618_033_988_75 + 0.01 * seed) + 0.37 * seed).fract() - 1.0;
    Array::new(shape, (0..count).map(|i| centre + spread * value(i)).collect())
}

fn scene() -> ReferenceModel {
    let n = GAUSSIANS;
    let mut means = noise(&[n, 3], 1.0, 0.0, 0.7);
    // One Gaussian beyond the image's edge, where the Jacobian's guard band applies, but wide enough to be visible.
    means.data_mut()[3 * OUTSIDE] = 2.3;
    // The last one is behind the camera: its gradients must be exactly zero.
    means.data_mut()[3 * (n - 1)..].copy_from_slice(&[0.0, -9.0, 0.0]);
    let mut visibility = noise(&[n, 25], 10.0, 0.0, 0.15);
    visibility.data_mut().iter_mut().step_by(25).for_each(|c| *c = 1.9);
    let mut log_scales = noise(&[n, 3], 2.0, -1.1, 0.4);
    log_scales.data_mut()[3 * OUTSIDE..][..3].copy_from_slice(&[-0.2, -0.5, -0.4]);
    let arrays = Arrays::from([
        ("means", means),
        ("log_scales", log_scales),
        ("quats", noise(&[n, 4], 3.0, 0.1, 0.9)),
        ("opacity_logit", noise(&[n, 1], 4.0, 0.2, 0.8)),
        ("normals_raw", noise(&[n, 3], 5.0, 0.1, 0.5)),
        ("metal_logit", noise(&[n, 1], 6.0, -0.3, 0.9)),
        ("rough_logit", noise(&[n, 1], 7.0, 0.2, 0.9)),
        ("sheen", noise(&[n, 1], 21.0, 0.3, 0.8)),
        ("proto_logits", noise(&[n, 3], 8.0, 0.0, 1.0)),
        ("residual", noise(&[n, 3], 9.0, 0.0, 0.1)),
        ("occ_sh", visibility),
        ("ind_sh", noise(&[n, 16], 11.0, 0.3, 0.3)),
        ("radiance_sh", noise(&[n, 12], 12.0, 0.0, 0.2)),
        ("prototypes", noise(&[3, 3], 13.0, 0.5, 0.3)),
        (ENVIRONMENT, noise(&[ENV.1, ENV.0, 3], 14.0, -1.0, 0.6)),
    ]);
    ReferenceModel::new(arrays).unwrap()
}

fn camera() -> Camera {
    Camera::look_at(DVec3::new(0.4, -3.0, 0.9), DVec3::ZERO, DVec3::Z, 0.8, (9, 8)).unwrap()
}

fn target() -> Target {
    Target {
        image: noise(&[8, 9, 3], 15.0, 0.4, 0.4),
        coverage: Some(noise(&[8, 9, 1], 16.0, 0.5, 0.5)),
        probes: Some(noise(&[GAUSSIANS, 25], 17.0, 0.0, 0.5)),
    }
}

/// Options without cut-offs, which a difference could cross.
fn smooth(options: Options) -> Options {
    Options { alpha: AlphaLimits { largest: 1.0, cutoff: 0.0 }, background: [0.2, 0.5, 0.7], ..options }
}

fn listing() -> Options {
    let (directions, solid_angles): (Vec<_>, Vec<_>) =
        texel_directions(ENV.0, ENV.1).into_iter().map(|(d, w)| (d.to_array(), w)).unzip();
    smooth(Options::listing(Quadrature {
        directions: Array::from_rows(&directions),
        solid_angles: Array::new(&[1, solid_angles.len()], solid_angles),
        brdf: noise(&[2, 5, 5], 18.0, 0.4, 0.2),
    }))
}

fn model(shading: ShadingOptions) -> Options {
    let tables = TableOperators::new(ENV.0, ENV.1, TableResolution { diffuse: 4, sharp: 5, rough: 3 });
    let gathered = Gathered {
        irradiance: noise(&[GAUSSIANS, 3], 19.0, 0.3, 0.2),
        radiance: noise(&[GAUSSIANS, 3], 20.0, 0.2, 0.1),
    };
    Options { gathered: Some(gathered), ..smooth(Options::model(shading, tables)) }
}

/// A sum of all terms, as one number.
fn everything<'t>(tape: &'t Tape, scene: &ReferenceModel, options: &Options) -> (Parameters<'t>, Var<'t>) {
    let camera = camera();
    let pass = forward(tape, scene, &camera, options);
    let mut terms = objective(&pass, &camera, &target(), options, &[]);
    terms.insert("occ", occlusion(&pass, &camera, options, Labels::Differentiated));
    // No term contains depth or the specular part alone.
    terms.insert("depth", (pass.buffer.depth * pass.shaded.specular).mean());
    let weights: Vec<(&str, f64)> = terms.keys().map(|name| (*name, 1.0)).collect();
    let sum = weighted_sum(tape, &terms, &weights);
    (pass.parameters, sum)
}

fn value(scene: &ReferenceModel, options: &Options) -> f64 {
    let tape = Tape::new();
    everything(&tape, scene, options).1.value().data()[0]
}

fn analytic(options: &Options) -> Arrays {
    let tape = Tape::new();
    let (parameters, sum) = everything(&tape, &scene(), options);
    parameters.gradients(&tape.gradients(sum))
}

/// The largest difference from central differences over one parameter, relative to its largest gradient.
fn worst_error(name: &str, gradient: &Array, options: &Options) -> f64 {
    let moved = |i: usize, by: f64| {
        let mut scene = scene();
        scene.values_mut(name).unwrap()[i] += by;
        value(&scene, options)
    };
    let largest = gradient.data().iter().fold(1e-9, |m: f64, g| m.max(g.abs()));
    let error = |i: usize, step: f64| {
        let numeric = (moved(i, step) - moved(i, -step)) / (2.0 * step);
        (numeric - gradient.data()[i]).abs() / largest
    };
    // A step may cross a kink, such as a change of a cosine's sign; a step of 1/100 rarely does. A longer step has less rounding.
    let error = |i: usize| match error(i, 1e-5) {
        usual if usual < TOLERANCE => usual,
        usual => usual.min(error(i, 1e-7)).min(error(i, 1e-4)),
    };
    worst((0..gradient.len()).map(error))
}

/// Checks every parameter; `idle` are those that this form of the model does not use.
fn gradients_hold(form: &str, options: &Options, idle: &[&str]) {
    let gradients = analytic(options);
    // A sampling rate is a measurement, which does not train.
    for name in parameter_names().filter(|name| *name != Field::SamplingRate.name()) {
        let gradient = &gradients[name];
        let used = gradient.data().iter().any(|g| *g != 0.0);
        assert_eq!(used, !idle.contains(&name), "{form}: {name} used");
        let worst = worst_error(name, gradient, options);
        println!("{form:12} {name:14} worst relative error {worst:.1e}");
        assert!(worst < TOLERANCE, "{form}: {name} {worst:e}");
    }
    let behind = &gradients["means"].data()[3 * (GAUSSIANS - 1)..];
    assert_eq!(behind, [0.0; 3], "a Gaussian behind the camera has no place to go");
}

#[test]
fn listing_form_gradients_agree_with_differences() {
    gradients_hold("listing", &listing(), &["sheen"]);
}

#[test]
fn default_form_gradients_agree_with_differences() {
    gradients_hold("default", &model(ShadingOptions::default()), &["ind_sh"]);
    let conserving = ShadingOptions { conserves_energy: true, ..ShadingOptions::default() };
    gradients_hold("conserving", &model(conserving), &["ind_sh"]);
}

#[test]
fn deferred_form_gradients_agree_with_differences() {
    let shading = ShadingOptions { shade_at: ShadeAt::Pixel, ..ShadingOptions::default() };
    gradients_hold("deferred", &model(shading), &["ind_sh", "sheen"]);
}

#[test]
fn article_form_gradients_agree_with_differences() {
    let shading = ShadingOptions {
        diffuse: DiffuseForm::AmbientOcclusion,
        shade_at: ShadeAt::Pixel,
        normal: NormalForm::Free,
        indirect: IndirectForm::Learned,
        low_pass_compensation: true,
        srgb: false,
        ..ShadingOptions::default()
    };
    gradients_hold("article", &model(shading), &["sheen"]);
}

#[test]
fn minimal_form_gradients_agree_with_differences() {
    let shading = ShadingOptions {
        visibility: VisibilityForm::Off,
        indirect: IndirectForm::Off,
        ..ShadingOptions::default()
    };
    // Visibility still has the terms of its probes and labels.
    gradients_hold("bare", &model(shading), &["ind_sh"]);
}

#[test]
fn quadrature_form_gradients_agree_with_differences() {
    let mut options = listing();
    options.shading = ShadingOptions { indirect: IndirectForm::Learned, ..ShadingOptions::default() };
    gradients_hold("quadrature", &options, &[]);
}

/// The default form under two dominant lights that arrive in part.
fn with_lights() -> Options {
    let mut shares = vec![[0.0; MAX_LIGHTS]; ENV.0 * ENV.1];
    shares[10] = [0.8, 0.0, 0.0, 0.0];
    shares[11] = [0.3, 0.4, 0.0, 0.0];
    let light = |direction: DVec3, radius| SplitLight {
        direction: direction.normalize().to_array().map(|v| v as f32),
        radius,
    };
    let lights = vec![light(DVec3::new(0.3, -1.0, 0.7), 0.3), light(DVec3::new(-0.6, -0.4, 0.9), 0.0)];
    let mut options = model(ShadingOptions::default());
    let Light::Tables(tables) = &options.light else { unreachable!() };
    options.light = Light::Tables(tables.with_lights(&LightSplit { lights, shares }));
    options.arriving = Some(noise(&[GAUSSIANS, MAX_LIGHTS], 22.0, 0.6, 0.3));
    options
}

#[test]
fn separate_light_gradients_agree_with_differences() {
    let options = with_lights();
    gradients_hold("lights", &options, &["ind_sh"]);
    let dark = Options { arriving: Some(Array::zeros(&[GAUSSIANS, MAX_LIGHTS])), ..options.clone() };
    let apart = value(&scene(), &options) - value(&scene(), &dark);
    assert!(apart.abs() > 1e-4, "the control: the lights are seen");
}

/// A thin, slightly bent wall close to the camera, whose depths form a surface.
fn wall() -> ReferenceModel {
    let mut scene = scene();
    let mut set = |name: &str, values: Vec<f64>| scene.values_mut(name).unwrap().copy_from_slice(&values);
    let spread = |f: fn(usize) -> [f64; 3]| (0..GAUSSIANS).flat_map(f).collect::<Vec<f64>>();
    set("means", spread(|i| [(i % 4) as f64 * 0.6 - 0.9, 0.05 * (i % 3) as f64, (i / 4) as f64 * 0.8 - 0.4]));
    set("log_scales", spread(|i| [-0.9, -3.0, -0.8 - 0.01 * i as f64]));
    set("quats", (0..GAUSSIANS).flat_map(|i| [1.0, 0.0, 0.02 * i as f64, 0.1]).collect());
    scene
}

#[test]
fn depth_normal_term_gradients_agree_with_differences() {
    let options = model(ShadingOptions::default());
    let camera = Camera::look_at(DVec3::new(0.2, -3.0, 0.3), DVec3::ZERO, DVec3::Z, 0.4, (9, 8)).unwrap();
    let term = |scene: &ReferenceModel| {
        let tape = Tape::new();
        let pass = forward(&tape, scene, &camera, &options);
        let term = objective(&pass, &camera, &target(), &options, &[])["depth_normal"];
        (term.value().data()[0], pass.parameters.gradients(&tape.gradients(term)))
    };
    let (value, gradients) = term(&wall());
    assert!(value > 1e-3, "a wall must form a surface: {value}");
    for name in ["means", "log_scales", "quats", "opacity_logit", "normals_raw"] {
        let gradient = &gradients[name];
        let largest = gradient.data().iter().fold(0.0, |m: f64, g| m.max(g.abs()));
        assert!(largest > 1e-6, "{name} must matter");
        for i in 0..gradient.len() {
            let moved = |by: f64| {
                let mut scene = wall();
                scene.values_mut(name).unwrap()[i] += by;
                term(&scene).0
            };
            let numeric = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            assert!((numeric - gradient.data()[i]).abs() < 1e-6 * largest, "{name} {i}");
        }
    }
}

#[test]
fn gradient_check_detects_a_wrong_sign_and_a_one_percent_error() {
    let options = model(ShadingOptions::default());
    let gradient = &analytic(&options)["quats"];
    assert!(worst_error("quats", gradient, &options) < TOLERANCE);
    assert!(worst_error("quats", &gradient.map(|g| -g), &options) > 1.0);
    assert!(worst_error("quats", &gradient.map(|g| 1.01 * g), &options) > 5e-3);
}
