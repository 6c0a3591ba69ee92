//! Metadata of an image file about its rendering.

use relume_capture::formats::exr_frame::{ExrLens, FrameAttributes};
use relume_scene::Camera;
use relume_spec::rendering::{AlphaMode, Background, Lamp, Quality, Tier};

/// Metadata of an image file about its rendering.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameMetadata {
    /// Name of the model.
    pub model: String,
    /// Identifies the content of the light.
    pub light: String,
    /// Rotation of the light about +Z, degrees counter-clockwise.
    pub rotation_deg: f64,
    /// Exposure of the light, stops.
    pub exposure_ev: f64,
    /// Quality of the rendering.
    pub quality: Quality,
    /// The camera, capture units.
    pub camera: Option<Camera>,
    /// Frame rate of the sequence that the frame belongs to, frames per second.
    pub frames_per_second: Option<u32>,
    /// Height of the ground, capture units, if it was given.
    pub ground_height: Option<f64>,
    /// Lamps beside the light.
    pub lamps: Vec<Lamp>,
}

impl FrameMetadata {
    /// The metadata as EXR attributes.
    pub(super) fn attributes(&self, background: Background, alpha: AlphaMode) -> FrameAttributes {
        let Quality { tier, samples, seed } = self.quality;
        let mut texts = vec![
            ("relume:model", self.model.clone()),
            ("relume:light", self.light.clone()),
            ("relume:light_rotation_deg", self.rotation_deg.to_string()),
            ("relume:exposure_ev", self.exposure_ev.to_string()),
            ("relume:tier", tier.name().to_owned()),
            ("relume:background", background.to_string()),
            ("relume:alpha", alpha.note().to_owned()),
        ];
        if tier == Tier::MonteCarlo {
            texts.push(("relume:samples", format!("{samples} of seed {seed}")));
        }
        if let Some(height) = self.ground_height {
            texts.push(("relume:ground_height", height.to_string()));
        }
        if let (false, Ok(lamps)) = (self.lamps.is_empty(), serde_json::to_string(&self.lamps)) {
            texts.push(("relume:lamps", lamps));
        }
        texts.retain(|(_, text)| !text.is_empty());
        let frames_per_second = self.frames_per_second;
        let Some(camera) = &self.camera else {
            return FrameAttributes { texts, lens: None, frames_per_second };
        };
        let Camera { fx, fy, cx, cy, .. } = camera;
        texts.push(("relume:intrinsics", format!("fx {fx} fy {fy} cx {cx} cy {cy}")));
        texts.push(("relume:camera_axes", "x right, y up, looking along -z (OpenGL)".to_owned()));
        FrameAttributes { texts, lens: lens(camera), frames_per_second }
    }
}

/// A camera as standard attributes; `None` if its values are outside their range.
fn lens(camera: &Camera) -> Option<ExrLens> {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let lens = ExrLens {
        // OpenEXR multiplies row vectors with matrices: its rows are glam's columns.
        world_to_camera: camera.to_opengl().inverse().to_cols_array().map(|v| v as f32),
        window_width: (width / camera.fx) as f32,
        window_centre: [
            ((0.5 * width - camera.cx) / camera.fx) as f32,
            ((camera.cy - 0.5 * height) / camera.fy) as f32,
        ],
        pixel_aspect: (camera.fy / camera.fx) as f32,
    };
    let mut numbers = lens.world_to_camera.iter().chain(&lens.window_centre).chain([&lens.window_width]);
    let fits = numbers.all(|v| v.is_finite()) && (1e-3..=1e3).contains(&lens.pixel_aspect);
    fits.then_some(lens)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec3, Vec4};

    #[test]
    fn exr_lens_attributes_project_like_the_camera() {
        let eye = DVec3::new(3.0, 1.0, 2.0);
        let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, (200, 100)).unwrap();
        let camera = Camera { fx: 150.0, fy: 120.0, cx: 90.0, cy: 55.0, ..camera };
        let lens = lens(&camera).unwrap();
        let rows = lens
            .world_to_camera
            .as_chunks::<4>()
            .0
            .iter()
            .map(|row| Vec4::from_array(*row))
            .collect::<Vec<_>>();
        for (x, y) in [(0, 0), (199, 99), (40, 70)] {
            let point = (eye + camera.ray(x, y) * 2.5).as_vec3();
            let p = rows.iter().zip([point.x, point.y, point.z, 1.0]).map(|(row, v)| *row * v).sum::<Vec4>();
            // On the screen at distance 1, y up, relative to the window's centre.
            let (u, v) = (p.x / -p.z - lens.window_centre[0], p.y / -p.z - lens.window_centre[1]);
            let column = (u / lens.window_width + 0.5) * 200.0;
            let row = (0.5 - v / (lens.window_width * 0.5 / lens.pixel_aspect)) * 100.0;
            assert!((column - x as f32 - 0.5).abs() < 1e-2, "{column} for {x}");
            assert!((row - y as f32 - 0.5).abs() < 1e-2, "{row} for {y}");
        }
    }

    #[test]
    fn cameras_beyond_the_range_of_exr_attributes_are_omitted() {
        let camera = Camera::look_at(DVec3::X * 3.0, DVec3::ZERO, DVec3::Z, 0.8, (20, 10)).unwrap();
        assert!(lens(&camera).is_some());
        assert!(lens(&Camera { translation: DVec3::X * 1e39, ..camera }).is_none());
        assert!(lens(&Camera { fx: 1e9, ..camera }).is_none());
    }
}
