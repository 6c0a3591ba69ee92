//! Writes a capture and its ground truth as a zip in TensoIR's layout, which [`crate::import`] reads.

use std::io::{Cursor, Write};

use serde_json::json;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use crate::formats::image_file::{encode_png, encode_png16, encode_rgba};
use crate::formats::{ImageFileError, environment};
use crate::truth::DEPTH_RANGE;
use crate::{Capture, CaptureError, CaptureView, GroundTruthView};
use relume_scene::{PackedImage, Plane, srgb};

/// Writes images as 8-bit PNG, depth as 16-bit PNG, lights as Radiance files. Equal captures give equal bytes.
///
/// # Errors
/// [`CaptureError`] names the entry that cannot be written, e.g. for an image without pixels.
pub fn write_archive(capture: &Capture) -> Result<Vec<u8>, CaptureError> {
    let mut archive = Archive(ZipWriter::new(Cursor::new(Vec::new())));
    for (split, views) in [("train", &capture.train), ("test", &capture.test)] {
        archive.json(&format!("transforms_{split}.json"), &transforms(split, views))?;
        for (i, view) in views.iter().enumerate() {
            archive.view(&format!("{split}_{i:03}"), view)?;
        }
    }
    let scene = json!({
        "albedo_png": "sRGB-encoded base color",
        "normal_png": "world space, n*0.5+0.5",
        "ao_png": "linear cosine-weighted sky visibility",
        "metallic_roughness_png": "R metallic, G roughness, linear",
        "depth_png": "16 bit, value/65535*10 = distance along the view axis",
        "relight": capture.lights.keys().collect::<Vec<_>>(),
    });
    archive.json("scene.json", &scene)?;
    for (name, map) in &capture.lights {
        let file = format!("envmaps/{name}.hdr");
        let bytes = environment::encode_hdr(map).map_err(|e| broken(&file, e))?;
        archive.file(&file, &bytes, CompressionMethod::Deflated)?;
    }
    archive.finish()
}

/// The set's JSON. Each frame has its intrinsics; the shared field of view is for other readers.
fn transforms(split: &str, views: &[CaptureView]) -> serde_json::Value {
    let frame = |(i, view): (usize, &CaptureView)| {
        let c = &view.camera;
        let mut frame = json!({
            "file_path": format!("./{split}_{i:03}/rgba"),
            "transform_matrix": c.to_opengl().transpose().to_cols_array_2d(),
            "w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy,
            "light_rotation_deg": view.light_rotation_deg,
        });
        if let Some(group) = &view.light_group {
            frame["light_group"] = json!(group);
        }
        frame
    };
    let angle = |v: &CaptureView| 2.0 * (0.5 * f64::from(v.camera.width) / v.camera.fx).atan();
    json!({
        "camera_angle_x": views.first().map(angle),
        "frames": views.iter().enumerate().map(frame).collect::<Vec<_>>(),
    })
}

struct Archive(ZipWriter<Cursor<Vec<u8>>>);

impl Archive {
    fn file(&mut self, name: &str, bytes: &[u8], method: CompressionMethod) -> Result<(), CaptureError> {
        let options = SimpleFileOptions::default().compression_method(method);
        self.0.start_file(name, options).map_err(|e| broken(name, e))?;
        self.0.write_all(bytes).map_err(|e| broken(name, e))
    }

    fn json(&mut self, name: &str, value: &serde_json::Value) -> Result<(), CaptureError> {
        self.file(name, value.to_string().as_bytes(), CompressionMethod::Deflated)
    }

    /// Writes an image uncompressed, since PNG is already compressed.
    fn png(&mut self, name: &str, bytes: Result<Vec<u8>, ImageFileError>) -> Result<(), CaptureError> {
        self.file(name, &bytes.map_err(|e| broken(name, e))?, CompressionMethod::Stored)
    }

    fn view(&mut self, folder: &str, view: &CaptureView) -> Result<(), CaptureError> {
        self.png(&format!("{folder}/rgba.png"), encode_rgba(&view.image.decoded()))?;
        for (light, image) in &view.truth.relit {
            self.png(&format!("{folder}/rgba_{light}.png"), encode_rgba(image))?;
        }
        self.layers(folder, &view.truth, &view.image)
    }

