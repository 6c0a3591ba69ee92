//! Findings about a set of photographs, for the photographer.

use std::collections::{BTreeMap, BTreeSet};

use super::photo::PhotoStats;
use crate::IgnoredFile;
use crate::formats::ColourConversion;
use crate::photo_finder::MIN_IMAGES;
use relume_scene::{DisplayRange, SCENE_PEAK};

/// Numbers of photographs below which a set is too small, or small.
const TOO_FEW: usize = 12;
pub(super) const FEW: usize = 40;
/// Sharpness relative to the median of the set, below which a photograph is blurred.
const BLURRED: f64 = 0.35;
/// Similarity to the most similar photograph, below which a photograph overlaps too little with the others.
const ALONE: f64 = 0.5;
/// Share of clipped pixels above which a photograph is overexposed.
const CLIPPED: f64 = 0.1;
/// Mean displayed luma below which a photograph is dark.
const DARK: f64 = 0.08;
/// Longest side below which a photograph is small, pixels.
const SMALL: u32 = 640;
/// Largest difference of the camera's exposure settings, stops.
const SETTINGS_EV: f64 = 0.34;
/// Share of the photographs above which a fault is a problem of the set.
const MANY: f64 = 0.25;

/// What a finding means for a training, the gravest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum FindingKind {
    /// Training would fail.
    Problem,
    /// The model may be worse than possible; the text has the remedy.
    Hint,
    /// A fact about how the files are read. It needs no action.
    Note,
}

impl FindingKind {
    /// A problem if `is_problem`, else a hint.
    fn of_fault(is_problem: bool) -> Self {
        if is_problem { Self::Problem } else { Self::Hint }
    }

    /// The word before the text.
    pub fn name(self) -> &'static str {
        match self {
            Self::Problem => "problem",
            Self::Hint => "hint",
            Self::Note => "note",
        }
    }
}

/// A finding for the photographer.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// What it means for a training.
    pub kind: FindingKind,
    /// The fault and its remedy, or the fact.
    pub text: String,
    /// The photographs concerned; empty for the whole set.
    pub photos: Vec<String>,
}

impl Finding {
    /// True if training would fail.
    pub fn is_problem(&self) -> bool {
        self.kind == FindingKind::Problem
    }
}

/// All findings, problems first.
pub(super) fn findings(photos: &[PhotoStats], unreadable: &[String]) -> Vec<Finding> {
    let mut all = Vec::new();
    all.extend(number(photos.len()));
    if !unreadable.is_empty() {
        let text = format!("photographs that cannot be read: {}", unreadable.len());
        all.push(Finding { kind: FindingKind::Problem, text, photos: unreadable.to_vec() });
    }
    let median = median(photos.iter().map(|photo| photo.sharpness).collect());
    all.extend(about(
        photos,
        "are blurred compared with the others: hold the camera still, add light or shorten the exposure",
        |photo| is_blurred(photo, median),
    ));
    all.extend(about(
        photos,
        "overlap too little with the others: each should show at least two thirds of what its neighbour shows",
        |photo| photos.len() > 1 && photo.overlap < ALONE,
    ));
    all.extend(about(photos, "are dark: add light, or use a tripod and a longer exposure", is_dark));
    let clipped = "are overexposed in a tenth of their pixels or more: reduce the exposure, unless the background is white";
    all.extend(about(photos, clipped, is_overexposed).map(hint));
    all.extend(
        about(photos, "are small: images of less than 640 pixels show little detail", |photo| {
            photo.size.0.max(photo.size.1) < SMALL
        })
        .map(hint),
    );
    all.extend(colours(photos));
    all.extend(scene_referred(photos));
    all.extend(camera(photos));
    all.sort_by_key(|finding| finding.kind);
    all
}

/// True if a photograph is blurred compared with photographs of the same scene whose sharpness has this median.
pub(super) fn is_blurred(photo: &PhotoStats, median: f64) -> bool {
    photo.sharpness < BLURRED * median
}

pub(super) fn is_dark(photo: &PhotoStats) -> bool {
    photo.brightness < DARK
}

pub(super) fn is_overexposed(photo: &PhotoStats) -> bool {
    photo.clipped > CLIPPED
}

