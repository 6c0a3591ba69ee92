//! Estimates the memory of a training before it starts. The estimate is a lower bound, so that no training is refused
//! that would fit.

use std::fmt::{self, Display, Formatter};

use crate::TrainError;
use crate::dataset::cache_bytes;
use crate::system_memory::{available_memory, total_memory};
use relume_capture::{Capture, CaptureError, ImportOptions, UndecodedCapture};
use relume_engine::{Branches, Device};
use relume_scene::{Field, Gaussians};
use relume_spec::training::TrainConfig;

/// Bytes per pixel of a decoded photograph without a mask.
const DECODED_PIXEL: u64 = 12;
/// Number of copies of all parameters that are kept: the model and two moments of each parameter, and the same in a
/// snapshot.
const KEPT_STATES: u64 = 6;
/// Bytes per pixel of a step's images in addition to its channels: both branches, the photograph, window statistics
/// and gradients.
const IMAGES_PIXEL: u64 = 200;

/// The location of a training and the memory available there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MemoryBudget {
    /// Whether Gaussians and images are in the memory of a device.
    pub on_device: bool,
    /// Available bytes of host memory; `None` if unknown, in which case nothing is refused.
    pub available: Option<u64>,
}

impl MemoryBudget {
    /// The memory that is currently available on this machine, for a training on `device`.
    pub fn beside(device: &Device) -> Self {
        Self { on_device: device.is_gpu(), available: available_memory() }
    }

    /// All memory of this machine, for a training on `device` that may wait until other processes release theirs.
    pub fn of_machine(device: &Device) -> Self {
        Self { on_device: device.is_gpu(), available: total_memory() }
    }

    /// No limit.
    pub fn unbounded() -> Self {
        Self { on_device: false, available: None }
    }
}

/// The photographs of a training, including held-out ones.
#[derive(Debug, Clone, PartialEq)]
pub struct PhotographSizes {
    /// Widths and heights after reduction, pixels.
    pub sizes: Vec<(u32, u32)>,
    /// Bytes of memory per pixel.
    pub bytes_a_pixel: f64,
    /// Number of held-out photographs. They are in memory while the capture is read, but not during training.
    pub held_out: usize,
}

impl PhotographSizes {
    /// Sizes before decoding. The bytes per pixel are the least over a few decoded photographs.
    ///
    /// # Errors
    /// The error of decoding one of these photographs.
    pub fn undecoded(capture: &mut UndecodedCapture) -> Result<Self, CaptureError> {
        let (sizes, bytes_a_pixel) = (capture.sizes().to_vec(), capture.bytes_a_pixel()?);
        Ok(Self { sizes, bytes_a_pixel, held_out: capture.held_out() })
    }

    /// Sizes of the photographs of a capture.
    pub fn of(capture: &Capture) -> Self {
        let images = || capture.train.iter().chain(&capture.test).map(|view| &view.image);
        let (bytes, pixels) =
            images().fold((0, 0), |(bytes, pixels), image| (bytes + image.bytes(), pixels + image.len()));
        let sizes = images().map(|image| (image.width, image.height)).collect();
        Self { sizes, bytes_a_pixel: bytes as f64 / pixels.max(1) as f64, held_out: capture.test.len() }
    }

    /// The sizes when reduced to at most `resolution` pixels on the longer side.
    pub(crate) fn reduced(&self, resolution: u32) -> Self {
        let options = ImportOptions { max_side: Some(resolution), ..ImportOptions::default() };
        Self { sizes: self.sizes.iter().map(|size| options.reduced_size(*size)).collect(), ..*self }
    }
}

/// Lower bounds of the memory of a training, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MemoryEstimate {
    /// Number of photographs, including held-out ones.
    pub photographs: usize,
    /// Width and height of the largest photograph, pixels.
    pub largest: (u32, u32),
    /// All photographs while the capture is read.
    pub photograph_bytes: u64,
    /// The training photographs in their stored form.
    pub trained_bytes: u64,
    /// Decoded photographs in the cache.
    pub cache_bytes: u64,
    /// Greatest number of Gaussians of the model.
    pub gaussians: u32,
    /// Parameters, moments, gradients and measurements of the Gaussians.
    pub gaussian_bytes: u64,
    /// Images of a step.
    pub step_bytes: u64,
    /// Whether Gaussians and images are in the memory of a device.
    pub on_device: bool,
}

impl MemoryEstimate {
    /// The memory of a training with `config` on these photographs.
    pub fn of(photographs: &PhotographSizes, config: &TrainConfig, on_device: bool) -> Self {
        let sizes = &photographs.sizes;
        let pixels = |&(width, height): &(u32, u32)| u64::from(width) * u64::from(height);
        let largest = sizes.iter().copied().max_by_key(pixels).unwrap_or((0, 0));
        let all: u64 = sizes.iter().map(pixels).sum();
        // The held-out photographs are unknown here; none is larger than the largest.
        let trained = all.saturating_sub(photographs.held_out as u64 * pixels(&largest));
        let most = cache_bytes(sizes.iter().map(|size| (DECODED_PIXEL * pixels(size)) as usize)) as u64;
        Self {
            photographs: sizes.len(),
            largest,
            photograph_bytes: (photographs.bytes_a_pixel * all as f64) as u64,
            trained_bytes: (photographs.bytes_a_pixel * trained as f64) as u64,
            cache_bytes: most.min(DECODED_PIXEL * trained),
            gaussians: config.max_gaussians,
            gaussian_bytes: gaussian_bytes(config) * u64::from(config.max_gaussians),
            step_bytes: step_pixel(config) * pixels(&largest),
            on_device,
        }
    }

