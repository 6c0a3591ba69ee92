//! Physical and mathematical laws of the reference engine that hold in every scene, and its errors.

use std::f64::consts::PI;

use glam::DVec3;
use relume_compare::{largest_difference, worst};
use relume_reference::{
    Array, Arrays, ENVIRONMENT, Lighting, Options, Probes, ReferenceModel, TableOperators, Tape, Target,
    fibonacci_sphere, forward, loss_and_gradients, losses, normal_related_sh, parameter_names, real_sh,
    render,
};
use relume_scene::light::{EnvOperators, TableResolution, sh_eval};
use relume_scene::{Camera, DiffuseForm, NormalForm, ShadingOptions, direction_to_uv};

const ENV: (usize, usize) = (32, 16);

fn tables() -> TableOperators {
    TableOperators::new(ENV.0, ENV.1, TableResolution::TRAINING)
}

/// A closed ball of radius 1 made of `count` flat Gaussians with outward normals, all of one material.
fn ball(count: usize, metal_logit: f64, rough_logit: f64) -> Arrays {
    let directions = fibonacci_sphere(count);
    let mut visibility = Array::zeros(&[count, 25]);
    visibility.data_mut().iter_mut().step_by(25).for_each(|c| *c = 2.0 * PI.sqrt());
    Arrays::from([
        ("means", directions.clone()),
        ("log_scales", Array::filled(&[count, 3], (2.0 / (count as f64).sqrt()).ln())),
        ("quats", Array::filled(&[count, 4], 0.5)),
        ("opacity_logit", Array::filled(&[count, 1], 6.0)),
        ("normals_raw", directions),
        ("metal_logit", Array::filled(&[count, 1], metal_logit)),
        ("rough_logit", Array::filled(&[count, 1], rough_logit)),
        ("proto_logits", Array::zeros(&[count, 1])),
        ("residual", Array::zeros(&[count, 3])),
        ("occ_sh", visibility),
        ("ind_sh", Array::zeros(&[count, 16])),
        ("prototypes", Array::filled(&[1, 3], 1.0)),
        (ENVIRONMENT, Array::zeros(&[ENV.1, ENV.0, 3])),
    ])
}

fn camera_from(eye: DVec3) -> Camera {
    Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, (17, 17)).unwrap()
}

/// The forward model of docs/MODEL.md, with free normals, since the ball's Gaussians are round.
fn options(radiance: Array) -> Options {
    let shading = ShadingOptions { normal: NormalForm::Free, ..ShadingOptions::default() };
    Options { environment: Some(radiance), ..Options::model(shading, tables()) }
}

fn constant_sky() -> Array {
    Array::filled(&[ENV.0 * ENV.1, 3], 1.0)
}

#[test]
fn harmonics_are_orthonormal_and_match_the_light_module() {
    // Equal steps in longitude integrate degrees below 16 exactly; midpoints in z leave 1e-6.
    let (rows, columns) = (2000, 16);
    let mut directions = Vec::new();
    for i in 0..rows * columns {
        let z = 1.0 - 2.0 * ((i / columns) as f64 + 0.5) / rows as f64;
        let (sine, cosine) = (2.0 * PI * (i % columns) as f64 / columns as f64).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        directions.push([radius * cosine, radius * sine, z]);
    }
    let tape = Tape::new();
    let basis = real_sh(tape.input(Array::from_rows(&directions)), 6);
    let gram = (basis.transposed().matmul(basis) * (4.0 * PI / directions.len() as f64)).value();
    for (i, value) in gram.data().iter().enumerate() {
        let expected = f64::from(u8::from(i / 49 == i % 49));
        assert!((value - expected).abs() < 1e-4, "({}, {}): {value}", i / 49, i % 49);
    }
    let values = basis.value();
    for (k, d) in directions.iter().enumerate().step_by(97) {
        let mut other = [0.0; 49];
        sh_eval(6, *d, &mut other);
        let error = largest_difference(values.row(k), &other);
        assert!(error < 1e-12, "{d:?} {error}");
        other[2] = -other[2];
        assert!(values.row(k).iter().zip(&other).any(|(a, b)| (a - b).abs() > 1e-6), "a sign must be seen");
    }
}

