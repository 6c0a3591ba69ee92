//! Decides which direction of a capture is up, and rotates its world so that this direction is +Z, as environment maps need it.

use glam::{DMat4, DQuat, DVec3};

use crate::camera_up::{CameraSource, CameraUp, mean_up, turning_axis};
use crate::formats::ply_points::Point;
use crate::ground_plane::{self, GroundPlane};
use crate::photos::PhotoEntry;
use crate::up_direction::{Choice, Up, WorldUp};

/// Least cosine between +Z and the mean up direction of the cameras for a world that is +Z up, 60 degrees.
const UPRIGHT: f64 = 0.5;
/// Least cosine between the estimated up direction and an axis of the world that it stands for, 20 degrees.
const NEAR_AXIS: f64 = 0.94;
/// Largest distance between the mean up direction of the cameras and +Z in files whose +Z was computed as this mean.
const IS_MEAN: f64 = 1e-6;

/// Whether a layout states which direction of its world is up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum StatedUp {
    /// +Z is up by convention, which some programs ignore.
    PlusZ,
    /// +Z is exactly the mean up direction of the cameras, as instant-ngp's `colmap2nerf.py` writes it: a guess of that program.
    Mean,
    /// The layout has arbitrary axes; the name of the program that chose them.
    No(&'static str),
}

impl StatedUp {
    /// For a layout whose world is +Z up, from all cameras that its file states, photographed or not.
    pub(super) fn plus_z(poses: &[DMat4]) -> Self {
        let is_mean = (mean_up(poses).normalize_or_zero() - DVec3::Z).length() < IS_MEAN;
        if is_mean { Self::Mean } else { Self::PlusZ }
    }
}

/// The direction that is up. `poses` are camera-to-world with OpenGL axes. Where neither `choice` nor the layout states it, it is
/// the normal of the ground in `points`, else the direction in which the cameras were held level, else their mean up direction.
/// Cameras that disagree with the +Z of a layout give a warning.
pub(super) fn upright(
    poses: &[DMat4],
    points: &[Point],
    choice: Up,
    stated: StatedUp,
    warnings: &mut Vec<String>,
) -> WorldUp {
    let program = match (choice.0, stated) {
        (Choice::Direction(direction), _) => return WorldUp::stated(direction),
        (_, StatedUp::PlusZ) => {
            warnings.extend(other_axis(poses, mean_up(poses)));
            return WorldUp::default();
        }
        (Choice::Mean, StatedUp::Mean) => return WorldUp::default(),
        (Choice::Mean, StatedUp::No(program)) => {
            let mean = CameraUp::by_rotation(poses).map(WorldUp::stated);
            return mean.unwrap_or_else(|| kept(program, warnings));
        }
        (Choice::Auto, StatedUp::Mean) => "transforms.json",
        (Choice::Auto, StatedUp::No(program)) => program,
    };
    let Some(cameras) = CameraUp::find(poses) else { return kept(program, warnings) };
    match ground_plane::find(points, poses, &cameras) {
        Some(ground) => WorldUp::found(ground.normal, ground_note(&ground, &cameras, poses)),
        None if stated == StatedUp::Mean && cameras.source == CameraSource::Mean => WorldUp::default(),
        None => WorldUp::found(cameras.direction, camera_note(&cameras, poses, points.len())),
    }
}

/// The axes of the files, with a warning.
fn kept(program: &str, warnings: &mut Vec<String>) -> WorldUp {
    warnings.push(format!(
        "the cameras have no common up direction; the world keeps its {program} axes; state the axis with --up"
    ));
    WorldUp::default()
}

fn ground_note(ground: &GroundPlane, cameras: &CameraUp, poses: &[DMat4]) -> String {
    let from_cameras = match cameras.source {
        CameraSource::Mean => String::new(),
        _ => {
            let angle = degrees(ground.normal, cameras.direction);
            format!(" and {angle} from {}", cameras.source.name())
        }
    };
    let from_mean = degrees(ground.normal, mean_up(poses));
    format!(
        "up: the normal of a plane of {} points, {from_mean} from the mean up direction of the cameras{from_cameras}",
        ground.points
    )
}