    /// Bytes of host memory: the maximum over reading and training.
    pub fn host(&self) -> u64 {
        let engine = if self.on_device { 0 } else { self.engine() };
        self.photograph_bytes.max(self.trained_bytes + self.cache_bytes + engine)
    }

    /// Bytes in the memory in which the engine computes.
    fn engine(&self) -> u64 {
        self.gaussian_bytes + self.step_bytes
    }
}

/// E.g. `2000 photographs of up to 1600x1200: 11.52 GB, training set 10.08 GB, decoded 0.54 GB; 8000 Gaussians 0.02
/// GB; images of a step 0.63 GB; at least 11.52 GB are needed`.
impl Display for MemoryEstimate {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let (width, height) = self.largest;
        write!(
            f,
            "{} photographs of up to {width}x{height}: {}, training set {}, decoded {}; {} Gaussians {}; \
             images of a step {}; at least {} are needed",
            self.photographs,
            gb(self.photograph_bytes),
            gb(self.trained_bytes),
            gb(self.cache_bytes),
            self.gaussians,
            gb(self.gaussian_bytes),
            gb(self.step_bytes),
            gb(self.host())
        )?;
        if self.on_device { write!(f, ", and {} on the device", gb(self.engine())) } else { Ok(()) }
    }
}

/// Bytes of one Gaussian during a training.
fn gaussian_bytes(config: &TrainConfig) -> u64 {
    let g = shape(config);
    let floats: usize = Field::ALL.iter().map(|field| g.width(*field)).sum();
    // Gradients of a step, and the measured visibility in addition to the learned one.
    4 * ((KEPT_STATES + 1) * floats as u64 + 2 * g.width(Field::Visibility) as u64)
}

/// Bytes per pixel of the images of a step with all terms: channels of the forward and backward pass, and derived
/// images.
fn step_pixel(config: &TrainConfig) -> u64 {
    let branches = if config.warm_up_steps() < config.iterations {
        Branches::Both
    } else {
        Branches::RadianceAndNormals
    };
    let channels = branches.channels(&shape(config), &config.shading);
    4 * (channels.blended.stored() + channels.differentiated.stored()) as u64 + IMAGES_PIXEL
}

/// An empty set of Gaussians with the fields of the training.
fn shape(config: &TrainConfig) -> Gaussians {
    let [prototypes, visibility, radiance] =
        [config.prototypes, config.visibility_order, config.radiance_order].map(|n| n as usize);
    Gaussians::zeroed(0, prototypes, visibility, radiance)
}

fn gb(bytes: u64) -> String {
    format!("{:.2} GB", bytes as f64 / 1e9)
}

/// Refuses a training that does not fit in memory.
///
/// # Errors
/// [`TrainError::Memory`] names the setting at fault, the estimate, and the largest value of the setting that would
/// fit.
pub fn check(
    photographs: &PhotographSizes,
    config: &TrainConfig,
    budget: MemoryBudget,
) -> Result<(), TrainError> {
    let need = MemoryEstimate::of(photographs, config, budget.on_device);
    let Some(available) = budget.available.filter(|available| need.host() > *available) else {
        return Ok(());
    };
    let short = format!("{need}, {} are available", gb(available));
    let sides = photographs.sizes.iter().map(|(width, height)| *width.max(height));
    let most = sides.max().unwrap_or(0).min(config.resolution);
    let smaller = |resolution| MemoryEstimate::of(&photographs.reduced(resolution), config, budget.on_device);
    if let Some(fits) = largest_fit(MIN_RESOLUTION, most, |side| smaller(side).host() <= available) {
        return Err(TrainError::Memory(format!("resolution: {short}; {fits} would fit")));
    }
    let fewer = |max_gaussians| {
        let config = TrainConfig { max_gaussians, ..config.clone() };
        MemoryEstimate::of(photographs, &config, budget.on_device)
    };
    let fits = largest_fit(MIN_GAUSSIANS, config.max_gaussians, |most| fewer(most).host() <= available);
    Err(TrainError::Memory(match fits {
        Some(gaussians) => format!("max_gaussians: {short}; {gaussians} would fit"),
        None => format!("capture: {short}; no resolution would fit"),
    }))
}

/// Lower bounds of two settings in `TrainConfig`.
const MIN_RESOLUTION: u32 = 16;
const MIN_GAUSSIANS: u32 = 16;