#[test]
fn full_visibility_gives_ambient_occlusion_of_one() {
    let tape = Tape::new();
    let normals = tape.input(fibonacci_sphere(50));
    for sh_degree in [0, 2, 4, 6] {
        let mut open = Array::zeros(&[1, (sh_degree + 1) * (sh_degree + 1)]);
        open.data_mut()[0] = 2.0 * PI.sqrt();
        let ao = normal_related_sh(normals, sh_degree).dot(tape.input(open)).value();
        assert!(ao.data().iter().all(|a| (a - 1.0).abs() < 1e-14), "order {sh_degree}");
    }
    let frame = render(
        &ReferenceModel::new(ball(300, 0.0, 0.0)).unwrap(),
        &camera_from(DVec3::X * 4.0),
        &options(constant_sky()),
    );
    let pixels = frame["coverage"].data().iter().zip(frame["ao"].data());
    let covered: Vec<f64> = pixels.filter(|(c, _)| **c > 0.5).map(|(_, ao)| (ao - 1.0).abs()).collect();
    assert!(covered.len() > 30 && worst(covered) < 1e-9);
}

#[test]
fn aggregation_is_zero_for_one_hot_and_0_98421_for_uniform() {
    let loss = |rows: Array| {
        let tape = Tape::new();
        losses::aggregation(tape.input(rows)).value().data()[0]
    };
    let one_hot = Array::new(&[2, 3], vec![0.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
    assert!(loss(one_hot).abs() < 1e-12);
    let uniform = loss(Array::filled(&[4, 32], 1.0 / 32.0));
    assert!((uniform - 0.98421).abs() < 1e-5, "{uniform}");
    assert!(loss(Array::new(&[1, 2], vec![0.9, 0.1])) > 0.05, "indecision must cost");
}

#[test]
fn white_ball_in_a_white_furnace_conserves_energy() {
    let render_with = |conserves_energy: bool, (metal, rough): (f64, f64)| {
        let scene = ReferenceModel::new(ball(400, metal, rough)).unwrap();
        let mut options = options(constant_sky());
        options.shading.conserves_energy = conserves_energy;
        let frame = render(&scene, &camera_from(DVec3::new(2.0, -3.0, 1.5)), &options);
        let covered = frame["coverage"].data().iter().zip(0..).filter(|(c, _)| **c > 0.99).map(|(_, i)| i);
        let pixels: Vec<usize> = covered.collect();
        assert!(pixels.len() > 30);
        let channel = |name: &str| pixels.iter().map(|i| frame[name].row(*i)[0]).collect::<Vec<_>>();
        let centre = frame["specular"].row(8 * 17 + 8)[0];
        (channel("diffuse"), channel("specular"), centre)
    };
    let seen = |metal: f64, rough: f64| render_with(true, (metal, rough));
    let totals = |conserves_energy: bool, rough: f64| -> Vec<f64> {
        let (diffuse, specular, _) = render_with(conserves_energy, (-40.0, rough));
        diffuse.iter().zip(&specular).map(|(diffuse, specular)| diffuse + specular).collect()
    };
    for rough in [-1.0, 0.0, 1.0, 40.0] {
        let total = totals(true, rough);
        assert!(total.iter().all(|t| (t - 1.0).abs() < 0.01), "white dielectric in a sky of 1: {total:?}");
        let uncoupled = totals(false, rough);
        assert!(uncoupled.iter().any(|t| *t > 1.02), "the control: {uncoupled:?}");
    }
    for rough in [-40.0, -1.0, 0.0, 1.0, 40.0] {
        let (diffuse, specular, _) = seen(40.0, rough);
        assert!(diffuse.iter().all(|d| d.abs() < 1e-12), "metal has no diffuse part");
        assert!(specular.iter().all(|s| *s > 0.0 && *s < 1.0 + 2e-3), "roughness {rough}: {specular:?}");
    }
    let (_, _, smooth) = seen(40.0, -40.0);
    assert!((smooth - 1.0).abs() < 0.01, "a smooth mirror head-on returns all: {smooth}");
    let (_, _, rough) = seen(40.0, 40.0);
    assert!(rough < 0.95, "one bounce between rough facets loses energy: {rough}");
}

#[test]
fn one_bright_texel_lights_the_ball_from_its_direction() {
    let scene = ReferenceModel::new(ball(400, -40.0, 40.0)).unwrap();
    let brightest_normal = |texel: usize, eye: DVec3| {
        let mut radiance = Array::zeros(&[ENV.0 * ENV.1, 3]);
        radiance.data_mut()[3 * texel..][..3].fill(100.0);
        let frame = render(&scene, &camera_from(eye), &options(radiance));
        let lit =
            |i: &usize| frame["diffuse"].row(*i)[0] * f64::from(u8::from(frame["coverage"].row(*i)[0] > 0.9));
        let best = (0..17 * 17).max_by(|a, b| lit(a).total_cmp(&lit(b))).unwrap();
        DVec3::from_slice(frame["normal"].row(best))
    };
    // By the convention, columns run against the azimuth and rows down from +Z.
    for light in [DVec3::new(1.0, 0.3, 0.4), DVec3::new(-0.5, 1.0, -0.2), DVec3::new(0.2, -0.6, 1.0)] {
        let light = light.normalize();
        let (u, v) = ((0.5 - light.y.atan2(light.x) / (2.0 * PI)), light.z.acos() / PI);
        let texel = (v * 16.0) as usize * 32 + (u * 32.0) as usize;
        assert!(brightest_normal(texel, light * 4.0).dot(light) > 0.93, "{light}");
        // The same map mirrored left to right illuminates another side.
        let mirrored = texel - texel % 32 + 31 - texel % 32;
        assert!(brightest_normal(mirrored, light * 4.0).dot(light) < 0.93, "{light}");
        let [du, dv] = direction_to_uv(light);
        assert!((du - u).abs() < 1e-12 && (dv - v).abs() < 1e-12);
    }
}

#[test]
fn f64_tables_match_the_light_module() {
    let radiance: Vec<[f32; 3]> =
        (0..512).map(|i| [1.0, 0.5, 0.2].map(|c| c * (1.0 + (i as f32 * 0.7).sin()))).collect();
    let theirs = EnvOperators::new(32, 16, 4, TableResolution::TRAINING).apply(&radiance);
    let tape = Tape::new();
    let wide: Vec<f64> = radiance.as_flattened().iter().map(|v| f64::from(*v)).collect();
    let ours = tables().under(tape.input(Array::new(&[512, 3], wide)), 4);
    let directions = fibonacci_sphere(60);
    let normals = tape.input(directions.clone());
    let coefficients: Vec<f64> = (0..60 * 25).map(|i| (i as f64 * 0.31).sin()).collect();
    let transfer = ours.transfer(normals, tape.input(Array::new(&[60, 25], coefficients.clone()))).value();
    let rough = tape.input(Array::filled(&[60, 1], 0.4f32.into()));
    let specular = ours.prefiltered(normals, rough).value();
    for i in 0..60 {
        let d = directions.row(i);
        let diffuse = theirs.diffuse_grid.lookup([d[0], d[1], d[2]]);
        let glossy = theirs.specular_grids[2].lookup([d[0], d[1], d[2]]);
        for c in 0..3 {
            let row = |node: usize| theirs.diffuse_rows(node)[c];
            let dot = |node: usize| {
                (0..25).map(|j| f64::from(row(node)[j]) * coefficients[25 * i + j]).sum::<f64>()
            };
            let expected: f64 = (0..4).map(|k| diffuse.weight[k] * dot(diffuse.node[k])).sum();
            assert!((transfer.row(i)[c] - expected).abs() < 1e-5, "transfer {i} {c}");
            let level = &theirs.specular[2];
            let expected: f64 = (0..4).map(|k| glossy.weight[k] * f64::from(level[glossy.node[k]][c])).sum();
            assert!((specular.row(i)[c] - expected).abs() < 1e-5, "prefiltered {i} {c}");
            assert!((specular.row(i)[c] - f64::from(level[0][c])).abs() > 1e-5, "the table must vary");
        }
    }
}

#[test]
fn layer_transmittances_multiply_to_the_ray_transmittance() {
    let scene = ReferenceModel::new(ball(60, 0.0, 0.0)).unwrap();
    let tape = Tape::new();
    let pass = forward(&tape, &scene, &camera_from(DVec3::new(1.0, 3.0, 1.0)), &options(constant_sky()));
    let (w, behind) = (pass.weights.weights.value(), pass.weights.backward.value());
    let coverage = pass.buffer.coverage.value();
    for pixel in 0..coverage.len() {
        let mut in_front = 1.0;
        for k in 0..w.shape()[1] {
            let alpha = w.row(pixel)[k] / in_front;
            let through = in_front * (1.0 - alpha) * behind.row(pixel)[k];
            assert!((through - (1.0 - coverage.row(pixel)[0])).abs() < 1e-12);
            in_front *= 1.0 - alpha;
        }
    }
}

#[test]
fn closed_emitting_ball_hides_the_sky_and_lights_its_inside() {
    let normals = |outward: &Array| outward.map(|v| -v);
    let directions = fibonacci_sphere(96);
    // A small Gaussian in the middle of the ball, looking up; the ball's own normals look inwards.
    let inside = |shell: usize| {
        let mut arrays = ball(shell + 1, 0.0, 0.0);
        let mut means = fibonacci_sphere(shell).data().to_vec();
        means.extend([0.0; 3]);
        let mut facing = normals(&fibonacci_sphere(shell)).data().to_vec();
        facing.extend([0.0, 0.0, 1.0]);
        let mut scales = Array::filled(&[shell + 1, 3], 0.2f64.ln());
        scales.data_mut()[3 * shell..].fill(-4.0);
        arrays.insert("means", Array::new(&[shell + 1, 3], means));
        arrays.insert("log_scales", scales);
        let facing = Array::new(&[shell + 1, 3], facing);
        let probes = Probes::measure(&ReferenceModel::new(arrays).unwrap(), &facing, &directions, 1.0);
        let irradiance = probes.gathered_irradiance(&facing, &Array::filled(&[shell + 1, 3], 1.0));
        let seen = probes.transmittance.row(shell).iter().sum::<f64>() / 96.0;
        (seen, irradiance.row(shell)[0], probes.coefficients(2).row(shell)[0])
    };
    let (sky, irradiance, first) = inside(300);
    assert!(sky < 1e-2 && first.abs() < 0.05, "{sky} {first}");
    assert!((irradiance / PI - 1.0).abs() < 0.02, "{irradiance}");
    let (sky, irradiance, first) = inside(0);
    assert_eq!((sky, irradiance), (1.0, 0.0));
    assert!((first - 2.0 * PI.sqrt()).abs() < 1e-12, "alone, everything is visible");
}

#[test]
fn wall_occludes_only_the_directions_behind_it() {
    // A sheet of opaque Gaussians one unit along +x from a small one at the origin.
    const SIDE: usize = 17;
    let count = SIDE * SIDE + 1;
    let mut means = vec![0.0; 3];
    let place = |i: usize| 0.2 * i as f64 - 0.1 * (SIDE - 1) as f64;
    means.extend((0..SIDE * SIDE).flat_map(|i| [1.0, place(i % SIDE), place(i / SIDE)]));
    let mut scales = Array::filled(&[count, 3], 0.15f64.ln());
    scales.data_mut()[..3].fill(-4.0);
    let mut arrays = ball(count, 0.0, 0.0);
    arrays.insert("means", Array::new(&[count, 3], means));
    arrays.insert("log_scales", scales);
    let directions = fibonacci_sphere(200);
    let normals = Array::from_rows(&vec![[0.0, 0.0, 1.0]; count]);
    let probes = Probes::measure(&ReferenceModel::new(arrays).unwrap(), &normals, &directions, 1.0);
    for (d, t) in (0..200).map(|k| (directions.row(k), probes.transmittance.row(0)[k])) {
        match d[0] {
            x if x > 0.7 => assert!(t < 0.05, "{d:?} {t}"),
            x if x < 0.0 => assert_eq!(t, 1.0, "{d:?}"),
            _ => {}
        }
    }
    // Degree one points to the open side: Y_1 = k (-y, z, -x).
    let coefficients = probes.coefficients(1);
    let open = [3, 1, 2].map(|j| coefficients.row(0)[j]);
    assert!(open[0] > 1.0 && open[1].abs() < 0.1 && open[2].abs() < 0.1, "{open:?}");
}

#[test]
fn empty_scene_shows_the_background_with_zero_gradients() {
    let scene = ReferenceModel::new(ball(0, 0.0, 0.0)).unwrap();
    let options = Options { background: [0.1, 0.2, 0.3], ..options(constant_sky()) };
    let frame = render(&scene, &camera_from(DVec3::X * 4.0), &options);
    assert!(frame["image"].data().chunks(3).all(|p| p == [0.1, 0.2, 0.3]));
    let target = Target::from(Array::filled(&[17, 17, 3], 0.5));
    let weights = [("img_mae", 1.0), ("occ", 1.0), ("res", 1.0)];
    let (terms, gradients) =
        loss_and_gradients(&scene, &camera_from(DVec3::X * 4.0), &target, &options, &weights);
    assert!(terms.values().all(|t| t.is_finite()), "{terms:?}");
    assert!(gradients.values().all(|g| g.data().iter().all(|v| *v == 0.0)));
}

#[test]
fn outputs_and_gradients_stay_finite_for_extreme_parameters() {
    let target = Target::from(Array::filled(&[17, 17, 3], 0.5));
    let weights =
        [("img_mae", 1.0), ("img_dssim", 1.0), ("radiance_mae", 1.0), ("depth_normal", 1.0), ("occ", 1.0)];
    let tables = TableOperators::new(ENV.0, ENV.1, TableResolution { diffuse: 3, sharp: 5, rough: 3 });
    let extremes: [(&str, f64); 14] = [
        ("opacity_logit", 800.0),
        ("opacity_logit", -800.0),
        ("log_scales", -14.0),
        ("log_scales", 14.0),
        ("quats", 0.0),
        ("normals_raw", 0.0),
        ("metal_logit", 800.0),
        ("rough_logit", -800.0),
        ("rough_logit", 800.0),
        ("proto_logits", 800.0),
        ("occ_sh", 1e3),
        ("means", 0.0),
        (ENVIRONMENT, -800.0),
        (ENVIRONMENT, 6e4),
    ];
    for form in [DiffuseForm::Directional, DiffuseForm::AmbientOcclusion] {
        for (name, value) in extremes {
            let mut arrays = ball(20, 0.0, 0.0);
            let shape = arrays[name].shape().to_vec();
            arrays.insert(name, Array::filled(&shape, value));
            let scene = ReferenceModel::new(arrays).unwrap();
            let shading = ShadingOptions {
                diffuse: form,
                normal: NormalForm::Free,
                low_pass_compensation: true,
                ..ShadingOptions::default()
            };
            let options = Options::model(shading, tables.clone());
            for eye in [DVec3::new(0.0, 0.0, 4.0), DVec3::new(0.1, 0.2, 0.3)] {
                let (terms, gradients) =
                    loss_and_gradients(&scene, &camera_from(eye), &target, &options, &weights);
                assert!(terms.values().all(|t| t.is_finite()), "{name} = {value}: {terms:?}");
                for (parameter, gradient) in gradients {
                    assert!(
                        gradient.data().iter().all(|g| g.is_finite()),
                        "{name} = {value}, {eye}: {parameter} {gradient:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn missing_or_misshapen_parameters_are_refused_by_name() {
    for name in parameter_names().filter(|n| !["radiance_sh", "sheen", "sampling_rate"].contains(n)) {
        let mut arrays = ball(3, 0.0, 0.0);
        arrays.remove(name);
        assert_eq!(ReferenceModel::new(arrays).unwrap_err().name, name);
        let mut arrays = ball(3, 0.0, 0.0);
        arrays.insert(name, Array::zeros(&[4, 2, 2]));
        assert!(ReferenceModel::new(arrays).is_err(), "{name}");
    }
}

#[test]
fn relighting_replaces_the_environment_of_the_scene() {
    let scene = ReferenceModel::new(ball(100, 0.0, 0.0)).unwrap();
    let eye = camera_from(DVec3::X * 4.0);
    let own = options(constant_sky());
    let same = Options { environment: Some(Array::filled(&[512, 3], 2f64.ln())), ..own.clone() };
    let raw_zero = Options { environment: None, ..own.clone() };
    assert_eq!(render(&scene, &eye, &same)["image"], render(&scene, &eye, &raw_zero)["image"]);
    assert_ne!(render(&scene, &eye, &same)["image"], render(&scene, &eye, &own)["image"]);
}
