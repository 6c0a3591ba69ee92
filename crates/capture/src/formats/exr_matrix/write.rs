//! Writes a light matrix strip by strip, so that memory does not depend on the number of lights.

use std::io::{Cursor, Seek, SeekFrom, Write};
use std::ops::Range;

use exr::block::chunk::Chunk;
use exr::block::writer::ChunksWriter;
use exr::block::{BlockIndex, UncompressedBlock};
use exr::error::Error;
use exr::meta::{BlockDescription, header::Header};
use exr::prelude::{
    AttributeValue, ChannelDescription, Compression, ImageAttributes, IntegerBounds, LineOrder, SampleType,
    Vec2, f16,
};
use rayon::prelude::*;

use crate::formats::exr_frame::{FrameAttributes, HALF_MAX, part_attributes, text};
use crate::formats::exr_matrix::{ALPHA, DIRECTION, MatrixLightPart, RADIUS, SOLID_ANGLE, WEIGHT, names};
use crate::formats::{ImageFileError, exr_header};
use relume_spec::rendering::{ColourDepth, Primaries};

/// Rows of a strip: the lines of a block of the compression.
const STRIP: usize = 16;

/// A light matrix to write.
#[derive(Debug, Clone, Copy)]
pub struct MatrixFile<'a> {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// The lights. The file has one part more, the coverage, before them.
    pub lights: &'a [MatrixLightPart],
    /// Sample type of the colours. The coverage has the same.
    pub depth: ColourDepth,
    /// Attributes of every part.
    pub attributes: &'a FrameAttributes,
}

/// Errors of writing a light matrix.
#[derive(Debug, thiserror::Error)]
pub enum MatrixFileError {
    /// The caller no longer wants the file.
    #[error("the light matrix was cancelled")]
    Abandoned,
    /// The file cannot be written.
    #[error(transparent)]
    Io(std::io::Error),
    /// The matrix cannot be encoded.
    #[error(transparent)]
    Encode(#[from] ImageFileError),
}

impl From<Error> for MatrixFileError {
    fn from(error: Error) -> Self {
        match error {
            Error::Io(error) => Self::Io(error),
            Error::Aborted => Self::Abandoned,
            other => Self::Encode(ImageFileError::Encode(other.to_string())),
        }
    }
}

/// Takes the strips of a matrix.
pub struct StripWriter<'w> {
    headers: &'w [Header],
    strips: usize,
    write: &'w mut dyn FnMut(usize, Chunk) -> Result<(), Error>,
    is_wanted: &'w (dyn Fn() -> bool + Sync),
}

impl StripWriter<'_> {
    /// Writes all strips of `parts` (0 is the coverage, part k is light k - 1). `values` returns the strip with an index, on any thread: 16
    /// rows, fewer in the last strip, as `[part][channel][row][column]` with one channel of the coverage and three of a light.
    ///
    /// # Errors
    /// If writing fails, the file is not wanted any more, or a strip has another length.
    pub fn write(
        &mut self,
        parts: Range<usize>,
        values: &(dyn Fn(usize) -> Vec<f32> + Sync),
    ) -> Result<(), MatrixFileError> {
        let at_once = rayon::current_num_threads().max(1);
        for first in (0..self.strips).step_by(at_once) {
            let strips = first..(first + at_once).min(self.strips);
            let (headers, is_wanted) = (self.headers, self.is_wanted);
            let chunks: Vec<Vec<Chunk>> = strips
                .into_par_iter()
                .map(|strip| {
                    if !is_wanted() {
                        return Err(MatrixFileError::Abandoned);
                    }
                    compressed(headers, parts.clone(), strip, &values(strip))
                })
                .collect::<Result<_, _>>()?;
            for (strip, chunks) in (first..).zip(chunks) {
                chunks.into_iter().try_for_each(|chunk| (self.write)(strip, chunk))?;
            }
        }
        Ok(())
    }
}