/// The largest number from `least` to below `most` that fits. If a number fits, all smaller ones must fit.
fn largest_fit(least: u32, most: u32, fits: impl Fn(u32) -> bool) -> Option<u32> {
    if most <= least || !fits(least) {
        return None;
    }
    let (mut low, mut high) = (least, most);
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if fits(middle) { low = middle } else { high = middle }
    }
    Some(low)
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_capture::{SyntheticOptions, synthetic};
    use relume_scene::{BitDepth, PackedImage};
    use relume_spec::training::{Preset, TrainOverrides};

    fn config(resolution: u32, gaussians: u32) -> TrainConfig {
        let overrides = TrainOverrides {
            resolution: Some(resolution),
            max_gaussians: Some(gaussians),
            ..TrainOverrides::default()
        };
        TrainConfig::new(Preset::Draft, &overrides).unwrap()
    }

    /// Opaque photographs of 8 bits per channel.
    fn opaque(sizes: &[(u32, u32)]) -> PhotographSizes {
        PhotographSizes { sizes: sizes.to_vec(), bytes_a_pixel: 3.0, held_out: 0 }
    }

    fn on_cpu(available: u64) -> MemoryBudget {
        MemoryBudget { on_device: false, available: Some(available) }
    }

    fn refusal(photographs: &PhotographSizes, config: &TrainConfig, available: u64) -> String {
        match check(photographs, config, on_cpu(available)) {
            Err(TrainError::Memory(why)) => why,
            other => panic!("must be refused: {other:?}"),
        }
    }

    #[test]
    fn too_large_training_is_refused_with_a_fitting_resolution() {
        let (photographs, config) = (opaque(&[(1600, 1200); 2000]), config(1600, 8000));
        let why = refusal(&photographs, &config, 9_100_000_000);
        let named = [
            "resolution: 2000 photographs of up to 1600x1200: 11.52 GB",
            "9.10 GB are available",
            "would fit",
        ];
        assert!(named.iter().all(|part| why.contains(part)), "{why}");
        let fits: u32 = why.split("; ").last().unwrap().split(' ').next().unwrap().parse().unwrap();
        let need = |side: u32| MemoryEstimate::of(&photographs.reduced(side), &config, false).host();
        assert!(need(fits) <= 9_100_000_000 && need(fits + 1) > 9_100_000_000, "{fits}");
        let whole = MemoryEstimate::of(&photographs, &config, false).host();
        assert!(check(&photographs, &config, on_cpu(whole)).is_ok(), "the control: all of it fits");
        assert!(
            check(&photographs, &config, MemoryBudget::unbounded()).is_ok(),
            "the available memory is unknown"
        );
    }

    #[test]
    fn held_out_photographs_need_memory_only_while_reading() {
        let (all, config) = (opaque(&[(1600, 1200); 2000]), config(1600, 8000));
        let some = PhotographSizes { held_out: 250, ..all.clone() };
        let [all, some] = [all, some].map(|photographs| MemoryEstimate::of(&photographs, &config, false));
        assert_eq!((all.photograph_bytes, some.photograph_bytes), (11_520_000_000, 11_520_000_000));
        assert_eq!((all.trained_bytes, some.trained_bytes), (11_520_000_000, 10_080_000_000));
        assert_eq!(some.host(), 11_520_000_000, "reading takes more than training");
        assert!(all.host() > 12_500_000_000, "the control: {}", all.host());
    }

    #[test]
    fn max_gaussians_is_named_if_no_resolution_fits() {
        let (photographs, config) = (opaque(&[(64, 64); 10]), config(64, 4_000_000));
        let why = refusal(&photographs, &config, 1_000_000_000);
        assert!(why.starts_with("max_gaussians: ") && why.contains("4000000 Gaussians"), "{why}");
        let nothing = refusal(&photographs, &config, 1000);
        assert!(nothing.starts_with("capture: "), "{nothing}");
    }

    #[test]
    fn gaussians_on_a_device_need_no_host_memory() {
        let (photographs, config) = (opaque(&[(64, 64); 10]), config(64, 4_000_000));
        let on_device = MemoryBudget { on_device: true, ..on_cpu(1_000_000_000) };
        assert!(check(&photographs, &config, on_device).is_ok());
        let need = |on_device| MemoryEstimate::of(&photographs, &config, on_device).to_string();
        assert!(need(true).contains("on the device") && !need(false).contains("on the device"));
    }

    #[test]
    fn photograph_memory_follows_their_stored_format() {
        let options =
            SyntheticOptions { train_views: 3, test_views: 1, size: 16, paths: 4, ..Default::default() };
        let mut capture = synthetic(&options).unwrap();
        let masked = PhotographSizes::of(&capture);
        assert_eq!((masked.sizes.len(), masked.bytes_a_pixel), (4, 8.0), "16 bits, and masks");
        for view in capture.train.iter_mut().chain(&mut capture.test) {
            let mut image = view.image.decoded();
            image.pixels.iter_mut().for_each(|p| p[3] = 1.0);
            view.image = PackedImage::new(&image, BitDepth::Eight);
        }
        assert_eq!(PhotographSizes::of(&capture), PhotographSizes { held_out: 1, ..opaque(&[(16, 16); 4]) });
    }
}
