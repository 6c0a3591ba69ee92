//! Contact sheets: labelled pictures in a grid, as a PNG.

use std::io::Cursor;

use image::{ImageFormat, Rgb, RgbImage};

use crate::eval::{Picture, font};
use crate::scene::Plane;

const PAPER: Rgb<u8> = Rgb([24, 24, 27]);
const INK: Rgb<u8> = Rgb([235, 235, 235]);
/// Pixels between cells.
const GAP: u32 = 4;

/// A grid of pictures with a name over each column and over each row.
#[derive(Debug, Clone, Default)]
pub struct Sheet {
    columns: Vec<String>,
    rows: Vec<(String, Vec<Option<Picture>>)>,
}

impl Sheet {
    /// An empty sheet with these columns.
    pub fn new(columns: impl IntoIterator<Item = impl Into<String>>) -> Self {
        Self { columns: columns.into_iter().map(Into::into).collect(), rows: Vec::new() }
    }

    /// Adds a row. `None` leaves a cell empty; what exceeds the columns is not drawn.
    pub fn push(&mut self, name: impl Into<String>, cells: Vec<Option<Picture>>) {
        self.rows.push((name.into(), cells));
    }

    /// Draws the sheet, each picture fitted into a square cell of `side` pixels (at least 16).
    ///
    /// # Errors
    /// What the PNG encoder says.
    pub fn to_png(&self, side: u32) -> Result<Vec<u8>, image::ImageError> {
        let mut out = Cursor::new(Vec::new());
        self.draw(side.max(16)).write_to(&mut out, ImageFormat::Png)?;
        Ok(out.into_inner())
    }

    fn draw(&self, side: u32) -> RgbImage {
        let scale = (side / 110).max(1);
        let label = font::HEIGHT as u32 * scale + 2 * GAP;
        let cell = side + GAP;
        let width = GAP + cell * self.columns.len() as u32;
        let height = label + (label + cell) * self.rows.len() as u32;
        let mut sheet = RgbImage::from_pixel(width.max(1), height, PAPER);
        let column_x = |c: usize| GAP + cell * c as u32;
        for (c, name) in self.columns.iter().enumerate() {
            write(&mut sheet, (column_x(c), GAP), scale, side, name);
        }
        for (r, (name, cells)) in self.rows.iter().enumerate() {
            let top = label + (label + cell) * r as u32;
            write(&mut sheet, (GAP, top + GAP), scale, width - GAP, name);
            for (c, picture) in cells.iter().enumerate().take(self.columns.len()) {
                let Some(picture) = picture else { continue };
                paste(&mut sheet, (column_x(c), top + label), &fitted(picture, side));
            }
        }
        sheet
    }
}

/// The picture with its longer side at `side` pixels.
fn fitted(picture: &Picture, side: u32) -> Picture {
    let longest = picture.width.max(picture.height).max(1);
    let scaled = |n: u32| ((u64::from(n) * u64::from(side) / u64::from(longest)) as u32).max(1);
    picture.resized(scaled(picture.width), scaled(picture.height))
}

fn paste(sheet: &mut RgbImage, (left, top): (u32, u32), picture: &Picture) {
    for (i, pixel) in picture.values.iter().enumerate() {
        let (x, y) = (i as u32 % picture.width, i as u32 / picture.width);
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        sheet.put_pixel(left + x, top + y, Rgb(pixel.map(byte)));
    }
}

/// Writes text from its top left corner, cut off at `room` pixels or the sheet's edge.
fn write(sheet: &mut RgbImage, (left, top): (u32, u32), scale: u32, room: u32, text: &str) {
    let advance = (font::WIDTH as u32 + 1) * scale;
    for (i, character) in text.chars().take((room / advance) as usize).enumerate() {
        for (row, bits) in font::glyph(character).into_iter().enumerate() {
            for column in (0..font::WIDTH).filter(|c| bits >> (font::WIDTH - 1 - c) & 1 == 1) {
                let (x, y) = (left + i as u32 * advance + column as u32 * scale, top + row as u32 * scale);
                block(sheet, (x, y), scale);
            }
        }
    }
}

fn block(sheet: &mut RgbImage, (left, top): (u32, u32), size: u32) {
    for (x, y) in (0..size * size).map(|i| (left + i % size, top + i / size)) {
        if let Some(pixel) = sheet.get_pixel_mut_checked(x, y) {
            *pixel = INK;
        }
    }
}

/// A one-channel layer as grey.
pub fn grey(width: u32, height: u32, values: impl IntoIterator<Item = f32>) -> Picture {
    Plane { width, height, values: values.into_iter().map(|v| [v; 3]).collect() }
}

/// How far two pictures of one size differ: black for equal, over red and yellow to white at a mean channel
/// difference of 0.25.
pub fn error_map(a: &Picture, b: &Picture) -> Picture {
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

    fn flat(width: u32, height: u32, colour: [f32; 3]) -> Picture {
        Plane { width, height, values: vec![colour; (width * height) as usize] }
    }

    #[test]
    fn pictures_land_in_their_cells_and_empty_cells_stay_paper() {
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
    fn text_is_cut_off_rather_than_drawn_over_its_neighbour() {
        let mut sheet = RgbImage::from_pixel(40, 10, PAPER);
        write(&mut sheet, (0, 0), 1, 18, "MMMMMM");
        let rightmost = sheet.enumerate_pixels().filter(|(_, _, p)| **p == INK).map(|(x, _, _)| x).max();
        assert_eq!(rightmost, Some(2 * 6 + 4));
    }

    #[test]
    fn equal_pictures_have_a_black_error_map_and_opposite_ones_a_white_one() {
        let (black, white) = (flat(2, 1, [0.0; 3]), flat(2, 1, [1.0; 3]));
        assert_eq!(error_map(&black, &black).values, vec![[0.0; 3]; 2]);
        assert_eq!(error_map(&black, &white).values, vec![[1.0; 3]; 2]);
    }
}