fn camera_note(cameras: &CameraUp, poses: &[DMat4], points: usize) -> String {
    let reason = if points == 0 { "there are no sparse points" } else { "no ground was found in the points" };
    let name = cameras.source.name();
    match cameras.source {
        CameraSource::Mean => format!(
            "up: {name}; {reason}, and the cameras were not held level along an arc of 35 degrees or more; state the axis with --up if it leans"
        ),
        _ => {
            let from_mean = degrees(cameras.direction, mean_up(poses));
            format!("up: {name}, {from_mean} from the mean up direction of the cameras; {reason}")
        }
    }
}

impl CameraSource {
    fn name(self) -> &'static str {
        match self {
            Self::Level => "the direction in which the cameras were held level",
            Self::Sideways => "the direction in which the cameras, held sideways, were level",
            Self::Turning => "the axis around which the cameras turn",
            Self::Mean => "the mean up direction of the cameras",
        }
    }
}

/// The angle between two directions in words.
fn degrees(a: DVec3, b: DVec3) -> String {
    if b == DVec3::ZERO {
        return "an unknown angle".to_owned();
    }
    format!("{:.1} degrees", a.angle_between(b).to_degrees())
}

/// Rotates poses and points.
pub(super) fn rotate(rotation: DQuat, photos: &mut [PhotoEntry], points: &mut [Point]) {
    if rotation != DQuat::IDENTITY {
        photos.iter_mut().for_each(|photo| photo.pose = DMat4::from_quat(rotation) * photo.pose);
        points.iter_mut().for_each(|(position, _)| *position = rotation * *position);
    }
}

/// A warning for a world that should be +Z up and is not, with the axis that is up instead, if there is one.
fn other_axis(poses: &[DMat4], mean: DVec3) -> Option<String> {
    let is_common = mean.length() > 0.5;
    if !is_common || mean.normalize().z >= UPRIGHT {
        return None;
    }
    let (_, (name, flag), axis) = AXES
        .into_iter()
        .map(|(name, axis)| (axis.dot(mean), name, axis))
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    let is_axis = turning_axis(poses).is_some_and(|turning| turning.dot(axis).abs() > NEAR_AXIS);
    let cause = if is_axis {
        format!("probably {name} is up: train with --up {flag}")
    } else {
        "state the axis that is up with --up".to_owned()
    };
    Some(format!(
        "the mean up direction of the cameras is ({:.2}, {:.2}, {:.2}), not +Z: environment maps will shine from the side; {cause}",
        mean.x, mean.y, mean.z
    ))
}

/// Axes with their names and the values of `--up`.
const AXES: [((&str, &str), DVec3); 6] = [
    (("+X", "x"), DVec3::X),
    (("+Y", "y"), DVec3::Y),
    (("+Z", "z"), DVec3::Z),
    (("-X", "-x"), DVec3::NEG_X),
    (("-Y", "-y"), DVec3::NEG_Y),
    (("-Z", "-z"), DVec3::NEG_Z),
];

#[cfg(test)]
mod tests {
    use super::*;
    use glam::EulerRot;
    use relume_scene::Camera;
    use relume_spec::training::UpAxis;

    /// Numbers in [-1, 1) that look random (SplitMix64).
    struct Noise(u64);

    impl Noise {
        fn next(&mut self) -> f64 {
            self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = self.0;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        }

        fn vector(&mut self) -> DVec3 {
            DVec3::new(self.next(), self.next(), self.next())
        }
    }

