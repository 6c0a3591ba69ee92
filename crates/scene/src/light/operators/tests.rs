//! Properties of the operators: units, power, and that `apply_transposed` is the transpose of `apply`.

use super::*;

fn irradiance(tables: &LightTables, visibility: &[f32], n: DVec3) -> [f32; 3] {
    let taps = tables.diffuse_grid.lookup(n.to_array().map(|v| v as f32));
    std::array::from_fn(|c| {
        let dot = |k: usize| -> f32 {
            let row = tables.diffuse_rows(taps.node[k])[c];
            row.iter().zip(visibility).map(|(a, b)| a * b).sum()
        };
        (0..4).map(|k| taps.weight[k] * dot(k)).sum()
    })
}

fn open_sky() -> Vec<f32> {
    let mut c = vec![0.0; 32];
    c[0] = 2.0 * std::f32::consts::PI.sqrt();
    c
}

#[test]
fn one_bright_texel_lights_the_sphere_from_its_direction() {
    let operators = EnvOperators::new(32, 16, 4, TableResolution::TRAINING);
    for (index, (d, solid_angle)) in texel_directions(32, 16).into_iter().enumerate().step_by(37) {
        let mut radiance = vec![[0.0; 3]; 512];
        radiance[index] = [1.0, 2.0, 0.0];
        let tables = operators.apply(&radiance);
        let [r, g, b] = irradiance(&tables, &open_sky(), d);
        let expected = solid_angle as f32;
        assert!(
            (r / expected - 1.0).abs() < 0.02 && (g / r - 2.0).abs() < 1e-4 && b == 0.0,
            "{r} {expected}"
        );
        assert!(irradiance(&tables, &open_sky(), -d)[0].abs() < 1e-6, "the far side must stay dark");
        let level = &tables.specular[1];
        let brightest = (0..level.len()).max_by(|a, b| level[*a][0].total_cmp(&level[*b][0])).unwrap();
        assert!(tables.specular_grids[1].directions()[brightest].dot(d) > 0.97);
    }
}

#[test]
fn constant_sky_gives_irradiance_pi_and_radiance_one() {
    let tables = EnvOperators::new(32, 16, 4, TableResolution::TRAINING).apply(&[[1.0; 3]; 512]);
    for n in CubeGrid::new(5).directions() {
        let e = irradiance(&tables, &open_sky(), n)[0];
        assert!((e / std::f32::consts::PI - 1.0).abs() < 0.01, "{n} {e}");
    }
    assert!(tables.specular.iter().flatten().all(|v| (v[0] - 1.0).abs() < 1e-4));
}

#[test]
fn transposed_operator_is_the_adjoint() {
    let operators = EnvOperators::new(16, 8, 2, TableResolution::TRAINING);
    let radiance: Vec<[f32; 3]> = (0..128).map(|i| [(i % 7) as f32, (i % 5) as f32, 1.0]).collect();
    let tables = operators.apply(&radiance);
    let mut probe = tables.zeroed();
    probe.diffuse.iter_mut().enumerate().for_each(|(i, v)| *v = ((i * 31) % 11) as f32 - 5.0);
    for level in &mut probe.specular {
        level.iter_mut().enumerate().for_each(|(i, v)| *v = [(i % 3) as f32, 1.0, -((i % 4) as f32)]);
    }
    let dot3 = |a: &[f32; 3], b: &[f32; 3]| (0..3).map(|c| f64::from(a[c]) * f64::from(b[c])).sum::<f64>();
    let flat = |t: &LightTables, u: &LightTables| {
        let d: f64 = t.diffuse.iter().zip(&u.diffuse).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
        let pairs = t.specular.iter().flatten().zip(u.specular.iter().flatten());
        d + pairs.map(|(a, b)| dot3(a, b)).sum::<f64>()
    };
    let forward = flat(&tables, &probe);
    let back = operators.apply_transposed(&probe);
    let backward: f64 = back.iter().zip(&radiance).map(|(a, b)| dot3(a, b)).sum();
    assert!((forward - backward).abs() < 1e-4 * forward.abs().max(1.0), "{forward} {backward}");
}

