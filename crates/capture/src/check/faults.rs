//! Faults of the photographs of an imported capture, as names rather than sentences.

use rayon::prelude::*;

use super::findings::{FEW, is_blurred, is_dark, is_overexposed, median};
use super::photo::{self, PhotoStats};
use crate::CaptureView;
use crate::formats::ColourConversion;
use crate::formats::exif_data::ExifData;
use crate::options::ImportOptions;
use crate::sharpness::SIDE;

/// Faults of photographs at the size at which they were imported. A blur that is smaller than a pixel of that size does
/// not count.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PhotographFaults {
    /// Number of examined photographs.
    pub photographs: usize,
    /// True for fewer than 40 photographs.
    pub are_few: bool,
    /// Photographs whose sharpness is below 0.35 of the median of the set.
    pub blurred: Vec<String>,
    /// Photographs whose mean displayed luma is below 0.08.
    pub dark: Vec<String>,
    /// Photographs with a clipped channel in more than a tenth of their pixels.
    pub overexposed: Vec<String>,
}

impl PhotographFaults {
    /// Examines the photographs of `views`, each reduced to at most 800 pixels on its longer side.
    pub fn of(views: &[CaptureView]) -> Self {
        let stats: Vec<PhotoStats> = views.par_iter().map(stats).collect();
        let median = median(stats.iter().map(|photo| photo.sharpness).collect());
        let named = |is_so: &dyn Fn(&PhotoStats) -> bool| -> Vec<String> {
            stats.iter().filter(|photo| is_so(photo)).map(|photo| photo.name.clone()).collect()
        };
        Self {
            photographs: stats.len(),
            are_few: stats.len() < FEW,
            blurred: named(&|photo| is_blurred(photo, median)),
            dark: named(&is_dark),
            overexposed: named(&is_overexposed),
        }
    }
}

fn stats(view: &CaptureView) -> PhotoStats {
    let stored = (view.image.width, view.image.height);
    let (width, height) = ImportOptions::at_most(SIDE).reduced_size(stored);
    let image = view.image.resized(width, height);
    let (range, image) = (image.range(), image.decoded());
    photo::stats(&view.name, (&image, range), stored, ExifData::default(), ColourConversion::None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SyntheticOptions, synthetic};
    use relume_scene::{BitDepth, ImageRgba, PackedImage};

    /// Replaces the photograph of `view` by `edit` of it.
    fn change(view: &mut CaptureView, edit: impl Fn(&ImageRgba) -> ImageRgba) {
        view.image = PackedImage::new(&edit(&view.image.decoded()), BitDepth::Eight);
    }

    #[test]
    fn blurred_and_dark_views_are_named_and_sound_ones_are_not() {
        let options =
            SyntheticOptions { size: 48, train_views: 9, test_views: 0, paths: 16, ..Default::default() };
        let mut views = synthetic(&options).unwrap().train;
        let sound = PhotographFaults::of(&views);
        assert_eq!((sound.photographs, sound.are_few), (9, true));
        assert!(sound.blurred.is_empty() && sound.dark.is_empty(), "the control: {sound:?}");
        // One colour: all detail is blurred away.
        change(&mut views[2], |image| image.resized(1, 1).resized(48, 48));
        let level = |v: f32| 0.05 * v;
        let darker = |p: &[f32; 4]| [level(p[0]), level(p[1]), level(p[2]), p[3]];
        change(&mut views[5], |image| ImageRgba {
            pixels: image.pixels.iter().map(darker).collect(),
            ..*image
        });
        let found = PhotographFaults::of(&views);
        assert_eq!(found.blurred.first(), Some(&views[2].name), "{found:?}");
        assert_eq!(found.dark, [views[5].name.clone()]);
        let many: Vec<CaptureView> = views.iter().cycle().take(FEW).cloned().collect();
        assert!(!PhotographFaults::of(&many).are_few);
        assert_eq!(PhotographFaults::of(&[]), PhotographFaults { are_few: true, ..Default::default() });
    }
}