    /// Layers have the photograph's alpha, as in TensoIR's sets.
    fn layers(
        &mut self,
        folder: &str,
        truth: &GroundTruthView,
        image: &PackedImage,
    ) -> Result<(), CaptureError> {
        if let Some(plane) = &truth.albedo {
            self.png(&format!("{folder}/albedo.png"), layer(plane, image, |v| v.map(srgb::encode)))?;
        }
        if let Some(plane) = &truth.normal {
            self.png(&format!("{folder}/normal.png"), layer(plane, image, |v| v.map(|x| 0.5 * x + 0.5)))?;
        }
        if let Some(plane) = &truth.metallic_roughness {
            let colour = |v: [f32; 2]| [v[0], v[1], 0.0];
            self.png(&format!("{folder}/metallic_roughness.png"), layer(plane, image, colour))?;
        }
        if let Some(plane) = &truth.ambient_occlusion {
            self.png(&format!("{folder}/ao.png"), layer(plane, image, |v| [v[0]; 3]))?;
        }
        if let Some(plane) = &truth.depth {
            let level = |v: &[f32; 1]| [(v[0] / DEPTH_RANGE * 65_535.0 + 0.5) as u16];
            let levels: Vec<[u16; 1]> = plane.values.iter().map(level).collect();
            self.png(&format!("{folder}/depth.png"), encode_png16(plane.width, plane.height, &levels))?;
        }
        Ok(())
    }

    fn finish(self) -> Result<Vec<u8>, CaptureError> {
        Ok(self.0.finish().map_err(|e| broken("the archive", e))?.into_inner())
    }
}

/// A layer as 8-bit RGBA with the image's alpha.
fn layer<const C: usize>(
    plane: &Plane<C>,
    image: &PackedImage,
    colour: impl Fn([f32; C]) -> [f32; 3],
) -> Result<Vec<u8>, ImageFileError> {
    let pixel = |(v, p): (&[f32; C], [f32; 4])| {
        let [r, g, b] = colour(*v);
        [r, g, b, p[3]].map(srgb::to_u8)
    };
    let pixels: Vec<[u8; 4]> = plane.values.iter().zip(image.pixels()).map(pixel).collect();
    encode_png(plane.width, plane.height, &pixels)
}

fn broken(file: &str, reason: impl std::fmt::Display) -> CaptureError {
    CaptureError::File { file: file.to_owned(), reason: format!("cannot be written: {reason}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ImportOptions, SyntheticOptions, import, synthetic};
    use relume_compare::largest_difference;

    fn apart<const C: usize>(a: &[[f32; C]], b: &[[f32; C]]) -> f64 {
        largest_difference(a.as_flattened(), b.as_flattened())
    }

    #[test]
    fn importer_reads_back_a_written_archive() {
        let options =
            SyntheticOptions { train_views: 4, test_views: 2, size: 40, paths: 8, ..Default::default() };
        let capture = synthetic(&options).unwrap();
        let bytes = write_archive(&capture).unwrap();
        assert_eq!(bytes, write_archive(&capture).unwrap());
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        let back = import(file.path(), &ImportOptions::default()).unwrap();
        assert_eq!((back.layout.as_str(), back.warnings.len(), back.has_alpha), ("tensoir", 0, true));
        assert_eq!(back.lights.keys().collect::<Vec<_>>(), capture.lights.keys().collect::<Vec<_>>());
        assert!((back.bounds.radius - capture.bounds.radius).abs() < 0.3, "{:?}", back.bounds);
        let half_level = 0.51 / 255.0;
        for (a, b) in capture.train.iter().chain(&capture.test).zip(back.train.iter().chain(&back.test)) {
            assert_eq!(a.name, b.name);
            assert!((a.camera.translation - b.camera.translation).length() < 1e-9);
            assert!((a.camera.fx - b.camera.fx).abs() < 1e-9 && a.camera.width == b.camera.width);
            assert!(apart(&a.image.decoded().pixels, &b.image.decoded().pixels) < half_level);
        }
        for (a, b) in capture.test.iter().zip(&back.test) {
            let (a, b) = (&a.truth, &b.truth);
            for (light, image) in &a.relit {
                assert!(apart(&image.pixels, &b.relit[light].pixels) < half_level);
            }
            let (x, y) = (a.albedo.as_ref().unwrap(), b.albedo.as_ref().unwrap());
            assert!(apart(&x.values, &y.values) < 0.006);
            let (x, y) = (a.normal.as_ref().unwrap(), b.normal.as_ref().unwrap());
            assert!(apart(&x.values, &y.values) < 0.012);
            let (x, y) = (a.metallic_roughness.as_ref().unwrap(), b.metallic_roughness.as_ref().unwrap());
            assert!(apart(&x.values, &y.values) < half_level);
            let (x, y) = (a.ambient_occlusion.as_ref().unwrap(), b.ambient_occlusion.as_ref().unwrap());
            assert!(apart(&x.values, &y.values) < half_level);
            let (x, y) = (a.depth.as_ref().unwrap(), b.depth.as_ref().unwrap());
            assert!(apart(&x.values, &y.values) < 1e-4);
        }
        // The comparison can fail: two different views differ strongly.
        assert!(apart(&capture.train[0].image.decoded().pixels, &back.train[1].image.decoded().pixels) > 0.1);
    }
}
