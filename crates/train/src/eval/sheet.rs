//! Contact sheets: labelled images in a grid, as an image file.

use std::io::Cursor;

use image::codecs::jpeg::JpegEncoder;
use image::{ImageFormat, Rgb, RgbImage};

use crate::eval::image::DisplayImage;
use crate::eval::text::{LINE, PAPER, width_of, wrapped, write};

/// Pixels between cells and at the edges.
const GAP: u32 = 8;
/// Least width of a sheet, pixels: enough for the names of rows.
const MIN_WIDTH: u32 = 160;
/// JPEG quality, 0 to 100: no block structure is visible that could be taken for an error of the model.
const JPEG_QUALITY: u8 = 92;

/// The label of a column.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    /// The picture, e.g. `albedo`.
    pub title: String,
    /// A second line, e.g. the name of the light; may be empty.
    pub detail: String,
}

impl Column {
    /// A column.
    pub fn new(title: impl Into<String>, detail: impl Into<String>) -> Self {
        Self { title: title.into(), detail: detail.into() }
    }
}

/// The file format of a sheet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SheetFormat {
    /// PNG, without loss.
    #[default]
    Png,
    /// JPEG, about a quarter of the size.
    Jpeg,
}

/// A grid of images. A label stands above each column and each row, and lines of text above the grid.
#[derive(Debug, Clone, Default)]
pub struct Sheet {
    heading: Vec<String>,
    columns: Vec<Column>,
    rows: Vec<(String, Vec<Option<DisplayImage>>)>,
}

impl Sheet {
    /// An empty sheet with these columns.
    pub fn new(columns: impl IntoIterator<Item = Column>) -> Self {
        Self { columns: columns.into_iter().collect(), ..Self::default() }
    }

    /// Adds a line of text above the grid. A line that is wider than the grid is wrapped.
    pub fn add_heading(&mut self, line: impl Into<String>) {
        self.heading.push(line.into());
    }

    /// Adds a row. `None` is an empty cell; cells beyond the columns are not drawn. Images are drawn at their size.
    pub fn push(&mut self, name: impl Into<String>, cells: Vec<Option<DisplayImage>>) {
        self.rows.push((name.into(), cells));
    }

    /// The columns that have an image in some row. Only these are drawn.
    pub fn columns(&self) -> Vec<&Column> {
        self.drawn().map(|c| &self.columns[c]).collect()
    }

    /// The labels of the rows.
    pub fn row_names(&self) -> impl Iterator<Item = &str> {
        self.rows.iter().map(|(name, _)| name.as_str())
    }

    /// Indices of the columns that have an image in some row.
    fn drawn(&self) -> impl Iterator<Item = usize> {
        (0..self.columns.len()).filter(|c| self.column(*c).next().is_some())
    }

    /// The images of a column.
    fn column(&self, c: usize) -> impl Iterator<Item = &DisplayImage> {
        self.rows.iter().filter_map(move |(_, cells)| cells.get(c)?.as_ref())
    }

    /// Draws the sheet into the bytes of an image file.
    ///
    /// # Errors
    /// The error of the encoder, e.g. for a side of more than 65,535 pixels in a JPEG.
    pub fn encode(&self, format: SheetFormat) -> Result<Vec<u8>, image::ImageError> {
        let mut out = Cursor::new(Vec::new());
        let drawn = self.draw();
        match format {
            SheetFormat::Png => drawn.write_to(&mut out, ImageFormat::Png)?,
            SheetFormat::Jpeg => {
                drawn.write_with_encoder(JpegEncoder::new_with_quality(&mut out, JPEG_QUALITY))?;
            }
        }
        Ok(out.into_inner())
    }

    fn draw(&self) -> RgbImage {
        let columns: Vec<(u32, usize)> = self.column_positions();
        let right = columns.last().map_or(0, |(left, c)| left + self.column_width(*c));
        let width = (right + GAP).max(MIN_WIDTH);
        let heading: Vec<String> =
            self.heading.iter().flat_map(|line| wrapped(line, width - 2 * GAP)).collect();
        let labels: Vec<Vec<String>> = columns.iter().map(|(_, c)| self.label(*c)).collect();
        let label_lines = labels.iter().map(Vec::len).max().unwrap_or(0) as u32;
        let labels_top = GAP + LINE * heading.len() as u32 + GAP * u32::from(!heading.is_empty());
        let first_row = labels_top + LINE * label_lines;
        let height = first_row + self.rows.iter().map(|(_, cells)| row_height(cells)).sum::<u32>();
        let mut sheet = RgbImage::from_pixel(width, height.max(1), Rgb(PAPER));
        write_lines(&mut sheet, (GAP, GAP), &heading);
        for ((left, _), label) in columns.iter().zip(&labels) {
            write_lines(&mut sheet, (*left, labels_top), label);
        }
        let mut top = first_row;
        for (name, cells) in &self.rows {
            write(&mut sheet, (GAP, top + GAP / 2), name);
            for (left, c) in &columns {
                let Some(picture) = cells.get(*c).and_then(Option::as_ref) else { continue };
                paste(&mut sheet, (*left, top + GAP / 2 + LINE), picture);
            }
            top += row_height(cells);
        }
        sheet
    }