/// A note for each reason for which image files are no photographs.
pub(super) fn ignored(files: &[IgnoredFile]) -> Vec<Finding> {
    let mut groups: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for file in files {
        groups.entry(file.reason).or_default().push(file.path.clone());
    }
    let text = |reason: &str, count: usize| {
        format!("files that are not used as photographs: {count}; each {reason}")
    };
    let finding = |(reason, photos): (&str, Vec<String>)| Finding {
        kind: FindingKind::Note,
        text: text(reason, photos.len()),
        photos,
    };
    groups.into_iter().map(finding).collect()
}

fn number(photos: usize) -> Option<Finding> {
    let (is_problem, text) = match photos {
        0..TOO_FEW => (true, format!("too few photographs ({photos}): take 40 to 200 from all sides")),
        TOO_FEW..FEW => {
            (false, format!("few photographs ({photos}): 40 to 200 from all sides give a better model"))
        }
        _ => return None,
    };
    Some(Finding { kind: FindingKind::of_fault(is_problem), text, photos: Vec::new() })
}

/// A finding about the photographs for which `is_so`; a problem if they are more than the share [`MANY`].
fn about(photos: &[PhotoStats], what: &str, is_so: impl Fn(&PhotoStats) -> bool) -> Option<Finding> {
    let names: Vec<String> =
        photos.iter().filter(|photo| is_so(photo)).map(|photo| photo.name.clone()).collect();
    let is_problem = names.len() as f64 > MANY * photos.len() as f64;
    let text = format!("{} of {} photographs {what}", names.len(), photos.len());
    (!names.is_empty()).then_some(Finding { kind: FindingKind::of_fault(is_problem), text, photos: names })
}

fn hint(finding: Finding) -> Finding {
    Finding { kind: FindingKind::Hint, ..finding }
}

/// A finding about identical photographs; a problem if fewer than [`MIN_IMAGES`] different ones remain.
pub(super) fn copies(photos: &[PhotoStats]) -> Option<Finding> {
    let mut seen = BTreeSet::new();
    let names: Vec<String> =
        photos.iter().filter(|photo| !seen.insert(photo.digest)).map(|photo| photo.name.clone()).collect();
    let is_problem = seen.len() < MIN_IMAGES;
    let text = format!(
        "{} of {} photographs are identical copies of others: {} different photographs remain",
        names.len(),
        photos.len(),
        seen.len()
    );
    (!names.is_empty()).then_some(Finding { kind: FindingKind::of_fault(is_problem), text, photos: names })
}

/// A note that names the scene-referred photographs.
fn scene_referred(photos: &[PhotoStats]) -> Option<Finding> {
    let what = format!(
        "contain linear light brighter than white: they are trained on without clipping, up to {SCENE_PEAK} times white"
    );
    about(photos, &what, |photo| photo.range == DisplayRange::Extended)
        .map(|finding| Finding { kind: FindingKind::Note, ..finding })
}

/// A finding for each colour profile that is converted or cannot be used.
fn colours(photos: &[PhotoStats]) -> Vec<Finding> {
    let mut groups: BTreeMap<&ColourConversion, Vec<String>> = BTreeMap::new();
    for photo in photos.iter().filter(|photo| photo.colour != ColourConversion::None) {
        groups.entry(&photo.colour).or_default().push(photo.name.clone());
    }
    let text = |colour: &ColourConversion, count: usize| match colour {
        ColourConversion::None => String::new(),
        ColourConversion::Converted(profile) => {
            format!("photographs with the colour profile {profile}, which are converted to sRGB: {count}")
        }
        ColourConversion::Ignored { profile, reason } => {
            format!(
                "the colour profile {profile} of {count} photographs is ignored, and they are taken as sRGB: {reason}"
            )
        }
    };
    let finding = |(colour, photos): (&ColourConversion, Vec<String>)| Finding {
        kind: match colour {
            ColourConversion::Ignored { .. } => FindingKind::Hint,
            ColourConversion::None | ColourConversion::Converted(_) => FindingKind::Note,
        },
        text: text(colour, photos.len()),
        photos,
    };
    groups.into_iter().map(finding).collect()
}

