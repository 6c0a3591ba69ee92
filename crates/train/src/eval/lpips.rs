//! LPIPS v0.1 with an AlexNet backbone (Zhang et al. 2018): a learned perceptual distance between two images.

use std::path::{Path, PathBuf};

use safetensors::SafeTensors;
use safetensors::tensor::Dtype;

use crate::eval::conv::{Conv, FeatureMaps, max_pool};
use crate::eval::image::DisplayImage;

/// The network's input normalisation, for RGB in [-1, 1].
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

/// Smallest side in pixels for which the deepest layer has one pixel.
const MIN_SIDE: u32 = 31;

/// The five convolutions: weight name, kernel, stride, padding, output channels, input channels.
const LAYERS: [(&str, usize, usize, usize, usize, usize); 5] = [
    ("features.0", 11, 4, 2, 64, 3),
    ("features.3", 5, 1, 2, 192, 64),
    ("features.6", 3, 1, 1, 384, 192),
    ("features.8", 3, 1, 1, 256, 384),
    ("features.10", 3, 1, 1, 256, 256),
];

/// Errors of reading the weights.
#[derive(Debug, thiserror::Error)]
pub enum LpipsError {
    /// The file could not be read.
    #[error("LPIPS weights {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// The file is not a safetensors file.
    #[error("LPIPS weights: {0}")]
    Container(#[from] safetensors::SafeTensorError),
    /// A tensor is missing or has another shape.
    #[error("LPIPS weights: tensor {name}: {reason}")]
    Tensor {
        /// The tensor.
        name: String,
        /// The reason.
        reason: String,
    },
}

/// The metric with its weights. Build it once and share it between threads.
pub struct Lpips {
    convs: Vec<Conv>,
    heads: Vec<Vec<f32>>,
}

impl Lpips {
    /// Reads the weights from a safetensors file (torchvision names, OIHW, f32; heads `lin0` to `lin4`).
    ///
    /// # Errors
    /// Names the file, or the tensor that is missing or has another shape.
    pub fn read(path: &Path) -> Result<Self, LpipsError> {
        let bytes = std::fs::read(path).map_err(|source| LpipsError::Read { path: path.into(), source })?;
        Self::decode(&bytes)
    }

    /// Reads the weights from the bytes of a safetensors file.
    ///
    /// # Errors
    /// Names the tensor that is missing or has another shape.
    pub fn decode(bytes: &[u8]) -> Result<Self, LpipsError> {
        let file = SafeTensors::deserialize(bytes)?;
        let (mut convs, mut heads) = (Vec::new(), Vec::new());
        for (i, &(name, kernel, stride, padding, outputs, inputs)) in LAYERS.iter().enumerate() {
            let weights = tensor(&file, format!("{name}.weight"), &[outputs, inputs, kernel, kernel])?;
            let bias = tensor(&file, format!("{name}.bias"), &[outputs])?;
            convs.push(Conv::new(&weights, &bias, kernel, (stride, padding)));
            heads.push(tensor(&file, format!("lin{i}.weight"), &[outputs])?);
        }
        Ok(Self { convs, heads })
    }

    /// The distance between two display-referred images, 0 for equal images; `None` if their sizes differ or a side
    /// is shorter than 31 pixels, the network's smallest input.
    pub fn distance(&self, a: &DisplayImage, b: &DisplayImage) -> Option<f64> {
        if (a.width, a.height) != (b.width, b.height) || a.width.min(a.height) < MIN_SIDE {
            return None;
        }
        let layers = self.features(a).into_iter().zip(self.features(b)).zip(&self.heads);
        Some(layers.map(|((fa, fb), head)| layer_distance(&fa, &fb, head)).sum())
    }

    /// The activations after each of the five convolutions.
    fn features(&self, picture: &DisplayImage) -> Vec<FeatureMaps> {
        let normalised = |k: usize| {
            picture.values.iter().map(move |p| (2.0 * p[k].clamp(0.0, 1.0) - 1.0 - SHIFT[k]) / SCALE[k])
        };
        let mut maps = FeatureMaps {
            channels: 3,
            height: picture.height as usize,
            width: picture.width as usize,
            values: (0..3).flat_map(normalised).collect(),
        };
        let mut out = Vec::with_capacity(LAYERS.len());
        for (i, conv) in self.convs.iter().enumerate() {
            // AlexNet pools after its first two convolutions.
            if i == 1 || i == 2 {
                maps = max_pool(&maps);
            }
            maps = conv.apply(&maps);
            out.push(maps.clone());
        }
        out
    }
}

/// Mean over pixels of the weighted squared difference of unit feature vectors.
fn layer_distance(a: &FeatureMaps, b: &FeatureMaps, head: &[f32]) -> f64 {
    let area = a.width * a.height;
    let (norm_a, norm_b) = (norms(a), norms(b));
    let mut sum = 0.0;
    for (channel, weight) in head.iter().enumerate() {
        let row = channel * area..(channel + 1) * area;
        let pixels = a.values[row.clone()].iter().zip(&b.values[row]).zip(norm_a.iter().zip(&norm_b));
        let squares = pixels.map(|((x, y), (nx, ny))| (f64::from(*x) / nx - f64::from(*y) / ny).powi(2));
        sum += f64::from(*weight) * squares.sum::<f64>();
    }
    sum / area as f64
}

/// Each pixel's feature length, never zero.
fn norms(maps: &FeatureMaps) -> Vec<f64> {
    let mut squares = vec![0.0f64; maps.width * maps.height];
    for channel in maps.values.chunks_exact(squares.len()) {
        squares.iter_mut().zip(channel).for_each(|(s, v)| *s += f64::from(*v).powi(2));
    }
    squares.into_iter().map(|s| s.sqrt() + 1e-10).collect()
}

fn tensor(file: &SafeTensors<'_>, name: String, shape: &[usize]) -> Result<Vec<f32>, LpipsError> {
    let view = match file.tensor(&name) {
        Ok(view) => view,
        Err(_) => return Err(LpipsError::Tensor { name, reason: "is missing".into() }),
    };
    if view.dtype() != Dtype::F32 || view.shape() != shape {
        let reason =
            format!("must be f32 of shape {shape:?}, but is {:?} of {:?}", view.dtype(), view.shape());
        return Err(LpipsError::Tensor { name, reason });
    }
    Ok(view.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_without_a_tensor_are_refused_by_its_name() {
        let empty: [(&str, safetensors::tensor::TensorView<'_>); 0] = [];
        let bytes = safetensors::serialize(empty, None).unwrap();
        let refused = Lpips::decode(&bytes).err().unwrap().to_string();
        assert!(refused.contains("features.0.weight"), "{refused}");
    }

    #[test]
    fn missing_weights_file_is_refused_by_path() {
        let refused = Lpips::read(Path::new("no/such/weights.safetensors")).err().unwrap().to_string();
        assert!(refused.contains("no/such/weights.safetensors"), "{refused}");
    }
}
