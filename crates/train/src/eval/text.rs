//! Text on images: letters of a bitmap font, light on dark.

use image::{Rgb, RgbImage};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

pub(super) const PAPER: [u8; 3] = [24, 24, 27];
const INK: [u8; 3] = [235, 235, 235];
/// Weight and height in pixels of the font.
const WEIGHT: FontWeight = FontWeight::Regular;
const LETTERS: RasterHeight = RasterHeight::Size20;
/// Height of a line of text, pixels.
pub(super) const LINE: u32 = LETTERS.val() as u32 + 4;

/// Width of a letter, pixels.
fn advance() -> u32 {
    get_raster_width(WEIGHT, LETTERS) as u32
}

/// Width of a line of text, pixels.
pub(super) fn width_of(text: &str) -> u32 {
    u32::try_from(text.chars().count()).unwrap_or(u32::MAX).saturating_mul(advance())
}

/// Draws a line of text from its top left corner, cut off at the edge of the image. Characters that the font lacks are
/// drawn as question marks.
pub(super) fn write(image: &mut RgbImage, (left, top): (u32, u32), text: &str) {
    let glyph = |c| get_raster(c, WEIGHT, LETTERS).or_else(|| get_raster('?', WEIGHT, LETTERS));
    let most = image.width() / advance() + 1;
    for (i, glyph) in text.chars().take(most as usize).filter_map(glyph).enumerate() {
        let left = left + i as u32 * advance();
        for (p, coverage) in glyph.pixels().iter().enumerate() {
            let (x, y) = (p % glyph.width(), p / glyph.width());
            if let Some(pixel) = image.get_pixel_mut_checked(left + x as u32, top + y as u32) {
                let blend = |k: usize| u32::from(INK[k] - PAPER[k]) * u32::from(*coverage) / 255;
                *pixel = Rgb([0, 1, 2].map(|k| PAPER[k] + blend(k) as u8));
            }
        }
    }
}

/// The text in lines of at most `width` pixels, broken between words. A word that is longer than a line is broken.
pub(super) fn wrapped(text: &str, width: u32) -> Vec<String> {
    let most = (width / advance()).max(1) as usize;
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        let mut letters: Vec<char> = word.chars().collect();
        if let Some(line) = lines.last_mut().filter(|l| l.chars().count() + 1 + letters.len() <= most) {
            line.push(' ');
            line.push_str(word);
            continue;
        }
        while letters.len() > most {
            let rest = letters.split_off(most);
            lines.push(letters.into_iter().collect());
            letters = rest;
        }
        lines.push(letters.into_iter().collect());
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(width: u32, text: &str) -> RgbImage {
        let mut image = RgbImage::from_pixel(width, LINE, Rgb(PAPER));
        write(&mut image, (0, 0), text);
        image
    }

    #[test]
    fn text_is_cut_at_the_edge_and_unknown_characters_replaced() {
        let two = 2 * advance();
        assert_eq!(drawn(two, "MMMMMM"), drawn(two, "MM"));
        assert_ne!(drawn(two + 4, "MMM"), drawn(two + 4, "MM"), "the control");
        assert_eq!(drawn(60, "\u{4e00}"), drawn(60, "?"));
        assert_ne!(drawn(60, "?"), drawn(60, " "), "the control");
    }

    #[test]
    fn text_is_wrapped_between_words_and_long_words_broken() {
        assert_eq!(wrapped("one two  three", 7 * advance()), ["one two", "three"]);
        assert_eq!(wrapped("one two three", 100 * advance()), ["one two three"]);
        assert_eq!(wrapped("abcdefg h", 3 * advance()), ["abc", "def", "g h"]);
        assert_eq!(wrapped("", 100), [""; 0]);
        assert_eq!(width_of("one"), 3 * advance());
    }
}
