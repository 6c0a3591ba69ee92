//! Image files of the layers of a photograph.

use super::DelitPhotograph;
use relume_capture::formats::ImageFileError;
use relume_capture::formats::exr_frame::{self, FrameAttributes, FrameLayer, FrameLayers};
use relume_capture::formats::image_file::encode_png;
use relume_capture::formats::png_colour::{PngColour, with_colour};
use relume_scene::srgb;
use relume_spec::rendering::{ColourDepth, Primaries};

/// Format of the files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LayerFormat {
    /// One OpenEXR with all layers, linear half floats, straight alpha.
    Exr,
    /// A PNG for each layer: 8 bit with the sRGB curve and straight alpha.
    Png,
}

impl LayerFormat {
    /// Ending of the files.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Exr => "exr",
            Self::Png => "png",
        }
    }
}

impl DelitPhotograph {
    /// The layers as image files, by the name of the layer; the name of a file with all layers is empty.
    ///
    /// # Errors
    /// The encoder's error.
    pub fn files(&self, format: LayerFormat) -> Result<Vec<(&'static str, Vec<u8>)>, ImageFileError> {
        match format {
            LayerFormat::Exr => Ok(vec![("", self.exr()?)]),
            LayerFormat::Png => {
                self.layers().into_iter().map(|(name, values)| Ok((name, self.png(values)?))).collect()
            }
        }
    }

    fn layers(&self) -> [(&'static str, &[[f32; 3]]); 5] {
        [
            ("albedo", &self.albedo),
            ("model_albedo", &self.model_albedo),
            ("shading", &self.shading),
            ("shadow", &self.shadow),
            ("specular", &self.specular),
        ]
    }

    fn exr(&self) -> Result<Vec<u8>, ImageFileError> {
        let layer = |(name, values): (&'static str, &'_ [[f32; 3]])| (name, values.as_flattened().to_vec());
        let planes = self.layers().map(layer);
        let mut colour: Vec<FrameLayer<'_>> =
            planes.iter().map(|(name, values)| FrameLayer { name, suffixes: "RGB", values }).collect();
        colour.push(FrameLayer { name: "", suffixes: "A", values: &self.alpha });
        let attributes = FrameAttributes {
            texts: vec![("relume:alpha", "straight".to_owned())],
            ..FrameAttributes::default()
        };
        let layers = FrameLayers {
            width: self.width,
            height: self.height,
            colour: &colour,
            primaries: Primaries::default(),
            data: &[],
            attributes: &attributes,
        };
        exr_frame::encode_while(&layers, ColourDepth::Half, &|| true)
    }

    fn png(&self, values: &[[f32; 3]]) -> Result<Vec<u8>, ImageFileError> {
        let pixel = |(colour, alpha): (&[f32; 3], &f32)| {
            let [r, g, b] = colour.map(srgb::encode_u8);
            [r, g, b, srgb::to_u8(*alpha)]
        };
        let pixels: Vec<[u8; 4]> = values.iter().zip(&self.alpha).map(pixel).collect();
        with_colour(&encode_png(self.width, self.height, &pixels)?, PngColour::Srgb)
    }
}
