//! The directions from which a capture was photographed.

use std::collections::BTreeMap;

use glam::DVec3;
use relume_capture::{Capture, CaptureView};

/// Elevation from which on a photograph is taken from above, degrees above the horizon.
pub(super) const ABOVE_DEG: f64 = 40.0;
/// Angle below which two directions are the same, degrees.
const SAME_DEG: f64 = 1e-3;
/// Elevation beyond which the azimuth of a camera does not count, degrees.
const STEEP_DEG: f64 = 75.0;

/// Directions of the cameras, seen from the centre of the region of interest.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Coverage {
    centre: DVec3,
    /// Unit vectors from the centre to the cameras of the training photographs.
    directions: Vec<DVec3>,
    /// True if most cameras look towards the centre. In a room photographed from its middle they do not, and directions
    /// from the centre say nothing.
    pub(super) is_around: bool,
    /// Camera centres of the compared photographs, by name.
    compared: BTreeMap<String, DVec3>,
}

impl Coverage {
    /// The coverage by the training views of `capture`; `compared` are the views whose directions may be asked for.
    pub(super) fn of(capture: &Capture, compared: &[CaptureView]) -> Self {
        let centre = capture.bounds.centre;
        let looks_inwards =
            |view: &&CaptureView| view.camera.forward().dot(centre - view.camera.centre()) > 0.0;
        let inwards = capture.train.iter().filter(looks_inwards).count();
        let direction = |view: &CaptureView| (view.camera.centre() - centre).try_normalize();
        Self {
            centre,
            directions: capture.train.iter().filter_map(direction).collect(),
            is_around: 2 * inwards >= capture.train.len().max(1),
            compared: compared.iter().map(|view| (view.name.clone(), view.camera.centre())).collect(),
        }
    }

    /// Elevation of a compared view above the horizon, and the angle between it and the nearest *other* training
    /// photograph, degrees.
    pub(super) fn direction_of(&self, name: &str) -> Option<(f64, Option<f64>)> {
        let to = (*self.compared.get(name)? - self.centre).try_normalize()?;
        let angles = self.directions.iter().map(|d| d.dot(to).clamp(-1.0, 1.0).acos().to_degrees());
        // A training photograph that is compared is not its own neighbour.
        let nearest = angles.filter(|angle| *angle > SAME_DEG).reduce(f64::min);
        Some((to.z.asin().to_degrees(), nearest))
    }

    /// Number of training photographs from above.
    pub(super) fn views_from_above(&self) -> usize {
        self.directions.iter().filter(|d| d.z.asin().to_degrees() >= ABOVE_DEG).count()
    }

    /// The widest range of azimuth without a training photograph, degrees, 0 to 360. Cameras that are steeply above or
    /// below have no azimuth.
    pub(super) fn azimuth_gap_deg(&self) -> f64 {
        let is_steep = |d: &&DVec3| d.z.asin().to_degrees().abs() > STEEP_DEG;
        let mut azimuths: Vec<f64> = self
            .directions
            .iter()
            .filter(|d| !is_steep(d))
            .map(|d| d.y.atan2(d.x).to_degrees().rem_euclid(360.0))
            .collect();
        azimuths.sort_by(f64::total_cmp);
        let Some((first, last)) = azimuths.first().zip(azimuths.last()) else { return 360.0 };
        let inside = azimuths.windows(2).map(|pair| pair[1] - pair[0]);
        inside.fold(360.0 - (last - first), f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::{BitDepth, Camera, ImageRgba, PackedImage};

    fn view(azimuth_deg: f64, elevation_deg: f64, is_inwards: bool) -> CaptureView {
        let (a, e) = (azimuth_deg.to_radians(), elevation_deg.to_radians());
        let eye = DVec3::new(a.cos() * e.cos(), a.sin() * e.cos(), e.sin()) * 3.0;
        let target = if is_inwards { DVec3::ZERO } else { eye * 2.0 };
        let image = ImageRgba { width: 2, height: 2, pixels: vec![[0.5, 0.5, 0.5, 1.0]; 4] };
        CaptureView {
            name: format!("{azimuth_deg},{elevation_deg}"),
            camera: Camera::look_at(eye, target, DVec3::Z, 0.7, (2, 2)).unwrap(),
            image: PackedImage::new(&image, BitDepth::Eight),
            light_rotation_deg: 0.0,
            light_group: None,
            truth: Default::default(),
        }
    }

    fn coverage(train: Vec<CaptureView>, compared: &[CaptureView]) -> Coverage {
        let bounds = relume_capture::SceneBounds { centre: DVec3::ZERO, radius: 1.0 };
        let capture = Capture {
            layout: String::new(),
            train,
            test: Vec::new(),
            points: Vec::new(),
            bounds,
            up: Default::default(),
            turntable: None,
            has_alpha: false,
            lights: Default::default(),
            measured_light: None,
            grey_card: None,
            colour_chart: None,
            warnings: Vec::new(),
        };
        Coverage::of(&capture, compared)
    }

    #[test]
    fn gaps_and_photographs_from_above_are_measured() {
        let ring = |to: u32| (0..to).map(|i| view(f64::from(i) * 30.0, 10.0, true)).collect::<Vec<_>>();
        let whole = coverage(ring(12), &[]);
        assert!(
            (whole.azimuth_gap_deg() - 30.0).abs() < 1e-6 && whole.views_from_above() == 0 && whole.is_around
        );
        let mut half = ring(7);
        half.push(view(270.0, 89.0, true));
        half.push(view(0.0, 45.0, true));
        let half = coverage(half, &[]);
        assert!((half.azimuth_gap_deg() - 180.0).abs() < 1e-6, "a camera straight above closes no gap");
        assert_eq!(half.views_from_above(), 2);
        assert_eq!(coverage(Vec::new(), &[]).azimuth_gap_deg(), 360.0);
    }

    #[test]
    fn nearest_photograph_is_found_and_is_not_the_view_itself() {
        let train = vec![view(0.0, 0.0, true), view(90.0, 0.0, true)];
        let compared = [view(20.0, 0.0, true), train[0].clone()];
        let coverage = coverage(train, &compared);
        let (elevation, nearest) = coverage.direction_of("20,0").unwrap();
        assert!(elevation.abs() < 1e-6 && (nearest.unwrap() - 20.0).abs() < 1e-6);
        assert!((coverage.direction_of("0,0").unwrap().1.unwrap() - 90.0).abs() < 1e-6);
        assert_eq!(coverage.direction_of("unknown"), None);
    }

    #[test]
    fn cameras_that_look_outwards_are_not_around_the_centre() {
        let outwards = (0..6).map(|i| view(f64::from(i) * 60.0, 0.0, false)).collect();
        assert!(!coverage(outwards, &[]).is_around);
    }
}
