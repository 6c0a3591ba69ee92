//! Contact sheets: labelled images in a grid, as a PNG.

use std::io::Cursor;

use image::{ImageFormat, Rgb, RgbImage};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

use crate::eval::image::DisplayImage;
use relume_scene::Plane;

const PAPER: [u8; 3] = [24, 24, 27];
const INK: [u8; 3] = [235, 235, 235];
/// Weight and height in pixels of the label font.
const WEIGHT: FontWeight = FontWeight::Regular;
const LETTERS: RasterHeight = RasterHeight::Size16;
/// Pixels between cells.
const GAP: u32 = 4;

/// A grid of images with a label above each column and each row.
#[derive(Debug, Clone, Default)]
pub struct Sheet {
    columns: Vec<String>,
    rows: Vec<(String, Vec<Option<DisplayImage>>)>,
}

impl Sheet {
    /// An empty sheet with these columns.
    pub fn new(columns: impl IntoIterator<Item = impl Into<String>>) -> Self {
        Self { columns: columns.into_iter().map(Into::into).collect(), rows: Vec::new() }
    }

    /// Adds a row. `None` leaves a cell empty; cells beyond the columns are not drawn.
    pub fn push(&mut self, name: impl Into<String>, cells: Vec<Option<DisplayImage>>) {
        self.rows.push((name.into(), cells));
    }

    /// Draws the sheet, with each image fitted to a square cell of `side` pixels (at least 16).
    ///
    /// # Errors
    /// The error of the PNG encoder.
    pub fn to_png(&self, side: u32) -> Result<Vec<u8>, image::ImageError> {
        let mut out = Cursor::new(Vec::new());
        self.draw(side.max(16)).write_to(&mut out, ImageFormat::Png)?;
        Ok(out.into_inner())
    }

    fn draw(&self, side: u32) -> RgbImage {
        let label = LETTERS.val() as u32 + 2 * GAP;
        let cell = side + GAP;
        let width = GAP + cell * self.columns.len() as u32;
        let height = label + (label + cell) * self.rows.len() as u32;
        let mut sheet = RgbImage::from_pixel(width.max(1), height, Rgb(PAPER));
        let column_x = |c: usize| GAP + cell * c as u32;
        for (c, name) in self.columns.iter().enumerate() {
            write(&mut sheet, (column_x(c), GAP), side, name);
        }
        for (r, (name, cells)) in self.rows.iter().enumerate() {
            let top = label + (label + cell) * r as u32;
            write(&mut sheet, (GAP, top + GAP), width - GAP, name);
            for (c, picture) in cells.iter().enumerate().take(self.columns.len()) {
                let Some(picture) = picture else { continue };
                paste(&mut sheet, (column_x(c), top + label), &fitted(picture, side));
            }
        }
        sheet
    }
}

/// The image resized to `side` pixels on its longer side.
fn fitted(picture: &DisplayImage, side: u32) -> DisplayImage {
    let longest = picture.width.max(picture.height).max(1);
    let scaled = |n: u32| ((u64::from(n) * u64::from(side) / u64::from(longest)) as u32).max(1);
    picture.resized(scaled(picture.width), scaled(picture.height))
}

fn paste(sheet: &mut RgbImage, (left, top): (u32, u32), picture: &DisplayImage) {
    for (i, pixel) in picture.values.iter().enumerate() {
        let (x, y) = (i as u32 % picture.width, i as u32 / picture.width);
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        sheet.put_pixel(left + x, top + y, Rgb(pixel.map(byte)));
    }
}

