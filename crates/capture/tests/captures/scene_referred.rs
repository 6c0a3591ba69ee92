//! Photographs of linear light: brighter than white without clipping, and shown clipped.

use relume_capture::formats::exr_image::encode_rgb;
use relume_capture::formats::image_file::{self, decode_photograph, encode_png};
use relume_capture::{Capture, CapturePhotos, ImportLimits, ImportOptions, PictureOptions, inspect};
use relume_compare::largest_difference;
use relume_fixtures::small_set::{Files, import_folder, nerfstudio};
use relume_scene::{DisplayRange, ImageRgba, SCENE_PEAK, srgb};
use serde_json::json;

const SIZE: (usize, usize) = (8, 6);
/// Largest rounding of a stored value.
const STORED: f64 = 5e-5;

/// Linear light of photograph `i`: black to 8 times white in each row.
fn light(i: usize) -> Vec<[f32; 3]> {
    let pixel = |p: usize| [8.0 * (p % 8) as f32 / 7.0, 0.1 * i as f32, 0.02 * p as f32];
    (0..48).map(pixel).collect()
}

/// A capture of six photographs with these pixels, linear in EXR files, or encoded in 8 bits in PNG files.
fn capture_of(pixels: impl Fn(usize) -> Vec<[f32; 3]>, ending: &str) -> Files {
    let mut files = nerfstudio(|set| {
        for i in 0..6 {
            set["frames"][i]["file_path"] = json!(format!("images/{i}.{ending}"));
        }
    });
    for i in 0..6 {
        files.remove(&format!("images/{i}.png"));
        let level = |v: f32| srgb::to_u8(srgb::encode(v));
        let bytes = match ending {
            "exr" => encode_rgb(SIZE.0, SIZE.1, &pixels(i)),
            _ => {
                let levels: Vec<[u8; 3]> = pixels(i).iter().map(|pixel| pixel.map(level)).collect();
                encode_png(SIZE.0 as u32, SIZE.1 as u32, &levels)
            }
        };
        files.insert(format!("images/{i}.{ending}"), bytes.unwrap());
    }
    files
}

fn folder_of(files: &Files) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("images")).unwrap();
    files.iter().for_each(|(name, bytes)| std::fs::write(folder.path().join(name), bytes).unwrap());
    folder
}

/// Red of photograph `i` of an imported capture.
fn red(capture: &Capture, i: usize) -> Vec<f32> {
    let mut views = capture.train.iter().chain(&capture.test);
    let view = views.find(|view| view.name.starts_with(&format!("images/{i}."))).unwrap();
    view.image.pixels().map(|pixel| pixel[0]).collect()
}

#[test]
fn exr_photographs_are_read_unclipped_and_png_files_are_clipped() {
    let [exr, png] = ["exr", "png"].map(|ending| import_folder(&capture_of(light, ending)).unwrap());
    assert!(exr.train.iter().all(|view| view.image.range() == DisplayRange::Extended));
    assert!(png.train.iter().all(|view| view.image.range() == DisplayRange::Unit), "the control");
    for i in 0..6 {
        let wanted: Vec<f32> = light(i).iter().map(|[r, ..]| srgb::encode_extended(*r)).collect();
        assert!(largest_difference(&red(&exr, i), &wanted) < STORED);
        assert!(wanted[7] > 2.4 && red(&exr, i)[7] > 2.4, "eight times white");
        let clipped: Vec<f32> = light(i).iter().map(|[r, ..]| srgb::encode(*r)).collect();
        assert!(largest_difference(&red(&png, i), &clipped) < 0.51 / 255.0, "the control");
    }
    assert!(!exr.warnings.iter().any(|warning| warning.contains("brighter")), "{:?}", exr.warnings);
}

#[test]
fn exr_photographs_up_to_white_are_stored_as_before() {
    let darker = |i: usize| light(i).iter().map(|pixel| pixel.map(|v| v / 8.0)).collect::<Vec<_>>();
    let capture = import_folder(&capture_of(darker, "exr")).unwrap();
    assert!(capture.train.iter().all(|view| view.image.range() == DisplayRange::Unit));
    let wanted: Vec<f32> = darker(2).iter().map(|[r, ..]| srgb::encode(*r)).collect();
    assert!(largest_difference(&red(&capture, 2), &wanted) <= 0.5 / 65_535.0 + 1e-7);
}

#[test]
fn pixels_above_the_peak_are_limited_with_a_warning() {
    let extreme = |i: usize| {
        let mut pixels = light(i);
        (pixels[8], pixels[16]) = ([f32::NAN, f32::NEG_INFINITY, -4.0], [0.5; 3]);
        if i == 3 {
            (pixels[0], pixels[9]) = ([1000.0, 0.0, 0.0], [f32::INFINITY; 3]);
        }
        pixels
    };
    let capture = import_folder(&capture_of(extreme, "exr")).unwrap();
    let warning = capture.warnings.iter().find(|warning| warning.contains("brighter than 64")).unwrap();
    assert!(warning.contains("images/3.exr") && warning.contains("4.17 %"), "{warning}");
    assert!(!warning.contains("images/2.exr"), "the control: {warning}");
    let white = srgb::encode_extended(SCENE_PEAK);
    let found = red(&capture, 3);
    assert!(largest_difference(&[found[0], found[9]], &[white; 2]) < STORED, "{found:?}");
    assert_eq!(found[8], 0.0, "NaN is black");
    let views = capture.train.iter().chain(&capture.test);
    assert!(views.flat_map(|view| view.image.pixels()).flatten().all(|v| (0.0..=white).contains(&v)));
}

#[test]
fn pictures_of_scene_referred_photographs_are_clipped() {
    let clipped = |i: usize| light(i).iter().map(|pixel| pixel.map(|v| v.min(1.0))).collect::<Vec<_>>();
    let picture = |pixels: &dyn Fn(usize) -> Vec<[f32; 3]>| {
        let folder = folder_of(&capture_of(pixels, "exr"));
        let photographs = CapturePhotos::open(folder.path(), &ImportLimits::default()).unwrap();
        photographs.picture("images/1.exr", &PictureOptions::default()).unwrap()
    };
    let shown = picture(&light);
    assert!(shown.pixels.iter().flatten().all(|v| (0.0..=1.0).contains(v)));
    let apart =
        |a: &ImageRgba, b: &ImageRgba| largest_difference(a.pixels.as_flattened(), b.pixels.as_flattened());
    assert!(apart(&shown, &picture(&clipped)) < 1e-6);
    let unclipped = decode_photograph(&capture_of(light, "exr")["images/1.exr"], 48, |size| size).unwrap();
    assert!(apart(&unclipped.image, &shown) > 1.0, "the control");
    let mask = image_file::decode(&capture_of(light, "exr")["images/1.exr"], 48).unwrap();
    assert!(apart(&mask, &shown) < 1e-6, "values of masks and maps are in [0, 1]");
}

#[test]
fn report_names_photographs_brighter_than_white() {
    let notes = |ending: &str| {
        let folder = folder_of(&capture_of(light, ending));
        let report = inspect(folder.path(), &ImportOptions::default()).unwrap();
        report.notes.into_iter().map(|note| note.text).collect::<Vec<_>>().join("\n")
    };
    let (exr, png) = (notes("exr"), notes("png"));
    assert!(exr.contains("6 of 6 photographs contain linear light brighter than white"), "{exr}");
    assert!(!exr.contains("overexposed"), "{exr}");
    assert!(png.contains("overexposed") && !png.contains("linear light"), "the control: {png}");
}
