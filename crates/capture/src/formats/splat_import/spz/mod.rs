//! SPZ files (Niantic), versions 2 to 4.
//!
//! Each attribute of all splats is a block of bytes: positions as 24-bit fixed-point numbers, opacities, colours and
//! log-scales as 8 bits, rotations as 3 (version 2) or 4 bytes, and SH coefficients as 8 bits. [`container`] finds the
//! blocks. The axes stay those of the file.

mod container;

use crate::formats::ply_table::{PlyError, PlyTable};
use crate::formats::splats::MAX_SPLAT_SH_DEGREE;
use container::SpzBlocks;
use relume_scene::sh_count;

/// Scale of the colour: level 255 is a coefficient of `0.5 / 0.15`.
const COLOUR_SCALE: f64 = 0.15;
/// Greatest number of the magnitude of a quaternion component with 9 bits.
const MAX_9_BITS: f64 = 511.0;

/// True if the bytes begin like an SPZ file: with its signature, bare or compressed with gzip.
pub(super) fn is_spz(bytes: &[u8]) -> bool {
    container::is_spz(bytes)
}

/// The splats as the table of an ordinary PLY, and notes on data that the import omits.
///
/// # Errors
/// Names the version, field or block of the file that is not supported or truncated.
pub(super) fn read(bytes: &[u8]) -> Result<(PlyTable, Vec<String>), PlyError> {
    let blocks = container::read(bytes)?;
    let degree = blocks.degree.min(MAX_SPLAT_SH_DEGREE);
    let names = names(sh_count(degree));
    let mut numbers = Vec::with_capacity(blocks.count * names.len());
    for i in 0..blocks.count {
        write_splat(&blocks, i, sh_count(degree), &mut numbers);
    }
    let mut notes = Vec::new();
    if blocks.degree > degree {
        notes.push(format!("the SH coefficients above degree {degree} were left out"));
    }
    if blocks.has_extensions {
        notes.push(
            "the extensions of the file were skipped; its axes may be others than stated there".to_owned(),
        );
    }
    let mode = if blocks.is_antialiased { "mip" } else { "default" };
    let comments = vec![format!("comment SplatRenderMode: {mode}")];
    Ok((PlyTable::of_floats(names, comments, numbers), notes))
}

/// Names of the values that [`write_splat`] writes, for `bases` SH coefficients a channel.
fn names(bases: usize) -> Vec<String> {
    let numbered = |stem: &str, count: usize| (0..count).map(|k| format!("{stem}_{k}")).collect::<Vec<_>>();
    [
        ["x", "y", "z"].map(str::to_owned).to_vec(),
        numbered("f_dc", 3),
        numbered("f_rest", 3 * (bases - 1)),
        vec!["opacity".to_owned()],
        numbered("scale", 3),
        numbered("rot", 4),
    ]
    .concat()
}

/// Appends the values of splat `i`.
fn write_splat(blocks: &SpzBlocks, i: usize, bases: usize, out: &mut Vec<f64>) {
    let unit = f64::from(1u32 << blocks.fractional_bits).recip();
    let positions = blocks.positions[9 * i..9 * (i + 1)].as_chunks::<3>().0;
    out.extend(positions.iter().map(|bytes| unit * fixed_24(*bytes)));
    let colours = &blocks.colours[3 * i..3 * (i + 1)];
    out.extend(colours.iter().map(|c| (f64::from(*c) / 255.0 - 0.5) / COLOUR_SCALE));
    let stored = sh_count(blocks.degree) - 1;
    let harmonics = blocks.harmonics[3 * stored * i..3 * stored * (i + 1)].as_chunks::<3>().0;
    for channel in 0..3 {
        out.extend(harmonics[..bases - 1].iter().map(|c| (f64::from(c[channel]) - 128.0) / 128.0));
    }
    let opacity = f64::from(blocks.opacities[i]) / 255.0;
    out.push((opacity / (1.0 - opacity)).ln());
    out.extend(blocks.scales[3 * i..3 * (i + 1)].iter().map(|s| f64::from(*s) / 16.0 - 10.0));
    let width = blocks.rotation_bytes;
    out.extend(match blocks.rotations[width * i..width * (i + 1)] {
        [x, y, z] => first_three([x, y, z]),
        [a, b, c, d] => smallest_three(u32::from_le_bytes([a, b, c, d])),
        _ => [1.0, 0.0, 0.0, 0.0],
    });
}

/// A signed number of 24 bits, little-endian.
fn fixed_24([a, b, c]: [u8; 3]) -> f64 {
    // In the upper bytes, so that the shift back extends the sign.
    f64::from(i32::from_le_bytes([0, a, b, c]) >> 8)
}

/// The quaternion `w x y z` from `x y z`; `w` is not negative and follows from the unit length.
fn first_three(bytes: [u8; 3]) -> [f64; 4] {
    let [x, y, z] = bytes.map(|b| f64::from(b) / 127.5 - 1.0);
    [(1.0 - x * x - y * y - z * z).max(0.0).sqrt(), x, y, z]
}

/// The quaternion `w x y z` from its smallest three components. The two upper bits are the index of the largest one in
/// the order `x y z w`. The others follow from the last to the first in 10 bits each: the sign, and the magnitude, whose
/// greatest number is `1 / sqrt(2)`.
fn smallest_three(mut packed: u32) -> [f64; 4] {
    let largest = (packed >> 30) as usize;
    let mut xyzw = [0.0f64; 4];
    for component in (0..4).rev().filter(|c| *c != largest) {
        let magnitude = std::f64::consts::FRAC_1_SQRT_2 * f64::from(packed & 0x1ff) / MAX_9_BITS;
        xyzw[component] = if packed & 0x200 == 0 { magnitude } else { -magnitude };
        packed >>= 10;
    }
    xyzw[largest] = (1.0 - xyzw.iter().map(|c| c * c).sum::<f64>()).max(0.0).sqrt();
    let [x, y, z, w] = xyzw;
    [w, x, y, z]
}

#[cfg(test)]
pub(super) mod tests;