    /// The left edge and the index of each drawn column.
    fn column_positions(&self) -> Vec<(u32, usize)> {
        let mut left = GAP;
        let place = |c: usize| {
            let here = left;
            left += self.column_width(c) + GAP;
            (here, c)
        };
        self.drawn().map(place).collect()
    }

    /// The width of a column: of its widest image, or of the longest word of its label, so that no label is cut off.
    fn column_width(&self, c: usize) -> u32 {
        let Column { title, detail } = &self.columns[c];
        let words = title.split_whitespace().chain(detail.split_whitespace()).map(width_of);
        self.column(c).map(|picture| picture.width).chain(words).max().unwrap_or(0)
    }

    /// The lines of a column's label.
    fn label(&self, c: usize) -> Vec<String> {
        let (Column { title, detail }, width) = (&self.columns[c], self.column_width(c));
        [title, detail].into_iter().flat_map(|text| wrapped(text, width)).collect()
    }
}

/// Writes lines of text below each other.
fn write_lines(sheet: &mut RgbImage, (left, top): (u32, u32), lines: &[String]) {
    for (i, line) in lines.iter().enumerate() {
        write(sheet, (left, top + LINE * i as u32), line);
    }
}

/// The height of a row with its label, pixels.
fn row_height(cells: &[Option<DisplayImage>]) -> u32 {
    let tallest = cells.iter().flatten().map(|picture| picture.height).max().unwrap_or(0);
    LINE + tallest + 2 * GAP
}

fn paste(sheet: &mut RgbImage, (left, top): (u32, u32), picture: &DisplayImage) {
    for (i, pixel) in picture.values.iter().enumerate() {
        let (x, y) = (i as u32 % picture.width, i as u32 / picture.width);
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        sheet.put_pixel(left + x, top + y, Rgb(pixel.map(byte)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::Plane;

    fn flat(width: u32, height: u32, colour: [f32; 3]) -> DisplayImage {
        Plane { width, height, values: vec![colour; (width * height) as usize] }
    }

    fn sheet(cells: [Option<DisplayImage>; 3]) -> Sheet {
        let mut sheet = Sheet::new(["one", "two", "three"].map(|title| Column::new(title, "")));
        sheet.push("view", cells.into());
        sheet
    }

    #[test]
    fn images_are_drawn_at_their_size_and_empty_columns_left_out() {
        let red = flat(80, 30, [1.0, 0.0, 0.0]);
        let sheet = sheet([Some(flat(70, 20, [0.0; 3])), None, Some(red)]);
        assert_eq!(sheet.columns().iter().map(|c| c.title.as_str()).collect::<Vec<_>>(), ["one", "three"]);
        let drawn = sheet.draw();
        assert_eq!(drawn.width(), GAP + 70 + GAP + 80 + GAP);
        let is_red = |p: &Rgb<u8>| *p == Rgb([255, 0, 0]);
        let columns: Vec<u32> =
            drawn.enumerate_pixels().filter(|(_, _, p)| is_red(p)).map(|(x, _, _)| x).collect();
        assert_eq!((columns.len(), columns.iter().min()), (80 * 30, Some(&(GAP + 70 + GAP))));
        let png = image::load_from_memory(&sheet.encode(SheetFormat::Png).unwrap()).unwrap().into_rgb8();
        assert_eq!(png, drawn);
        let jpeg = sheet.encode(SheetFormat::Jpeg).unwrap();
        assert_eq!(image::guess_format(&jpeg).unwrap(), ImageFormat::Jpeg);
    }

    #[test]
    fn labels_are_wrapped_to_their_column_and_never_cut() {
        let mut sheet = Sheet::new([Column::new("one", "longest of words"), Column::new("two", "")]);
        sheet.push("view", vec![Some(flat(16, 16, [1.0; 3])), Some(flat(16, 16, [1.0; 3]))]);
        assert_eq!(sheet.column_positions()[1].0, GAP + width_of("longest") + GAP);
        assert_eq!(sheet.label(0), ["one", "longest", "of", "words"]);
        let before = sheet.draw().height();
        sheet.add_heading("word ".repeat(40));
        assert!(sheet.draw().height() > before + 2 * LINE, "the heading is wrapped");
    }

    #[test]
    fn a_sheet_without_rows_or_columns_is_still_an_image() {
        assert!(Sheet::default().encode(SheetFormat::Png).is_ok());
        assert!(sheet([None, None, None]).encode(SheetFormat::Png).is_ok());
    }
}
