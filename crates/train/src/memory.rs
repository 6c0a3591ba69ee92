//! How much memory a training needs, before it begins: a lower bound, so that nothing is refused that would fit.

use std::fmt::{self, Display, Formatter};

use crate::TrainError;
use crate::dataset::cache_bytes;
use crate::system_memory::{available_memory, total_memory};
use relume_capture::{Capture, CaptureError, ImportOptions, UndecodedCapture};
use relume_engine::{Branches, Device};
use relume_scene::{Field, Gaussians};
use relume_spec::training::TrainConfig;

/// Bytes a pixel of a decoded photograph without a mask.
const DECODED_PIXEL: u64 = 12;
/// States of all Gaussians that are kept: the model and two moments of each parameter, and the same in a snapshot.
const KEPT_STATES: u64 = 6;
/// Bytes a pixel of a step's images beside its channels: both branches, the photograph, their window statistics and gradients.
const IMAGES_PIXEL: u64 = 200;

/// Where a training is to run, and what memory is left there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MemoryBudget {
    /// Whether Gaussians and images are in the memory of a device.
    pub on_device: bool,
    /// Bytes of the host's memory; `None` where that is not known, and then nothing is refused.
    pub available: Option<u64>,
}

impl MemoryBudget {
    /// What this machine has left for a training on `device`.
    pub fn beside(device: &Device) -> Self {
        Self { on_device: device.is_gpu(), available: available_memory() }
    }

    /// All that this machine has, for a training on `device` that may wait for what others hold.
    pub fn of_machine(device: &Device) -> Self {
        Self { on_device: device.is_gpu(), available: total_memory() }
    }

    /// All that is needed.
    pub fn unbounded() -> Self {
        Self { on_device: false, available: None }
    }
}

/// The photographs of a training, held-out ones too.
#[derive(Debug, Clone, PartialEq)]
pub struct PhotographSizes {
    /// Widths and heights after reduction, pixels.
    pub sizes: Vec<(u32, u32)>,
    /// Bytes of memory a pixel.
    pub bytes_a_pixel: f64,
    /// How many of them are held out: they are in memory while a capture is read, and not while it is trained on.
    pub held_out: usize,
}

impl PhotographSizes {
    /// Those that are not decoded yet, if all take as many bytes a pixel as the least of a few of them.
    ///
    /// # Errors
    /// What is wrong with one of these.
    pub fn undecoded(capture: &UndecodedCapture) -> Result<Self, CaptureError> {
        let (sizes, bytes_a_pixel) = (capture.sizes().to_vec(), capture.bytes_a_pixel()?);
        Ok(Self { sizes, bytes_a_pixel, held_out: capture.held_out() })
    }

    /// Those of a capture.
    pub fn of(capture: &Capture) -> Self {
        let images = || capture.train.iter().chain(&capture.test).map(|view| &view.image);
        let (bytes, pixels) =
            images().fold((0, 0), |(bytes, pixels), image| (bytes + image.bytes(), pixels + image.len()));
        let sizes = images().map(|image| (image.width, image.height)).collect();
        Self { sizes, bytes_a_pixel: bytes as f64 / pixels.max(1) as f64, held_out: capture.test.len() }
    }

    /// The same, no side longer than `resolution` pixels.
    fn reduced(&self, resolution: u32) -> Self {
        let options = ImportOptions { max_side: Some(resolution), ..ImportOptions::default() };
        Self { sizes: self.sizes.iter().map(|size| options.reduced_size(*size)).collect(), ..*self }
    }
}

/// Bytes that a training takes at least.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MemoryEstimate {
    /// Photographs, held-out ones too.
    pub photographs: usize,
    /// Width and height of the largest of them, pixels.
    pub largest: (u32, u32),
    /// All of them as they are read.
    pub photograph_bytes: u64,
    /// Those that are trained on, as they are kept.
    pub trained_bytes: u64,
    /// Those that are kept decoded.
    pub cache_bytes: u64,
    /// Most Gaussians of the model.
    pub gaussians: u32,
    /// Their parameters, moments, gradients and measurements.
    pub gaussian_bytes: u64,
    /// Images of a step.
    pub step_bytes: u64,
    /// Whether Gaussians and images are in the memory of a device.
    pub on_device: bool,
}