#[test]
fn operators_with_lights_conserve_power_and_have_an_adjoint() {
    let whole = EnvOperators::new(16, 8, 1, TableResolution::TRAINING);
    let radiance: Vec<[f32; 3]> = (0..128).map(|i| [(i % 7) as f32, (i % 5) as f32, 1.0]).collect();
    let mut shares = vec![[0.0; MAX_LIGHTS]; 128];
    (20..29).for_each(|t| shares[t] = [0.5, 0.125, 0.25, 0.0]);
    shares[90] = [0.0, 1.0, 0.0, 0.0];
    let light = SplitLight { direction: [0.0, 0.6, 0.8], radius: 0.02 };
    let split = LightSplit { lights: vec![light; 3], shares: shares.clone() };
    let operators = whole.with_lights(&split);
    let tables = operators.apply(&radiance);
    // A constant weight of the tables sums the whole power: no power is lost or counted twice.
    let taken = whole.apply(
        &radiance.iter().zip(&shares).map(|(l, m)| l.map(|v| v * m.iter().sum::<f32>())).collect::<Vec<_>>(),
    );
    let all = whole.apply(&radiance);
    for (i, v) in all.diffuse.iter().enumerate() {
        assert!((tables.diffuse[i] + taken.diffuse[i] - v).abs() < 1e-4);
    }
    for c in 0..3 {
        let angles = texel_directions(16, 8);
        let power = |share: &dyn Fn(usize) -> f64| -> f64 {
            (0..128).map(|t| share(t) * angles[t].1 * f64::from(radiance[t][c])).sum()
        };
        for k in 0..3 {
            let expected = power(&|t| f64::from(shares[t][k]));
            assert!((f64::from(tables.lights[k].irradiance[c]) - expected).abs() < 1e-5);
        }
    }
    assert!(all.diffuse.iter().zip(&tables.diffuse).any(|(a, b)| (a - b).abs() > 0.01), "the control");
    let mut probe = tables.zeroed();
    probe.diffuse.iter_mut().enumerate().for_each(|(i, v)| *v = ((i * 31) % 11) as f32 - 5.0);
    probe.lights.iter_mut().enumerate().for_each(|(i, l)| l.irradiance = [i as f32 + 3.0, -1.0, 2.0]);
    let pairs = tables.lights.iter().zip(&probe.lights);
    let lights: f64 = pairs
        .flat_map(|(a, b)| (0..3).map(|c| f64::from(a.irradiance[c]) * f64::from(b.irradiance[c])))
        .sum();
    let rows = tables.diffuse.iter().zip(&probe.diffuse).map(|(a, b)| f64::from(*a) * f64::from(*b));
    let forward = rows.sum::<f64>() + lights;
    let backward = operators.apply_transposed(&probe);
    let backward: f64 = backward
        .iter()
        .zip(&radiance)
        .flat_map(|(a, b)| (0..3).map(|c| f64::from(a[c]) * f64::from(b[c])))
        .sum();
    assert!((forward - backward).abs() < 1e-4 * forward.abs().max(1.0), "{forward} {backward}");
    assert!((forward - lights - backward).abs() > 1e-3 * forward.abs(), "the control: lights count");
}

#[test]
fn compressed_rows_match_the_operators_with_lights() {
    let mut shares = vec![[0.0; MAX_LIGHTS]; 32];
    shares[9] = [0.5, 0.25, 0.0, 0.0];
    let light = SplitLight { direction: [1.0, 0.0, 0.0], radius: 0.0 };
    let resolution = TableResolution { diffuse: 3, sharp: 3, rough: 3 };
    let operators =
        EnvOperators::new(8, 4, 0, resolution).with_lights(&LightSplit { lights: vec![light; 2], shares });
    let (rows, back) = (operators.rows(), operators.transposed_rows());
    let radiance: Vec<[f32; 3]> = (0..32).map(|i| [1.0 + i as f32; 3]).collect();
    let tables = operators.apply(&radiance);
    let row = |k: usize| &rows.entries[rows.start[k] as usize..rows.start[k + 1] as usize];
    let value =
        |k: usize| -> f32 { row(k).iter().map(|[t, w]| f32::from_bits(*w) * radiance[*t as usize][0]).sum() };
    let nodes: usize = tables.diffuse_grid.len() + tables.specular.iter().map(Vec::len).sum::<usize>();
    assert_eq!(rows.start.len(), nodes + MAX_LIGHTS + 1);
    for k in 0..2 {
        assert!((value(nodes + k) - tables.lights[k].irradiance[0]).abs() < 1e-5);
    }
    assert!(value(nodes) > 1.0 && value(nodes + 2) == 0.0);
    assert!((value(tables.diffuse_grid.len()) - tables.specular[0][0][0]).abs() < 1e-3);
    let texel = &back.entries[back.start[19] as usize..back.start[20] as usize];
    let specular = (nodes - tables.diffuse_grid.len()) as u32;
    assert_eq!(texel.iter().filter(|[node, _]| *node >= specular).count(), 2);
}