/// Writes a ZIP-compressed file with the strips that `fill` passes on. Equal matrices give equal bytes.
///
/// # Errors
/// If writing fails, `is_wanted` returned false, or strips are missing.
pub fn write<W: Write + Seek>(
    out: &mut W,
    file: &MatrixFile<'_>,
    is_wanted: &(dyn Fn() -> bool + Sync),
    fill: impl FnOnce(&mut StripWriter<'_>) -> Result<(), MatrixFileError>,
) -> Result<(), MatrixFileError> {
    let headers = headers(file)?;
    let sorted = sorted_headers(&headers)?;
    let mut filled = Ok(());
    let written = exr::block::write(&mut *out, headers.into(), true, |meta, writer| {
        let mut write = |strip: usize, chunk: Chunk| writer.write_chunk(strip, chunk);
        let strips = (file.height as usize).div_ceil(STRIP);
        filled = fill(&mut StripWriter { headers: &meta.headers, strips, write: &mut write, is_wanted });
        if filled.is_ok() { Ok(()) } else { Err(Error::Aborted) }
    });
    filled?;
    written?;
    out.seek(SeekFrom::Start(0)).and_then(|_| out.write_all(&sorted)).map_err(MatrixFileError::Io)?;
    out.seek(SeekFrom::End(0)).and_then(|_| out.flush()).map_err(MatrixFileError::Io)
}

/// The bytes of the file before its offset tables, with sorted attributes.
fn sorted_headers(headers: &[Header]) -> Result<Vec<u8>, MatrixFileError> {
    let mut bytes = Cursor::new(Vec::new());
    let stopped = exr::block::write(&mut bytes, headers.into(), true, |_, _| Err(Error::Aborted));
    match stopped {
        Err(Error::Aborted) => {}
        Err(error) => return Err(error.into()),
        Ok(()) => return Err(MatrixFileError::Abandoned),
    }
    let mut bytes = bytes.into_inner();
    let end = exr_header::sort_attributes(&mut bytes);
    bytes.truncate(end);
    Ok(bytes)
}

fn headers(file: &MatrixFile<'_>) -> Result<Vec<Header>, MatrixFileError> {
    let mut headers = vec![header(file, ALPHA, &["A".to_owned()], None)?];
    for (light, name) in file.lights.iter().zip(names(file.lights)) {
        let channels = ["B", "G", "R"].map(|suffix| format!("{name}.{suffix}"));
        headers.push(header(file, &name, &channels, Some(light))?);
    }
    Ok(headers)
}

fn header(
    file: &MatrixFile<'_>,
    name: &str,
    channels: &[String],
    light: Option<&MatrixLightPart>,
) -> Result<Header, ImageFileError> {
    let size = Vec2(file.width as usize, file.height as usize);
    let sample = match file.depth {
        ColourDepth::Half => SampleType::F16,
        ColourDepth::Full => SampleType::F32,
    };
    let channel = |name: &String| Ok(ChannelDescription::named(text(name)?, sample));
    let channels = channels.iter().map(channel).collect::<Result<_, ImageFileError>>()?;
    let mut shared = ImageAttributes::new(IntegerBounds::from_dimensions(size));
    shared.pixel_aspect = file.attributes.lens.map_or(1.0, |lens| lens.pixel_aspect);
    let interop = if light.is_some() { Primaries::Rec709.interop_id() } else { "data" };
    let mut attributes = part_attributes(file.attributes, name, interop)?;
    if let Some(light) = light {
        let [x, y, z] = light.direction();
        let (extent, value) = match light {
            MatrixLightPart::Lobe { solid_angle, .. } => (SOLID_ANGLE, *solid_angle),
            MatrixLightPart::Sun(sun) => (RADIUS, sun.radius.to_degrees()),
        };
        attributes.other.insert(text(DIRECTION)?, AttributeValue::FloatVec3((x, y, z)));
        attributes.other.insert(text(extent)?, AttributeValue::F32(value));
        attributes.other.insert(text(WEIGHT)?, AttributeValue::Text(text(light.weight())?));
    }
    Ok(Header::new(text(name)?, size, channels)
        .with_encoding(Compression::ZIP16, BlockDescription::ScanLines, LineOrder::Increasing)
        .with_shared_attributes(shared)
        .with_attributes(attributes))
}

/// The blocks of strip `strip` of `parts`, whose planes are `values`.
fn compressed(
    headers: &[Header],
    parts: Range<usize>,
    strip: usize,
    values: &[f32],
) -> Result<Vec<Chunk>, MatrixFileError> {
    let (mut rest, mut out) = (values, Vec::with_capacity(parts.len()));
    for part in parts {
        let Some(header) = headers.get(part) else { break };
        let Vec2(width, height) = header.layer_size;
        let rows = STRIP.min(height - strip * STRIP);
        let channels = header.channels.list.len();
        let Some((planes, others)) = rest.split_at_checked(channels * rows * width) else { break };
        rest = others;
        let index = BlockIndex {
            layer: part,
            pixel_position: Vec2(0, strip * STRIP),
            pixel_size: Vec2(width, rows),
            level: Vec2(0, 0),
        };
        let block = UncompressedBlock::from_lines(&header.channels, index, |line| {
            // Channels are sorted by name: blue, green, red.
            let channel = channels - 1 - line.location.channel;
            let row = line.location.position.y() - strip * STRIP;
            let plane = &planes[(channel * rows + row) * width..][line.location.position.x()..];
            // Writing to a line in memory cannot fail.
            let _ = match header.channels.list[0].sample_type {
                SampleType::F16 => line.write_samples(|x| f16::from_f32(plane[x].clamp(-HALF_MAX, HALF_MAX))),
                _ => line.write_samples(|x| plane[x]),
            };
        });
        out.push(block.compress_to_chunk(headers)?);
    }
    match rest.is_empty() {
        true => Ok(out),
        false => Err(ImageFileError::Encode(format!("strip {strip} has another size than its parts")).into()),
    }
}