impl MemoryEstimate {
    /// What a training with `config` takes on these photographs.
    pub fn of(photographs: &PhotographSizes, config: &TrainConfig, on_device: bool) -> Self {
        let sizes = &photographs.sizes;
        let pixels = |&(width, height): &(u32, u32)| u64::from(width) * u64::from(height);
        let largest = sizes.iter().copied().max_by_key(pixels).unwrap_or((0, 0));
        let all: u64 = sizes.iter().map(pixels).sum();
        // Which ones are held out is not known; none is larger than the largest.
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

    /// Bytes of the host's memory: while photographs are read, or while they are trained on.
    pub fn host(&self) -> u64 {
        let engine = if self.on_device { 0 } else { self.engine() };
        self.photograph_bytes.max(self.trained_bytes + self.cache_bytes + engine)
    }

    /// Bytes where the engine computes.
    fn engine(&self) -> u64 {
        self.gaussian_bytes + self.step_bytes
    }
}

/// E.g. `2000 photographs of up to 1600x1200 11.52 GB, to train on 10.08 GB, decoded ones 0.54 GB, 8000 Gaussians 0.02 GB, images of
/// a step 0.63 GB: at least 11.52 GB`.
impl Display for MemoryEstimate {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let (width, height) = self.largest;
        write!(
            f,
            "{} photographs of up to {width}x{height} {}, to train on {}, decoded ones {}, {} Gaussians {}, images of a step {}: at least {}",
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

/// Bytes of one Gaussian over a training.
fn gaussian_bytes(config: &TrainConfig) -> u64 {
    let g = shape(config);
    let floats: usize = Field::ALL.iter().map(|field| g.width(*field)).sum();
    // The gradients of a step, and the measured visibility beside the learned one.
    4 * ((KEPT_STATES + 1) * floats as u64 + 2 * g.width(Field::Visibility) as u64)
}

/// Bytes a pixel of the images of a step with all terms: its channels forward and back, and what is made of them.
fn step_pixel(config: &TrainConfig) -> u64 {
    let branches = if config.warm_up_steps() < config.iterations {
        Branches::Both
    } else {
        Branches::RadianceAndNormals
    };
    let channels = branches.channels(&shape(config), &config.shading);
    4 * (channels.blended.stored() + channels.differentiated.stored()) as u64 + IMAGES_PIXEL
}

/// No Gaussians, with the fields of those of a training.
fn shape(config: &TrainConfig) -> Gaussians {
    let [prototypes, visibility, radiance] =
        [config.prototypes, config.visibility_order, config.radiance_order].map(|n| n as usize);
    Gaussians::zeroed(0, prototypes, visibility, radiance)
}

fn gb(bytes: u64) -> String {
    format!("{:.2} GB", bytes as f64 / 1e9)
}

/// Refuses a training for which there is no room.
///
/// # Errors
/// [`TrainError::Memory`] names the setting at fault, all numbers, and the largest value that would fit.
pub fn check(
    photographs: &PhotographSizes,
    config: &TrainConfig,
    budget: MemoryBudget,
) -> Result<(), TrainError> {
    let need = MemoryEstimate::of(photographs, config, budget.on_device);
    let Some(available) = budget.available.filter(|available| need.host() > *available) else {
        return Ok(());
    };
    let short = format!("{need}, of which {} are available", gb(available));
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

/// Least values of two settings, as `TrainConfig` accepts them.
const MIN_RESOLUTION: u32 = 16;
const MIN_GAUSSIANS: u32 = 16;

/// The largest number from `least` to below `most` that fits, where all smaller ones fit, too.
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

    /// Opaque ones of 8 bits a channel.
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
            "resolution: 2000 photographs of up to 1600x1200 11.52 GB",
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
            "what is available is not known"
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