/// Findings about the camera's settings over the set.
fn camera(photos: &[PhotoStats]) -> Vec<Finding> {
    let mut found = Vec::new();
    let mut say = |text: String| found.push(Finding { kind: FindingKind::Hint, text, photos: Vec::new() });
    let exposures: Vec<f64> = photos.iter().filter_map(|photo| photo.camera.exposure_ev()).collect();
    let low = exposures.iter().copied().fold(f64::INFINITY, f64::min);
    let high = exposures.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if high - low > SETTINGS_EV {
        say(format!(
            "the exposure differs by {:.1} stops between photographs: fix shutter speed, aperture and ISO",
            high - low
        ));
    }
    let auto = photos.iter().filter(|photo| photo.camera.auto_white_balance == Some(true)).count();
    if auto > 0 {
        say(format!(
            "the camera chose the white balance of {auto} photographs automatically: set a fixed white balance"
        ));
    }
    let differ = |of: &dyn Fn(&PhotoStats) -> Option<String>| {
        let mut values: Vec<String> = photos.iter().filter_map(of).collect();
        values.sort();
        values.dedup();
        values.len() > 1
    };
    if differ(&|photo| photo.camera.focal_mm.map(|mm| format!("{mm:.2}"))) {
        say("the focal length differs between photographs: do not zoom".to_owned());
    }
    if differ(&|photo| Some(format!("{:?}", photo.size))) {
        say("the photographs have several sizes: one camera in one orientation gives more reliable poses"
            .to_owned());
    }
    found
}

pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::exif_data::ExifData;

    /// Fifty photographs without a fault.
    fn sound() -> Vec<PhotoStats> {
        let camera = ExifData {
            exposure_s: Some(0.01),
            f_number: Some(2.0),
            iso: Some(100.0),
            focal_mm: Some(5.0),
            auto_white_balance: Some(false),
            ..ExifData::default()
        };
        let photo = |i: usize| PhotoStats {
            name: format!("{i}.jpg"),
            size: (4000, 3000),
            sharpness: 100.0 + i as f64,
            brightness: 0.4,
            clipped: 0.01,
            overlap: 0.9,
            camera: camera.clone(),
            colour: ColourConversion::None,
            range: DisplayRange::Unit,
            digest: i as u64,
        };
        (0..50).map(photo).collect()
    }

    #[test]
    fn good_photographs_give_no_findings() {
        assert_eq!(findings(&sound(), &[]), []);
    }

    #[test]
    fn each_fault_gives_a_finding_and_frequent_faults_are_problems() {
        type Fault = fn(&mut PhotoStats);
        let faults: [(Fault, &str, bool); 8] = [
            (|p| p.sharpness = 10.0, "blurred", true),
            (|p| p.overlap = 0.1, "overlap too little", true),
            (|p| p.brightness = 0.01, "dark", true),
            (|p| p.clipped = 0.5, "overexposed", false),
            (|p| p.size = (400, 300), "small", false),
            (|p| p.range = DisplayRange::Extended, "brighter than white", false),
            (|p| p.camera.exposure_s = Some(0.02), "1.0 stops", false),
            (|p| p.camera.auto_white_balance = Some(true), "white balance", false),
        ];
        for (fault, word, is_problem) in faults {
            for (count, many) in [(2, false), (20, true)] {
                let mut photos = sound();
                photos.iter_mut().take(count).for_each(fault);
                let found = findings(&photos, &[]);
                let finding = found.iter().find(|finding| finding.text.contains(word));
                let finding = finding.unwrap_or_else(|| panic!("{word}: {found:?}"));
                assert_eq!(finding.is_problem(), is_problem && many, "{word} {count}");
                assert!(finding.photos.is_empty() || finding.photos.len() == count);
            }
        }
    }

    #[test]
    fn too_few_and_unreadable_photographs_are_problems() {
        let told = |count: usize| findings(&sound()[..count], &[]).first().map(Finding::is_problem);
        assert_eq!([3, 11, 12, 39, 40].map(told), [Some(true), Some(true), Some(false), Some(false), None]);
        let found = findings(&sound(), &["x.jpg: is empty".to_owned()]);
        assert!(found[0].is_problem() && found[0].photos[0].contains("x.jpg"));
    }

    #[test]
    fn copies_are_a_problem_if_too_few_different_photographs_remain() {
        let copied = |different: u64| {
            let mut photos = sound();
            photos.iter_mut().for_each(|photo| photo.digest %= different);
            copies(&photos).unwrap()
        };
        let (two, three) = (copied(2), copied(3));
        assert!(two.is_problem() && two.photos.len() == 48 && two.photos[0] == "2.jpg", "{two:?}");
        assert!(!three.is_problem() && three.text.contains("3 different"), "the control: {three:?}");
    }
}