    /// 24 cameras around the origin, over `degrees` of azimuth, 3 units away at an elevation of 30 to 40 degrees, with rolls of at
    /// most `roll` degrees.
    fn arc(degrees: f64, roll: f64) -> Vec<DMat4> {
        let mut noise = Noise(7);
        let mut pose = |i: usize| {
            let angle = (degrees * i as f64 / 24.0).to_radians();
            let elevation = (35.0 + 5.0 * noise.next()).to_radians();
            let eye = DVec3::new(angle.cos(), angle.sin(), elevation.tan()).normalize() * 3.0;
            let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, (8, 6)).unwrap();
            camera.to_opengl() * DMat4::from_rotation_z((roll * noise.next()).to_radians())
        };
        (0..24).map(&mut pose).collect()
    }

    /// A can of 1,200 points whose bottom is at a height of -0.4, and `ground` points of the table under it.
    fn can_on_a_table(ground: usize) -> Vec<Point> {
        let mut noise = Noise(3);
        let mut points = Vec::new();
        for _ in 0..1200 {
            let (angle, height) = (std::f64::consts::PI * noise.next(), 0.4 * noise.next());
            points.push(DVec3::new(0.25 * angle.cos(), 0.25 * angle.sin(), height));
        }
        while points.len() < 1200 + ground {
            let at = DVec3::new(1.5 * noise.next(), 1.5 * noise.next(), -0.4);
            points.extend((at.truncate().length() < 1.5).then_some(at));
        }
        points.iter().map(|point| (*point + 0.004 * noise.vector(), [0.5; 3])).collect()
    }

    /// The world of the files of a test.
    fn away() -> DQuat {
        DQuat::from_euler(EulerRot::XYZ, 0.4, 1.1, -0.6)
    }

    fn rotated(poses: &[DMat4], rotation: DQuat) -> Vec<DMat4> {
        poses.iter().map(|pose| DMat4::from_quat(rotation) * *pose).collect()
    }

    /// The direction found for poses and points in [`away`], and its angle to the true one, degrees.
    fn found(poses: &[DMat4], points: &[Point], choice: Up) -> (f64, String) {
        let points: Vec<Point> = points.iter().map(|(p, colour)| (away() * *p, *colour)).collect();
        let mut warnings = Vec::new();
        let up = upright(&rotated(poses, away()), &points, choice, StatedUp::No("COLMAP"), &mut warnings);
        assert_eq!(warnings, Vec::<String>::new());
        let angle = DVec3::from_array(up.direction).angle_between(away() * DVec3::Z).to_degrees();
        (angle, up.note.unwrap_or_default())
    }

    #[test]
    fn table_under_the_subject_is_level_for_every_arc() {
        for degrees in [60.0, 120.0, 200.0, 360.0] {
            let poses = arc(degrees, 3.0);
            let (angle, note) = found(&poses, &can_on_a_table(400), Up::AUTO);
            assert!(angle < 0.5, "{degrees}: {angle}");
            assert!(note.starts_with("up: the normal of a plane of 4"), "{note}");
            let (mean, _) = found(&poses, &can_on_a_table(400), Up::MEAN);
            assert!(degrees == 360.0 || mean > 5.0, "the control, {degrees}: {mean}");
        }
    }

    #[test]
    fn plane_is_found_among_outliers_and_reflections() {
        let mut points = can_on_a_table(400);
        let mut noise = Noise(5);
        points.extend((0..500).map(|_| (2.0 * noise.vector(), [0.5; 3])));
        points.extend((0..100).map(|_| (DVec3::new(0.2, 0.2, -0.8) + 0.2 * noise.vector(), [0.5; 3])));
        points.extend((0..500).map(|_| (50.0 * noise.vector(), [0.5; 3])));
        let (angle, note) = found(&arc(120.0, 3.0), &points, Up::AUTO);
        assert!(angle < 1.0 && note.contains("plane"), "{angle} {note}");
    }

    #[test]
    fn cameras_held_level_decide_without_a_ground() {
        for degrees in [60.0, 120.0, 200.0, 360.0] {
            let (angle, note) = found(&arc(degrees, 3.0), &[], Up::AUTO);
            assert!(angle < 3.0 && note.contains("held level"), "{degrees}: {angle} {note}");
            assert!(note.ends_with("there are no sparse points"), "{note}");
        }
        let (short, note) = found(&arc(20.0, 3.0), &[], Up::AUTO);
        assert!(short > 20.0 && note.contains("not held level along an arc"), "{short} {note}");
        let (ground, _) = found(&arc(20.0, 3.0), &can_on_a_table(400), Up::AUTO);
        assert!(ground < 0.5, "with points: {ground}");
    }

    /// Points with a level for cameras of an arc that are no ground: the name, and the points.
    fn without_ground() -> Vec<(&'static str, Vec<Point>)> {
        let mut noise = Noise(11);
        let mut shuffled = can_on_a_table(400);
        for axis in 0..3 {
            for i in (1..shuffled.len()).rev() {
                let j = ((noise.next() + 1.0) / 2.0 * (i + 1) as f64) as usize;
                let kept = shuffled[i].0[axis];
                shuffled[i].0[axis] = shuffled[j].0[axis];
                shuffled[j].0[axis] = kept;
            }
        }
        // The heights of the table are still those of the table.
        shuffled.iter_mut().for_each(|point| point.0.z += 0.5 * noise.next());
        let tilt = DQuat::from_rotation_x(0.5);
        let sloped = can_on_a_table(400).into_iter().map(|(p, colour)| (tilt * p, colour)).collect();
        let mut wall = can_on_a_table(0);
        wall.extend((0..2000).map(|_| {
            (DVec3::new(-0.6 + 0.004 * noise.next(), 1.5 * noise.next(), 1.5 * noise.next()), [0.5; 3])
        }));
        let ball = (0..2000).map(|_| (noise.vector(), [0.5; 3])).collect();
        vec![
            ("shuffled", shuffled),
            ("sloped", sloped),
            ("wall", wall),
            ("ball", ball),
            ("can", can_on_a_table(0)),
            ("few", can_on_a_table(400).split_off(1510)),
        ]
    }

    #[test]
    fn points_without_a_ground_leave_the_cameras_direction() {
        for (name, points) in without_ground() {
            let (angle, note) = found(&arc(120.0, 3.0), &points, Up::AUTO);
            assert!(note.ends_with("no ground was found in the points"), "{name}: {note}");
            assert!(angle < 2.0, "{name}: {angle}");
        }
        let (_, note) = found(&arc(120.0, 3.0), &can_on_a_table(400), Up::AUTO);
        assert!(note.contains("plane"), "the control: {note}");
    }

    #[test]
    fn cameras_held_sideways_give_the_upright_world() {
        for (degrees, ground) in [(360.0, 0), (360.0, 400), (120.0, 0), (120.0, 400)] {
            for roll in [0.0, 90.0, -90.0, 180.0f64] {
                let held = |pose: &DMat4| *pose * DMat4::from_rotation_z(roll.to_radians());
                let poses: Vec<_> = arc(degrees, 2.0).iter().map(held).collect();
                let (angle, note) = found(&poses, &can_on_a_table(ground), Up::AUTO);
                // Held upside down, the world is upside down as well: nothing tells which is meant.
                let angle = if roll == 180.0 { 180.0 - angle } else { angle };
                assert!(angle < 2.0, "{degrees} {roll} {ground}: {angle} {note}");
                assert!(roll.abs() != 90.0 || note.contains("held sideways"), "{note}");
            }
        }
    }

    #[test]
    fn constant_roll_over_a_full_circle_keeps_its_axis() {
        for roll in [30.0, 60.0, 120.0f64] {
            let held = |pose: &DMat4| *pose * DMat4::from_rotation_z(roll.to_radians());
            let poses: Vec<_> = arc(360.0, 1.0).iter().map(held).collect();
            let (angle, note) = found(&poses, &[], Up::AUTO);
            let angle = if roll > 90.0 { 180.0 - angle } else { angle };
            assert!(angle < 2.0, "{roll}: {angle} {note}");
            let (ground, note) = found(&poses, &can_on_a_table(400), Up::AUTO);
            assert!(roll > 90.0 || (ground < 0.5 && note.contains("plane")), "{roll}: {ground} {note}");
        }
    }

    #[test]
    fn recorded_direction_gives_the_same_world_again() {
        let (poses, points) = (rotated(&arc(120.0, 3.0), away()), can_on_a_table(0));
        let up = |choice| upright(&poses, &points, choice, StatedUp::No("COLMAP"), &mut Vec::new());
        let first = up(Up::AUTO);
        let again = up(Up::direction(first.direction).unwrap());
        assert_eq!((again.rotation(), again.note), (first.rotation(), None));
        assert!(up(Up::MEAN).rotation().angle_between(first.rotation()) > 0.1, "the control");
    }

    #[test]
    fn plus_z_that_is_the_cameras_mean_is_no_statement() {
        let poses = arc(120.0, 3.0);
        let mean = DQuat::from_rotation_arc(mean_up(&poses).normalize(), DVec3::Z);
        let leaning = rotated(&poses, mean);
        let of =
            |poses: &[DMat4], choice| upright(poses, &[], choice, StatedUp::plus_z(poses), &mut Vec::new());
        let up = of(&leaning, Up::AUTO);
        assert!(DVec3::from_array(up.direction).angle_between(mean * DVec3::Z).to_degrees() < 2.0, "{up:?}");
        assert_eq!(of(&leaning, Up::MEAN), WorldUp::default(), "as in models without a recorded direction");
        assert_eq!(of(&poses, Up::AUTO), WorldUp::default(), "the control: a world that is +Z up");
        assert!(mean_up(&leaning).angle_between(mean * DVec3::Z).to_degrees() > 10.0);
    }

    #[test]
    fn world_of_another_axis_is_reported_with_the_axis() {
        let poses = arc(360.0, 0.0);
        let of = |poses: &[DMat4], choice: Up| {
            let mut warnings = Vec::new();
            (upright(poses, &[], choice, StatedUp::PlusZ, &mut warnings).rotation(), warnings)
        };
        assert_eq!(of(&poses, Up::AUTO), (DQuat::IDENTITY, Vec::new()));
        for ((name, flag), axis) in AXES.into_iter().filter(|((name, _), _)| *name != "+Z") {
            let poses = rotated(&poses, DQuat::from_rotation_arc(DVec3::Z, axis));
            let (turn, warnings) = of(&poses, Up::AUTO);
            let expected = format!("probably {name} is up: train with --up {flag}");
            assert!(turn == DQuat::IDENTITY && warnings.len() == 1, "{warnings:?}");
            assert!(warnings[0].ends_with(&expected), "{warnings:?}");
            let choice: UpAxis = serde_json::from_value(flag.into()).unwrap();
            let (turn, warnings) = of(&poses, choice.into());
            assert!((turn * axis - DVec3::Z).length() < 1e-12 && warnings.is_empty(), "{name}: {turn}");
        }
    }

    #[test]
    fn unclear_cameras_give_a_warning_without_an_axis() {
        let away = DQuat::from_rotation_z(0.8) * DQuat::from_rotation_x(1.5);
        let mut warnings = Vec::new();
        let kept = upright(&rotated(&arc(360.0, 0.0), away), &[], Up::AUTO, StatedUp::PlusZ, &mut warnings);
        assert_eq!(kept.rotation(), DQuat::IDENTITY);
        assert!(
            warnings.len() == 1 && warnings[0].ends_with("state the axis that is up with --up"),
            "{warnings:?}"
        );
    }

    #[test]
    fn numbers_that_are_not_finite_give_no_direction() {
        let mut poses = arc(120.0, 0.0);
        let mut points = can_on_a_table(400);
        points[0].0 = DVec3::NAN;
        poses[0] = DMat4::from_cols_array(&[f64::NAN; 16]);
        let up = upright(&poses, &points, Up::AUTO, StatedUp::No("COLMAP"), &mut Vec::new());
        assert!(up.rotation().is_finite(), "{up:?}");
    }
}
