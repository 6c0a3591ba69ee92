//! Limits and options of an import.

use crate::formats::image_file;
use crate::{ColourMatrix, Up};
use relume_spec::training::TurntableCapture;

/// Bounds on what an import accepts, since archives are untrusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImportLimits {
    /// Entries in an archive or files in a folder.
    pub max_entries: usize,
    /// Uncompressed bytes of one entry.
    pub max_entry_bytes: u64,
    /// Uncompressed bytes of all entries together.
    pub max_total_bytes: u64,
    /// Bytes of memory for the names and headers of an archive's entries.
    pub max_header_bytes: u64,
    /// Bytes that a gzipped tar may unpack to. Unlike the other containers it is unpacked to disk as a whole.
    pub max_gzip_bytes: u64,
    /// Uncompressed size over compressed size, for entries beyond 1 MiB and for the whole archive.
    pub max_ratio: u64,
    /// Pixels of one image, checked in its header before it is decoded.
    pub max_image_pixels: u64,
    /// Photographs in a capture.
    pub max_images: usize,
    /// Pixels of all photographs together after reduction. A pixel takes 3 or 4 bytes of memory, of 16-bit files 6 or
    /// 8.
    pub max_total_pixels: u64,
    /// Sparse points in a capture.
    pub max_points: usize,
}

impl Default for ImportLimits {
    fn default() -> Self {
        Self {
            max_entries: 100_000,
            max_entry_bytes: 1 << 30,
            max_total_bytes: 64 << 30,
            max_header_bytes: 128 << 20,
            max_gzip_bytes: 4 << 30,
            max_ratio: 200,
            max_image_pixels: image_file::DEFAULT_MAX_PIXELS,
            max_images: 10_000,
            max_total_pixels: 8 << 30,
            max_points: 20_000_000,
        }
    }
}

/// Options of an import.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImportOptions {
    /// Longest image side, pixels. Larger photographs are reduced by area averaging right after decoding, and their
    /// cameras are scaled with them. `None` keeps the stored size.
    pub max_side: Option<u32>,
    /// Bounds on what is accepted.
    pub limits: ImportLimits,
    /// Load ground-truth layers of test views and the lights they name.
    pub load_truth: bool,
    /// Direction in the files that is up.
    pub up: Up,
    /// Whether the rotations of the light are derived from the poses.
    pub turntable: TurntableCapture,
    /// Matrix that is applied to the linear colours of all photographs and sparse points, not to ground truth.
    pub colour_matrix: Option<ColourMatrix>,
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self {
            max_side: None,
            limits: ImportLimits::default(),
            load_truth: true,
            up: Up::AUTO,
            turntable: TurntableCapture::Auto,
            colour_matrix: None,
        }
    }
}

impl ImportOptions {
    /// The defaults, with images of at most `side` pixels on their longer side.
    pub(super) fn at_most(side: u32) -> Self {
        Self { max_side: Some(side), ..Self::default() }
    }

    /// The size that an image of `width` x `height` pixels is reduced to: never enlarged, at least 1 x 1.
    pub fn reduced_size(&self, (width, height): (u32, u32)) -> (u32, u32) {
        let longest = width.max(height);
        match self.max_side {
            Some(side) if side < longest => {
                let scale = f64::from(side.max(1)) / f64::from(longest);
                let reduce = |n: u32| (f64::from(n) * scale).round().max(1.0) as u32;
                (reduce(width), reduce(height))
            }
            _ => (width, height),
        }
    }
}
