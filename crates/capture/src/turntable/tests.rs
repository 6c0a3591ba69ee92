use super::*;
use crate::types::GroundTruthView;
use relume_scene::{BitDepth, ImageRgba};

const SIZE: u32 = 64;

/// What stands still relative to the camera.
#[derive(Clone, Copy, PartialEq)]
enum Background {
    Still,
    Moving,
    Plain,
    /// Black, with a nearly transparent edge of the subject, which stays in the middle of the picture.
    SoftEdge,
}

/// A camera at `azimuth` degrees that looks at the origin.
fn camera(azimuth: f64, elevation: f64) -> Camera {
    let (a, e) = (azimuth.to_radians(), elevation.to_radians());
    let centre = 4.0 * DVec3::new(e.cos() * a.cos(), e.cos() * a.sin(), e.sin());
    Camera::look_at(centre, DVec3::ZERO, DVec3::Z, 0.8, (SIZE, SIZE)).unwrap()
}

/// A photograph whose mask hides everything but a disc. Its background has stripes that start at `offset` pixels.
fn view(name: usize, camera: Camera, offset: usize, background: Background) -> CaptureView {
    let pixel = |i: usize| {
        let (x, y) = (i % SIZE as usize, i / SIZE as usize);
        let (dx, dy) = (x as f32 - 31.5, y as f32 - 31.5);
        let stripe = if background == Background::Plain { 0 } else { (x + offset) * (x + offset + y) % 13 };
        let level = 0.2 + 0.05 * stripe as f32;
        match dx.hypot(dy) {
            radius if radius < 14.0 => [level, 0.5 * level, 0.3, 1.0],
            radius if background == Background::SoftEdge && radius < 18.0 => [0.9, 0.8, 0.7, 0.004],
            _ if background == Background::SoftEdge => [0.0; 4],
            _ => [level, 0.5 * level, 0.3, 0.0],
        }
    };
    let pixels = (0..(SIZE * SIZE) as usize).map(pixel).collect();
    let image = PackedImage::new(&ImageRgba { width: SIZE, height: SIZE, pixels }, BitDepth::Eight);
    let truth = GroundTruthView::default();
    CaptureView {
        name: format!("{name:03}.jpg"),
        camera,
        image,
        light_rotation_deg: 0.0,
        light_group: None,
        truth,
    }
}

/// Sixteen photographs all around.
fn around(background: Background) -> Vec<CaptureView> {
    let one = |i: usize| {
        let offset = if background == Background::Moving { 9 * i } else { 0 };
        view(i, camera(40.0 + 22.5 * i as f64, 20.0), offset, background)
    };
    (0..16).map(one).collect()
}

fn derive(views: &mut [CaptureView], choice: TurntableCapture) -> Result<Option<String>, CaptureError> {
    derive_rotations(&mut views.iter_mut().collect::<Vec<_>>(), choice)
}

#[test]
fn light_rotates_with_the_camera_if_the_background_is_still() {
    let mut views = around(Background::Still);
    views.reverse();
    let note = derive(&mut views, TurntableCapture::Auto).unwrap().unwrap();
    assert!(note.contains("over 338 degrees") && note.contains("turntable_capture to `no`"), "{note}");
    for view in &views {
        let i: f64 = view.name[..3].parse().unwrap();
        let difference = (view.light_rotation_deg - 22.5 * i).rem_euclid(360.0);
        assert!(difference.min(360.0 - difference) < 1e-6, "{}: {}", view.name, view.light_rotation_deg);
    }
}

#[test]
fn light_stands_still_without_evidence_or_by_choice() {
    for (background, choice) in [
        (Background::Moving, TurntableCapture::Auto),
        (Background::Plain, TurntableCapture::Auto),
        (Background::SoftEdge, TurntableCapture::Auto),
        (Background::Still, TurntableCapture::No),
    ] {
        let mut views = around(background);
        assert_eq!(derive(&mut views, choice).unwrap(), None);
        assert!(views.iter().all(|view| view.light_rotation_deg == 0.0));
    }
    let mut few = around(Background::Still)[..4].to_vec();
    assert_eq!(derive(&mut few, TurntableCapture::Auto).unwrap(), None, "three pairs");
}

#[test]
fn stated_turntable_needs_turning_cameras_and_no_rotations() {
    let mut views = around(Background::Plain);
    assert!(derive(&mut views, TurntableCapture::Yes).unwrap().is_some());
    assert!(views[4].light_rotation_deg > 89.0);
    let again = derive(&mut views, TurntableCapture::Yes).unwrap_err();
    assert!(again.field() == Some(FIELD) && again.to_string().contains("state rotations"), "{again}");
    assert_eq!(derive(&mut views, TurntableCapture::Auto).unwrap(), None, "stated rotations are kept");
    let mut still: Vec<_> =
        (0..9).map(|i| view(i, camera(30.0, 5.0 * i as f64), 0, Background::Still)).collect();
    let error = derive(&mut still, TurntableCapture::Yes).unwrap_err().to_string();
    assert!(error.contains("span 0 degrees"), "{error}");
}

#[test]
fn turns_of_cameras_at_several_heights_are_their_azimuths() {
    let cameras: Vec<Camera> =
        (0..20).map(|i| camera(17.0 * f64::from(i), 10.0 + 30.0 * f64::from(i % 3))).collect();
    let found = turns(&cameras);
    for (i, degrees) in found.degrees.iter().enumerate() {
        let difference = (degrees - 17.0 * i as f64).rem_euclid(360.0);
        assert!(difference.min(360.0 - difference) < 1e-6, "{i}: {degrees}");
    }
    assert!((found.tilt_deg - 30.0).abs() < 1e-6, "{}", found.tilt_deg);
    assert!((found.span_deg() - 323.0).abs() < 1e-6, "{}", found.span_deg());
}