/// Draws text from its top left corner, cut off at `room` pixels or the sheet's edge. Characters that the font lacks
/// are drawn as question marks.
fn write(sheet: &mut RgbImage, (left, top): (u32, u32), room: u32, text: &str) {
    let advance = get_raster_width(WEIGHT, LETTERS);
    let glyph = |c| get_raster(c, WEIGHT, LETTERS).or_else(|| get_raster('?', WEIGHT, LETTERS));
    let glyphs = text.chars().take(room as usize / advance).filter_map(glyph);
    for (i, glyph) in glyphs.enumerate() {
        for (p, coverage) in glyph.pixels().iter().enumerate() {
            let (x, y) = (i * advance + p % glyph.width(), p / glyph.width());
            if let Some(pixel) = sheet.get_pixel_mut_checked(left + x as u32, top + y as u32) {
                let blend = |k: usize| u32::from(INK[k] - PAPER[k]) * u32::from(*coverage) / 255;
                *pixel = Rgb([0, 1, 2].map(|k| PAPER[k] + blend(k) as u8));
            }
        }
    }
}

/// A one-channel layer as a grey image.
pub fn grey(width: u32, height: u32, values: impl IntoIterator<Item = f32>) -> DisplayImage {
    Plane { width, height, values: values.into_iter().map(|v| [v; 3]).collect() }
}

/// The difference of two images of the same size: from black for equal pixels through red and yellow to white at a
/// mean channel difference of 0.25.
pub fn error_map(a: &DisplayImage, b: &DisplayImage) -> DisplayImage {
    let heat = |(p, q): (&[f32; 3], &[f32; 3])| {
        let difference: f32 = p.iter().zip(q).map(|(x, y)| (x - y).abs()).sum::<f32>() / 3.0;
        let t = (difference / 0.25).min(1.0) * 3.0;
        [t.min(1.0), (t - 1.0).clamp(0.0, 1.0), (t - 2.0).clamp(0.0, 1.0)]
    };
    Plane { width: a.width, height: a.height, values: a.values.iter().zip(&b.values).map(heat).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(width: u32, height: u32, colour: [f32; 3]) -> DisplayImage {
        Plane { width, height, values: vec![colour; (width * height) as usize] }
    }

    #[test]
    fn images_are_drawn_in_their_cells_and_empty_cells_stay_blank() {
        let mut sheet = Sheet::new(["left", "right"]);
        sheet.push("view", vec![None, Some(flat(8, 4, [1.0, 0.0, 0.0]))]);
        let drawn = sheet.draw(32);
        let red = Rgb([255, 0, 0]);
        let columns: Vec<u32> =
            drawn.enumerate_pixels().filter(|(_, _, p)| **p == red).map(|(x, _, _)| x).collect();
        assert_eq!(columns.len(), 32 * 16, "an 8x4 picture fills half of a square cell");
        assert_eq!(columns.iter().min(), Some(&(GAP + 32 + GAP)));
        let png = image::load_from_memory(&sheet.to_png(32).unwrap()).unwrap().into_rgb8();
        assert_eq!(png, drawn);
    }

    #[test]
    fn text_is_cut_to_its_width_and_unknown_characters_replaced() {
        let drawn = |room: u32, text: &str| {
            let mut sheet = RgbImage::from_pixel(60, 16, Rgb(PAPER));
            write(&mut sheet, (0, 0), room, text);
            sheet
        };
        let advance = get_raster_width(WEIGHT, LETTERS) as u32;
        let cut = drawn(2 * advance + 1, "MMMMMM");
        assert_eq!(cut, drawn(60, "MM"));
        assert_ne!(cut, drawn(60, "MMM"), "the control");
        assert_eq!(drawn(60, "\u{4e00}"), drawn(60, "?"));
        assert_ne!(drawn(60, "?"), drawn(60, " "), "the control");
    }

    #[test]
    fn error_map_is_black_for_equal_and_white_for_opposite_images() {
        let (black, white) = (flat(2, 1, [0.0; 3]), flat(2, 1, [1.0; 3]));
        assert_eq!(error_map(&black, &black).values, vec![[0.0; 3]; 2]);
        assert_eq!(error_map(&black, &white).values, vec![[1.0; 3]; 2]);
    }
}
