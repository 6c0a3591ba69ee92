//! Image files of the layers of a photograph.

use std::collections::BTreeMap;
use std::path::PathBuf;

use super::DelitPhotograph;
use relume_capture::CaptureView;
use relume_capture::formats::ImageFileError;
use relume_capture::formats::exr_frame::{self, FrameAttributes, FrameLayer, FrameLayers};
use relume_capture::formats::image_file::encode_png;
use relume_capture::formats::png_colour::{PngColour, with_colour};
use relume_scene::srgb;
use relume_spec::rendering::{ColourDepth, LayerFormat, Primaries};

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
        let values = [&self.albedo, &self.model_albedo, &self.shading, &self.shadow, &self.specular];
        std::array::from_fn(|i| (LAYERS[i], values[i].as_slice()))
    }

    fn exr(&self) -> Result<Vec<u8>, ImageFileError> {
        let layer = |(name, values): (&'static str, &'_ [[f32; 3]])| (name, values.as_flattened().to_vec());
        let planes = self.layers().map(layer);
        let mut colour: Vec<FrameLayer<'_>> =
            planes.iter().map(|(name, values)| FrameLayer::new(name, "RGB", values)).collect();
        colour.push(FrameLayer::new("", "A", &self.alpha));
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

/// Names of the layers, each of which has a PNG.
const LAYERS: [&str; 5] = ["albedo", "model_albedo", "shading", "shadow", "specular"];

/// The files that [`DelitPhotograph::files`] returns, by the name of the layer.
pub fn layers_of(format: LayerFormat) -> &'static [&'static str] {
    match format {
        LayerFormat::Exr => &[""],
        LayerFormat::Png => &LAYERS,
    }
}

/// Path of the file of a layer: a folder for each layer, or no folder for a file with all layers, whose `layer` is empty. `stem` is one of
/// [`file_stems`].
pub fn layer_path(layer: &str, stem: &str, format: LayerFormat) -> PathBuf {
    PathBuf::from(layer).join(format!("{stem}.{}", format.extension()))
}

/// File names without an ending, by the names of the photographs: without their ending where that is unique, and with `_` for other
/// characters than letters, digits, `-`, `.` and `_`.
pub fn file_stems(views: &[&CaptureView]) -> BTreeMap<String, String> {
    let plain = |text: &str| -> String {
        let kept = |c: char| if c.is_alphanumeric() || matches!(c, '-' | '.' | '_') { c } else { '_' };
        text.chars().map(kept).collect()
    };
    let short = |name: &str| plain(name.rsplit_once('.').map_or(name, |(stem, _)| stem));
    let mut uses: BTreeMap<String, usize> = BTreeMap::new();
    views.iter().for_each(|view| *uses.entry(short(&view.name)).or_default() += 1);
    let stem = |(index, view): (usize, &&CaptureView)| {
        let short = short(&view.name);
        let stem = if uses[&short] == 1 { short } else { format!("{}_{index}", plain(&view.name)) };
        (view.name.clone(), stem)
    };
    views.iter().enumerate().map(stem).collect()
}
