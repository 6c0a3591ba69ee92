use super::*;
use relume_engine::{fibonacci_sphere, linear_from_srgb};
use relume_scene::{Gaussians, Model, softplus, texel_directions};

const SIZE: (usize, usize) = (32, 16);
/// Direction of the lamp.
const LAMP: [f32; 3] = [0.6, 0.0, 0.8];
/// Display value of the walls.
const WALL: f32 = 0.5;

/// A round room of radius 3 with a dark thing in its middle. Gaussians within `lamp` radians of [`LAMP`] are white; `shown` decides
/// by direction which parts of the room exist.
fn room(lamp: f32, shown: impl Fn([f32; 3]) -> bool) -> TrainState {
    let walls: Vec<[f32; 3]> = fibonacci_sphere(2_000).into_iter().filter(|d| shown(*d)).collect();
    let mut g = Gaussians::zeroed(walls.len() + 1, 1, 1, 0);
    for i in 0..g.len() {
        let d = walls.get(i).copied().unwrap_or_default();
        let is_lamp = (0..3).map(|k| d[k] * LAMP[k]).sum::<f32>() > lamp.cos();
        let value = if i == walls.len() {
            0.0
        } else if is_lamp {
            1.0
        } else {
            WALL
        };
        g.row_mut(Field::Mean, i).copy_from_slice(&d.map(|v| 3.0 * v));
        g.row_mut(Field::LogScale, i).fill(0.1f32.ln());
        g.row_mut(Field::Quaternion, i)[0] = 1.0;
        g.row_mut(Field::OpacityLogit, i)[0] = 6.0;
        g.row_mut(Field::Radiance, i).fill((value - 0.5) / 0.282_094_8);
    }
    g.row_mut(Field::LogScale, walls.len()).fill(0.3f32.ln());
    TrainState::new(Model::new(g, vec![[0.5; 3]; 2], vec![[0.0; 3]; SIZE.0 * SIZE.1], SIZE))
}

fn light_in(state: &TrainState) -> SurroundingLight {
    let seen = vec![10.0; state.model.gaussians.len()];
    let ball = SubjectBall { centre: DVec3::ZERO, radius: 1.0 };
    SurroundingLight::around(state, &seen, ball, DisplayRange::Unit)
}

#[test]
fn walls_are_known_and_the_thing_in_their_middle_does_not_count() {
    let light = light_in(&room(0.0, |_| true));
    assert!(light.shown > 0.99 && light.source_share() == 0.0, "{} {}", light.shown, light.source_share());
    let wall = linear_from_srgb(WALL);
    let worst = light.texels.iter().flatten().flatten().map(|v| (v / wall - 1.0).abs()).fold(0.0, f32::max);
    assert!(worst < 0.05, "{worst}");
    let all = vec![10.0; 2_001];
    let ball = SubjectBall { centre: DVec3::ZERO, radius: 0.0 };
    let mut state = room(0.0, |_| true);
    state.model.gaussians.row_mut(Field::Mean, 2_000)[2] = 0.5;
    let with_thing = SurroundingLight::around(&state, &all, ball, DisplayRange::Unit);
    assert!(with_thing.texels[SIZE.0 / 2].unwrap()[0] < 0.5 * wall, "the control");
    let unseen = SurroundingLight::around(&state, &vec![0.0; 2_001], ball, DisplayRange::Unit);
    assert_eq!(unseen.shown, 0.0, "no photograph shows the walls");
    assert!(unseen.texels.iter().all(Option::is_none));
}

#[test]
fn parts_that_no_photograph_shows_are_filled() {
    let light = light_in(&room(0.0, |d| d[2] > -0.3));
    assert!((0.6..0.72).contains(&light.shown), "{}", light.shown);
    let last = light.texels[SIZE.0 * SIZE.1 - 1].unwrap();
    assert!(last.iter().all(|v| (v / linear_from_srgb(WALL) - 1.0).abs() < 0.05), "{last:?}");
}

#[test]
fn a_lamp_is_one_source_with_its_direction_and_size() {
    let state = room(0.3, |_| true);
    let light = light_in(&state);
    assert_eq!(light.sources.len(), 1);
    let mut lit = state;
    lit.model.env_raw.fill([-3.0; 3]);
    for (t, _) in &light.sources[0] {
        lit.model.env_raw[*t] = [8.0; 3];
    }
    let lights = light.lights(&lit, 4);
    let away = (0..3).map(|k| lights[0].direction[k] * LAMP[k]).sum::<f32>().acos();
    assert!(lights.len() == 1 && away < 0.05, "{lights:?}");
    assert!((0.2..0.34).contains(&lights[0].radius), "{lights:?}");
    assert!(light.lights(&lit, 0).is_empty());
    for (t, _) in &light.sources[0] {
        lit.model.env_raw[*t] = [-3.0; 3];
    }
    assert!(light.lights(&lit, 4).is_empty(), "the control: a source that is no brighter than white");
}

#[test]
fn two_lamps_are_two_sources_also_where_the_map_begins() {
    let mut state = room(0.0, |_| true);
    for i in 0..2_000 {
        let [x, y, z] = state.model.gaussians.get::<3>(Field::Mean, i);
        // The first and the last column of the map are at -x.
        if (x < -2.8 && z.abs() < 1.0) || y > 2.8 {
            state.model.gaussians.row_mut(Field::Radiance, i).fill(0.5 / 0.282_094_8);
        }
    }
    assert_eq!(light_in(&state).sources.len(), 2);
}

#[test]
fn known_texels_are_set_and_held_and_others_are_released() {
    let (plain, lamp) = (light_in(&room(0.0, |_| true)), light_in(&room(0.3, |_| true)));
    let mut state = room(0.0, |_| true);
    plain.hold(&mut state);
    let wall = linear_from_srgb(WALL);
    let set: Vec<f32> = state.model.env_raw.iter().map(|raw| softplus(raw[1])).collect();
    assert!(set.iter().all(|v| (v / wall - 1.0).abs() < 0.05));
    let squares = |state: &TrainState| state.moments.globals[1][2..].to_vec();
    assert!(squares(&state).iter().all(|v| *v == [HELD; 3]));
    assert_eq!(state.moments.globals[1][..2], [[0.0; 3]; 2], "prototypes train");
    lamp.hold(&mut state);
    let sources: Vec<usize> = lamp.sources[0].iter().map(|(t, _)| *t).collect();
    let released = |t: usize| squares(&state)[t] == [0.0; 3];
    assert!((0..set.len()).all(|t| released(t) == sources.contains(&t)));
    assert!(texel_directions(SIZE.0, SIZE.1).len() == set.len());
}

#[test]
fn a_held_texel_does_not_move() {
    let step = |square: f32| {
        let (mut first, mut second) = (0.0f32, square);
        for _ in 0..30_000 {
            (first, second) = (0.9 * first + 0.1, 0.999 * second + 0.001);
        }
        first / second.sqrt()
    };
    assert!(step(HELD) < 1e-6 && step(0.0) > 0.9, "{} {}", step(HELD), step(0.0));
}
