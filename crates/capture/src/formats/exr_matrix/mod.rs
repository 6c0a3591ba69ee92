//! Light matrices as multi-part OpenEXR: part `alpha`, then one part for each lobe and each small light (docs/guide/light_matrix.md).

mod read;
mod write;

use relume_scene::SplitLight;

pub use read::{MatrixHeader, read_header};
pub use write::{MatrixFile, MatrixFileError, StripWriter, write};

/// Name of the part with the coverage.
pub const ALPHA: &str = "alpha";
/// Attribute with the direction of a part.
const DIRECTION: &str = "relume:direction";
/// Attribute with the solid angle of a lobe, steradian.
const SOLID_ANGLE: &str = "relume:solid_angle_sr";
/// Attribute with the angular radius of a small light, degrees.
const RADIUS: &str = "relume:radius_deg";
/// Attribute with the meaning of the weight of a part.
const WEIGHT: &str = "relume:weight";

/// A light of a matrix.
#[derive(Debug, Clone, PartialEq)]
pub enum MatrixLightPart {
    /// A lobe of radiance 1.
    Lobe {
        /// Unit direction of its middle.
        direction: [f32; 3],
        /// Solid angle, steradian.
        solid_angle: f32,
    },
    /// A small light of irradiance 1.
    Sun(SplitLight),
}

impl MatrixLightPart {
    /// Unit direction.
    pub fn direction(&self) -> [f32; 3] {
        match self {
            Self::Lobe { direction, .. } => *direction,
            Self::Sun(light) => light.direction,
        }
    }

    /// Meaning of its weight.
    fn weight(&self) -> &'static str {
        match self {
            Self::Lobe { .. } => "mean radiance of the environment over the lobe, linear Rec.709",
            Self::Sun(_) => "irradiance of the light on a surface that faces it, linear Rec.709",
        }
    }

    /// Name of the part, also that of its layer: `lobe001_az045_ze102` with the number from 1, the azimuth counter-clockwise from +X
    /// and the angle from +Z, whole degrees. Only letters, digits and `_`, which every compositor accepts.
    pub fn name(&self, number: usize) -> String {
        let [x, y, z] = self.direction().map(f64::from);
        let azimuth = y.atan2(x).to_degrees().rem_euclid(360.0).round() as u32 % 360;
        let zenith = z.clamp(-1.0, 1.0).acos().to_degrees().round() as u32;
        let kind = match self {
            Self::Lobe { .. } => "lobe",
            Self::Sun(_) => "sun",
        };
        format!("{kind}{number:03}_az{azimuth:03}_ze{zenith:03}")
    }
}

