//! COLMAP's text files. Errors name the file and the line or entry at fault.

use std::borrow::Cow;
use std::collections::BTreeMap;

use glam::DVec3;

use super::camera_models::lens;
use super::model::{PosedImage, check_count, coloured, posed};
use crate::formats::ply_points::Point;
use crate::lens::Lens;
use crate::{CaptureError, text};

/// A text file with its name for errors.
pub(super) struct TextFile<'a> {
    pub file: &'a str,
    text: Cow<'a, str>,
}

impl<'a> TextFile<'a> {
    /// The bytes of `file`, which must be UTF-8 or UTF-16 with a byte order mark.
    pub(super) fn new(file: &'a str, bytes: &'a [u8]) -> Result<Self, CaptureError> {
        let reason = "is not UTF-8 text".to_owned();
        let text = text::decode(bytes).ok_or(CaptureError::File { file: file.to_owned(), reason })?;
        Ok(Self { file, text })
    }

    /// Lines with their numbers from 1, without comments.
    fn lines(&self) -> impl Iterator<Item = (usize, &str)> {
        let numbered = self.text.lines().enumerate().map(|(i, l)| (i + 1, l.trim()));
        numbered.filter(|(_, l)| !l.starts_with('#'))
    }

    /// The first line of each image. The second has its observations: three numbers each. Some programs omit empty second
    /// lines, so a line is one of observations only if it looks like one.
    pub(super) fn image_lines(&self) -> impl Iterator<Item = (usize, &str)> {
        let mut may_be_observations = false;
        self.lines().filter(move |(_, line)| {
            let is_second = may_be_observations && is_observations(line);
            may_be_observations = !(line.is_empty() || is_second);
            may_be_observations
        })
    }

    fn line_error(&self, line: usize, reason: &str) -> CaptureError {
        CaptureError::at_field(self.file, format!("line {line}"), reason)
    }

    /// The first `N` words as numbers.
    fn numbers<const N: usize>(&self, line: usize, words: &[&str]) -> Result<[f64; N], CaptureError> {
        let values: Option<Vec<f64>> = words.iter().take(N).map(|w| w.parse().ok()).collect();
        let array = values.and_then(|v| <[f64; N]>::try_from(v).ok());
        array.ok_or_else(|| self.line_error(line, &format!("must have {N} numbers here")))
    }

    fn id(&self, line: usize, word: Option<&&str>) -> Result<u32, CaptureError> {
        let id = word.and_then(|w| w.parse().ok());
        id.ok_or_else(|| self.line_error(line, "must have a whole number as id"))
    }
}

/// Whether a line consists of triples of numbers.
fn is_observations(line: &str) -> bool {
    let mut words = 0;
    let are_numbers = line.split_whitespace().inspect(|_| words += 1).all(|word| word.parse::<f64>().is_ok());
    are_numbers && words % 3 == 0
}

/// Lenses by camera id.
pub(super) fn cameras(text: &TextFile<'_>) -> Result<BTreeMap<u32, Lens>, CaptureError> {
    let mut lenses = BTreeMap::new();
    for (line, content) in text.lines().filter(|(_, l)| !l.is_empty()) {
        let words: Vec<&str> = content.split_whitespace().collect();
        let id = text.id(line, words.first())?;
        let model = words.get(1).ok_or_else(|| text.line_error(line, "has no camera model"))?;
        let [w, h] = text.numbers(line, words.get(2..).unwrap_or_default())?;
        let params: Option<Vec<f64>> = words[4..].iter().map(|w| w.parse().ok()).collect();
        let params = params.ok_or_else(|| text.line_error(line, "has a parameter that is not a number"))?;
        lenses.insert(id, lens(text.file, id, model, (w, h), &params)?);
    }
    Ok(lenses)
}

/// Images in file order, at most `allowed`.
pub(super) fn images(text: &TextFile<'_>, allowed: usize) -> Result<Vec<PosedImage>, CaptureError> {
    let mut images = Vec::new();
    for (line, content) in text.image_lines() {
        let words: Vec<&str> = content.split_whitespace().collect();
        let [_id, qw, qx, qy, qz, tx, ty, tz] = text.numbers(line, &words)?;
        let camera = text.id(line, words.get(8))?;
        let name = words.get(9..).filter(|w| !w.is_empty()).map(|w| w.join(" "));
        let name = name.ok_or_else(|| text.line_error(line, "has no image name"))?;
        images.push(posed(text.file, name, camera, [qw, qx, qy, qz], [tx, ty, tz])?);
        check_count(text.file, "max_images", images.len(), allowed)?;
    }
    Ok(images)
}

/// Points in file order, at most `allowed`.
pub(super) fn points(text: &TextFile<'_>, allowed: usize) -> Result<Vec<Point>, CaptureError> {
    let mut points = Vec::new();
    for (line, content) in text.lines().filter(|(_, l)| !l.is_empty()) {
        let words: Vec<&str> = content.split_whitespace().take(7).collect();
        let [_id, x, y, z, r, g, b] = text.numbers(line, &words)?;
        let colour = [r, g, b].map(|c| c.clamp(0.0, 255.0) as u8);
        points.push(coloured(text.file, points.len(), DVec3::new(x, y, z), colour)?);
        check_count(text.file, "max_points", points.len(), allowed)?;
    }
    Ok(points)
}
