//! The pixels of the colour of an OpenEXR file. Of each block only the channels of the colour are kept.

use std::io::Cursor;

use exr::block::UncompressedBlock;
use exr::block::lines::LineRef;
use exr::block::reader::ChunksReader;
use exr::error::{Error, Result, UnitResult};
use exr::math::Vec2;
use exr::meta::attribute::{ChannelList, SampleType};
use exr::prelude::f16;

use super::damaged;
use crate::formats::ImageFileError;
use crate::formats::exr_channels::ColourChannels;

/// Level of the full resolution.
const FULL: Vec2<usize> = Vec2(0, 0);

/// The pixels of the data window, row-major. The caller checks the area of the data window first.
///
/// # Errors
/// [`ImageFileError::Damaged`] when the file is corrupt.
pub(super) fn read(
    bytes: &[u8],
    colour: ColourChannels,
) -> std::result::Result<Vec<[f32; 4]>, ImageFileError> {
    read_blocks(bytes, colour).map_err(damaged)
}

fn read_blocks(bytes: &[u8], colour: ColourChannels) -> Result<Vec<[f32; 4]>> {
    let reader = exr::block::read(Cursor::new(bytes), false)?;
    let header = reader.headers().get(colour.part).ok_or_else(|| invalid("part"))?;
    let size = header.layer_size;
    let mut window = DataWindow {
        colour,
        channels: header.channels.clone(),
        width: size.width(),
        pixels: vec![[0.0, 0.0, 0.0, 1.0]; size.area()],
    };
    let chunks =
        reader.filter_chunks(false, |_, _, block| block.layer == colour.part && block.level == FULL)?;
    chunks.decompress_parallel(false, |_, block| window.insert(&block))?;
    Ok(window.pixels)
}

fn invalid(what: &'static str) -> Error {
    Error::Invalid(what.into())
}

/// The pixels that were read so far.
struct DataWindow {
    colour: ColourChannels,
    channels: ChannelList,
    width: usize,
    pixels: Vec<[f32; 4]>,
}

impl DataWindow {
    fn insert(&mut self, block: &UncompressedBlock) -> UnitResult {
        // The table of offsets of a corrupt file may name a block of another part.
        if block.index.layer != self.colour.part || block.index.level != FULL {
            return Err(invalid("table of offsets"));
        }
        let Self { colour, channels, width, pixels } = self;
        let places = [Some(colour.rgb[0]), Some(colour.rgb[1]), Some(colour.rgb[2]), colour.alpha];
        for line in block.lines(channels) {
            let Vec2(x, y) = line.location.position;
            let row = y.checked_mul(*width).and_then(|row| pixels.get_mut(row..)?.get_mut(x..*width));
            let row = row.ok_or_else(|| invalid("position of a block"))?;
            for (place, _) in places.iter().enumerate().filter(|(_, c)| **c == Some(line.location.channel)) {
                write(line, channels.list[line.location.channel].sample_type, row, place)?;
            }
        }
        Ok(())
    }
}

/// Writes the values of a line of samples to one place of each pixel of a row.
fn write(line: LineRef<'_>, kind: SampleType, row: &mut [[f32; 4]], place: usize) -> UnitResult {
    let mut fill = |values: &mut dyn Iterator<Item = Result<f32>>| -> UnitResult {
        for (pixel, value) in row.iter_mut().zip(values) {
            pixel[place] = value?;
        }
        Ok(())
    };
    match kind {
        SampleType::F16 => fill(&mut line.read_samples::<f16>().map(|value| Ok(value?.to_f32()))),
        SampleType::F32 => fill(&mut line.read_samples::<f32>()),
        SampleType::U32 => fill(&mut line.read_samples::<u32>().map(|value| Ok(value? as f32))),
    }
}