/// Names of the parts of `lights`, lobes and small lights numbered separately from 1.
pub fn names(lights: &[MatrixLightPart]) -> Vec<String> {
    let (mut lobes, mut suns) = (0, 0);
    let named = lights.iter().map(|light| {
        let number = if matches!(light, MatrixLightPart::Lobe { .. }) { &mut lobes } else { &mut suns };
        *number += 1;
        light.name(*number)
    });
    named.collect()
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use exr::prelude::{AnyChannels, FlatSamples, Image, ReadChannels, ReadLayers};

    use super::*;
    use crate::formats::ImageFileError;
    use crate::formats::exr_frame::{self, FrameAttributes, FrameLayer, FrameLayers};
    use relume_spec::rendering::{ColourDepth, Primaries};

    const SIZE: (u32, u32) = (5, 37);

    fn lights() -> Vec<MatrixLightPart> {
        let lobe = |direction| MatrixLightPart::Lobe { direction, solid_angle: 6.0 };
        let sun = SplitLight { direction: [0.0, -1.0, 0.0], radius: 0.5f32.to_radians() };
        vec![lobe([0.6, 0.0, 0.8]), lobe([-0.6, 0.0, -0.8]), MatrixLightPart::Sun(sun)]
    }

    /// The value of a channel of a pixel.
    fn value(part: usize, c: usize, y: usize, x: usize) -> f32 {
        part as f32 + 0.25 * c as f32 - y as f32 + 0.125 * x as f32
    }

    fn encode(depth: ColourDepth, is_wanted: &(dyn Fn() -> bool + Sync)) -> Result<Vec<u8>, MatrixFileError> {
        let attributes = FrameAttributes {
            texts: vec![("relume:model", "m".to_owned()), ("relume:tier", "standard".to_owned())],
            ..FrameAttributes::default()
        };
        let lights = lights();
        let file =
            MatrixFile { width: SIZE.0, height: SIZE.1, lights: &lights, depth, attributes: &attributes };
        let mut out = Cursor::new(Vec::new());
        write(&mut out, &file, is_wanted, |strips| {
            for parts in [0..1, 1..3, 3..4] {
                let channels = if parts.start == 0 { 1 } else { 3 };
                let first = parts.start;
                strips.write(parts.clone(), &|strip| {
                    let rows = (SIZE.1 as usize - 16 * strip).min(16);
                    let of = |part: usize| {
                        (0..channels).flat_map(move |c| {
                            (0..rows * 5).map(move |i| value(first + part, c, 16 * strip + i / 5, i % 5))
                        })
                    };
                    (0..parts.len()).flat_map(of).collect()
                })?;
            }
            Ok(())
        })?;
        Ok(out.into_inner())
    }

    fn read(bytes: &[u8]) -> Image<exr::image::Layers<AnyChannels<FlatSamples>>> {
        let reader = exr::prelude::read().no_deep_data().largest_resolution_level();
        reader.all_channels().all_layers().all_attributes().from_buffered(Cursor::new(bytes)).unwrap()
    }

    #[test]
    fn parts_of_a_matrix_read_back() {
        let bytes = encode(ColourDepth::Full, &|| true).unwrap();
        let image = read(&bytes);
        let names = ["alpha", "lobe001_az000_ze037", "lobe002_az180_ze143", "sun001_az270_ze090"];
        assert_eq!(image.layer_data.len(), 4);
        for (part, (layer, name)) in image.layer_data.iter().zip(names).enumerate() {
            assert_eq!(layer.attributes.layer_name.as_ref().unwrap().to_string(), name);
            for channel in &layer.channel_data.list {
                let full = channel.name.to_string();
                let c = ["R", "G", "B"].iter().position(|s| full == format!("{name}.{s}"));
                let c = c.unwrap_or_else(|| if full == "A" { 0 } else { panic!("{full}") });
                for (i, found) in channel.sample_data.values_as_f32().enumerate() {
                    assert_eq!(found, value(part, c, i / 5, i % 5), "{full} {i}");
                }
            }
        }
    }

    #[test]
    fn the_header_states_the_lights() {
        let bytes = encode(ColourDepth::Half, &|| true).unwrap();
        let header = read_header(&bytes[..]).unwrap();
        assert_eq!(((header.width, header.height), header.lights), (SIZE, lights()));
        assert_eq!(header.names, names(&lights()));
        assert!(matches!(read_header(&b"not an EXR"[..]), Err(ImageFileError::Damaged(_))));
        assert!(matches!(read_header(&bytes[..100]), Err(ImageFileError::Damaged(_))), "a part of a header");
        let values = [0.5f32; 5 * 37];
        let layer = FrameLayer::new("", "A", &values);
        let attributes = FrameAttributes::default();
        let frame = FrameLayers {
            width: SIZE.0,
            height: SIZE.1,
            colour: &[layer],
            data: &[],
            primaries: Primaries::Rec709,
            attributes: &attributes,
        };
        let frame = exr_frame::encode(&frame, ColourDepth::Half).unwrap();
        let refused = read_header(&frame[..]).unwrap_err().to_string();
        assert!(refused.starts_with("is not a light matrix: part \"beauty\""), "{refused}");
    }

    #[test]
    fn equal_matrices_give_equal_bytes() {
        let encoded = |threads: usize, depth| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| encode(depth, &|| true).unwrap())
        };
        let first = encoded(1, ColourDepth::Half);
        assert!((1..4).all(|threads| encoded(threads, ColourDepth::Half) == first));
        assert!(encoded(1, ColourDepth::Full) != first, "the control");
    }

    #[test]
    fn writing_stops_when_cancelled() {
        assert!(matches!(encode(ColourDepth::Half, &|| false), Err(MatrixFileError::Abandoned)));
    }
}
