use super::*;
use relume_engine::cpu::Probes;
use relume_engine::{ProbeSettings, srgb};
use relume_scene::{Gaussians, Model};

/// Range of the photographs.
pub(super) const UNIT: DisplayRange = DisplayRange::Unit;

/// Direction of the sun in the test scenes.
pub(super) const SUN: [f32; 3] = [0.48, 0.36, 0.8];

/// [`plate_under`] a sun with a sharp shadow.
pub(super) fn plate(strength: f32) -> TrainState {
    plate_under(&[(SplitLight { direction: SUN, radius: 0.0 }, strength)])
}

/// A ground of flat Gaussians, closed from below, with a square plate above it, under a sky and `lights`, each with its irradiance
/// relative to that of the sky. Visibility is measured.
pub(super) fn plate_under(lights: &[(SplitLight, f32)]) -> TrainState {
    const SIDE: i32 = 36;
    let mut points = Vec::new();
    let at = |k: i32, reach: f32| reach * (2.0 * k as f32 / (SIDE - 1) as f32 - 1.0);
    for i in 0..SIDE * SIDE {
        points.push(([at(i % SIDE, 0.9), at(i / SIDE, 0.9), 0.0], 0.03));
    }
    for i in 0..SIDE * SIDE / 4 {
        let at = |k: i32| 0.3 * (4.0 * k as f32 / (SIDE - 2) as f32 - 1.0);
        points.push(([at(i % (SIDE / 2)), at(i / (SIDE / 2)), 0.35], 0.03));
    }
    for i in 0..SIDE * SIDE {
        points.push(([at(i % SIDE, 1.4), at(i / SIDE, 1.4), -0.1], 0.05));
    }
    let mut g = Gaussians::zeroed(points.len(), 1, 4, 0);
    for (i, (mean, width)) in points.iter().enumerate() {
        g.row_mut(Field::Mean, i).copy_from_slice(mean);
        g.row_mut(Field::LogScale, i).copy_from_slice(&[f32::ln(*width), f32::ln(*width), -7.0]);
        g.row_mut(Field::Quaternion, i)[0] = 1.0;
        g.row_mut(Field::OpacityLogit, i)[0] = 4.0;
        g.row_mut(Field::Visibility, i)[0] = UNOCCLUDED_SH0;
        g.row_mut(Field::Visibility, i)[2] = 0.5;
    }
    let model = Model::new(g, vec![[0.5; 3]], vec![[0.0; 3]; 32 * 16], (32, 16));
    let mut state = TrainState::new(model);
    let probes =
        Probes::measure(&evaluation::source(&state), fibonacci_sphere(256), ProbeSettings::default());
    let field = probes.coefficients(4);
    state.model.gaussians.field_mut(Field::Visibility).copy_from_slice(&field);
    let seen = from_above(&state);
    let search = LightSearch::new(&state, &seen, UNIT);
    let shares = search.shares(&lights.iter().map(|(light, _)| *light).collect::<Vec<_>>());
    let (sky, members) = (search.sky(), search.neighbours.members().to_vec());
    for (i, member) in members.into_iter().enumerate() {
        let of_light = |((light, strength), shares): (&(SplitLight, f32), &Vec<f32>)| {
            strength * shares[i] * light.direction[2]
        };
        let of_lights: f32 = lights.iter().zip(&shares).map(of_light).sum();
        let shown = srgb((0.1 * (sky[i][0] + of_lights)).min(0.9));
        state.model.gaussians.row_mut(Field::Radiance, member as usize).fill((shown - 0.5) / 0.282_094_8);
    }
    state
}

/// Number of pixels in which each Gaussian is visible: none for those below.
pub(super) fn from_above(state: &TrainState) -> Vec<f32> {
    let g = &state.model.gaussians;
    (0..g.len()).map(|i| if g.row(Field::Mean, i)[2] < 0.0 { 0.0 } else { 9.0 }).collect()
}

fn angle(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|k| a[k] * b[k]).sum::<f32>().min(1.0).acos()
}

#[test]
fn light_search_finds_the_sun_by_its_shadow_and_nothing_else() {
    let state = plate(2.0);
    let seen = from_above(&state);
    let found = search(&state, &seen, UNIT, 1, &[]);
    assert_eq!(found.len(), 1);
    assert!(angle(found[0].light.direction, SUN) < 0.05, "{found:?}");
    assert!(found[0].strength.iter().all(|s| (1.0..=4.0).contains(s)), "{found:?}");
    let even = plate(0.0);
    assert!(search(&even, &seen, UNIT, 1, &[]).is_empty(), "the control: only a sky");
    assert!(search(&state, &seen, UNIT, 0, &[]).is_empty());
}

#[test]
fn light_search_finds_two_lamps_as_strong_as_the_sky() {
    let second = [-0.6, 0.36, 0.714];
    let lamps = [(SUN, 1.0), (second, 1.0)]
        .map(|(direction, strength)| (SplitLight { direction, radius: 0.005 }, strength));
    let state = plate_under(&lamps);
    let found = search(&state, &from_above(&state), UNIT, MAX_LIGHTS, &[]);
    assert_eq!(found.len(), 2, "{found:?}");
    for direction in [SUN, second] {
        assert!(found.iter().any(|f| angle(f.light.direction, direction) < 0.05), "{direction:?}: {found:?}");
    }
}

#[test]
fn light_moves_only_for_a_clearly_better_direction() {
    let state = plate(2.0);
    let seen = from_above(&state);
    let near = search(&state, &seen, UNIT, 1, &[])[0].light;
    assert_eq!(search(&state, &seen, UNIT, 1, &[near])[0].light, near);
    let far = SplitLight { direction: [0.0, 0.0, 1.0], radius: 0.005 };
    assert!(angle(search(&state, &seen, UNIT, 1, &[far])[0].light.direction, SUN) < 0.05);
}
