use super::cache::Key;
use super::*;
use relume_capture::{SyntheticOptions, synthetic};
use relume_compare::largest_difference;
use relume_scene::{BitDepth, PackedImage};
use relume_spec::training::{Preset, TrainOverrides};

const VIEWS: usize = 6;
const SIDE: u32 = 24;
/// Bytes of a decoded photograph with a mask.
const FULL: usize = (SIDE * SIDE) as usize * 16;

/// Photographs as from 8-bit files.
fn capture(has_alpha: bool) -> Capture {
    let options =
        SyntheticOptions { train_views: VIEWS, test_views: 1, size: SIDE, paths: 4, ..Default::default() };
    let mut capture = synthetic(&options).unwrap();
    for view in &mut capture.train {
        let mut image = view.image.decoded();
        if !has_alpha {
            image.pixels.iter_mut().for_each(|p| p[3] = 1.0);
        }
        view.image = PackedImage::new(&image, BitDepth::Eight);
    }
    capture.has_alpha = has_alpha;
    capture
}

fn dataset(capture: &Capture, resolution: u32) -> Dataset {
    let overrides = TrainOverrides { resolution: Some(resolution), ..Default::default() };
    Dataset::new(capture, &TrainConfig::new(Preset::Draft, &overrides).unwrap())
}

#[test]
fn dataset_shares_pixels_and_uses_at_most_four_bytes_per_pixel() {
    for (has_alpha, most) in [(false, 3), (true, 4)] {
        let capture = capture(has_alpha);
        let data = dataset(&capture, SIDE);
        let shared = data.photos.iter().zip(&capture.train);
        assert!(shared.clone().all(|(photo, view)| photo.image.shares_pixels_with(&view.image)));
        assert_eq!(data.bytes(), VIEWS * (SIDE * SIDE) as usize * most);
        let smaller = dataset(&capture, SIDE - 2);
        assert!(!smaller.photos[0].image.shares_pixels_with(&capture.train[0].image), "the control");
    }
    let mut cut = dataset(&capture(false), SIDE);
    cut.cut_out((1.0, glam::DVec3::ZERO), |camera| vec![0.5; (camera.width * camera.height) as usize]);
    assert_eq!(cut.bytes(), VIEWS * (SIDE * SIDE) as usize * 4, "a computed mask takes one byte per pixel");
}

#[test]
fn photographs_equal_the_capture_images_exactly() {
    let capture = capture(true);
    let data = dataset(&capture, SIDE);
    for (i, view) in capture.train.iter().enumerate() {
        let image = view.image.decoded();
        assert_eq!(data.photo(i, PhotoSize::Full).pixels, image.over(WHITE));
        assert_eq!(
            data.decode_uncached(i, PhotoSize::Half).pixels,
            image.resized(SIDE / 2, SIDE / 2).over(WHITE)
        );
        assert_eq!(data.camera(i, PhotoSize::Half).width, SIDE / 2);
    }
    let mut seen = Vec::new();
    data.for_each_photo(PhotoSize::Full, |i, photo| seen.push((i, photo.pixels.clone())));
    assert_eq!(seen.len(), VIEWS);
    assert!(seen.iter().enumerate().all(|(i, (k, _))| i == *k));
    assert_eq!(seen[4].1, data.photo(4, PhotoSize::Full).pixels);
    assert_ne!(seen[4].1, seen[3].1, "the control");
}

#[test]
fn reduced_photograph_is_accurate_to_half_a_level() {
    let capture = capture(true);
    let (small, data) = (SIDE * 2 / 3, dataset(&capture, SIDE * 2 / 3));
    let found = data.photo(0, PhotoSize::Full);
    let exact = capture.train[0].image.decoded().resized(small, small).over(WHITE);
    let error = |photo: &Photo| largest_difference(photo.pixels.as_flattened(), exact.as_flattened());
    // Half a level of the colour and, over white, half a level of alpha.
    assert!(error(&found) <= 1.01 / 255.0, "{}", error(&found));
    let control = error(&data.photo(1, PhotoSize::Full));
    assert!(control.is_finite() && control > 0.1, "the control, another photograph: {control}");
}

/// Requests photographs in this order, with prefetch of the next ones. Checks that the cache stays within `bound`;
/// returns the statistics.
fn asked(order: &[usize], bound: usize) -> DecodingStats {
    let mut data = dataset(&capture(true), SIDE);
    data.bound(bound);
    let exact: Vec<Photo> = data.photos.iter().map(|photo| photo.decoded(PhotoSize::Full)).collect();
    for (at, i) in order.iter().enumerate() {
        assert_eq!(data.photo(*i, PhotoSize::Full).pixels, exact[*i].pixels);
        data.prefetch(order[at + 1..].iter().take(3).map(|next| (*next, PhotoSize::Full)));
        assert!(data.cache.held() <= bound);
    }
    data.decoding()
}

#[test]
fn cache_decodes_once_if_all_fits_and_respects_its_limit() {
    let order = [0, 1, 2, 3, 4, 5, 3, 1, 5, 0, 2, 4, 4, 0];
    let whole = asked(&order, VIEWS * FULL);
    assert_eq!((whole.asked, whole.decoded), (14, VIEWS as u64));
    let narrow = asked(&order, 2 * FULL);
    assert!(narrow.decoded > VIEWS as u64, "the control: {narrow:?}");
    for bound in [0, FULL - 1, FULL, 3 * FULL] {
        let stats = asked(&order, bound);
        assert!(stats.decoded >= VIEWS as u64, "{bound}: {stats:?}");
    }
    assert_eq!(asked(&order, 0).waits, 14, "nothing is cached, so each request waits");
}

#[test]
fn least_recently_used_photograph_is_evicted_first() {
    let mut data = dataset(&capture(true), SIDE);
    data.bound(2 * FULL);
    let key = |i: usize| -> Key { (i, PhotoSize::Full) };
    for i in [0, 1, 0, 2] {
        data.photo(i, PhotoSize::Full);
    }
    assert!(data.cache.peek(key(0)).is_some() && data.cache.peek(key(2)).is_some());
    assert!(data.cache.peek(key(1)).is_none());
}

#[test]
fn prefetched_photograph_is_decoded_before_it_is_requested() {
    let data = dataset(&capture(true), SIDE);
    let start = std::time::Instant::now();
    data.prefetch([(3, PhotoSize::Half)].into_iter());
    while data.cache.peek((3, PhotoSize::Half)).is_none() {
        assert!(start.elapsed().as_secs() < 60, "it is not decoded");
        std::thread::yield_now();
    }
    data.photo(3, PhotoSize::Half);
    assert_eq!((data.decoding().decoded, data.decoding().waits), (1, 0));
    data.photo(2, PhotoSize::Half);
    assert_eq!((data.decoding().decoded, data.decoding().waits), (2, 1), "the control");
}

#[test]
fn changed_photographs_are_decoded_again() {
    let mut data = dataset(&capture(true), SIDE);
    let before = data.photo(0, PhotoSize::Full);
    data.divide(&[[2.0; 3]; VIEWS]);
    let after = data.photo(0, PhotoSize::Full);
    let mut expected = (*before).clone();
    divide(&mut expected, [2.0; 3], WHITE);
    assert_eq!(after.pixels, expected.pixels);
    assert_ne!(after.pixels, before.pixels, "the control");
}
