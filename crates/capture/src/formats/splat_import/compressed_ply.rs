//! Compressed PLY files of SuperSplat and splat-transform.
//!
//! An element `chunk` has the ranges of 256 splats each, and an element `vertex` four packed integers a splat: position
//! and scale as 11, 10 and 11 bits in the ranges of the chunk, rotation as the index of its largest component (2 bits)
//! and the other three (10 bits each, -1/sqrt(2) to 1/sqrt(2)), and colour and opacity as 8 bits each. An optional
//! element `sh` has the other SH coefficients as 8 bits from -4 to 4.

use crate::formats::ply_table::{PlyError, PlyFile, PlyTable, bad};
use crate::formats::splats::Y_0;

/// Splats of a chunk.
const CHUNK: usize = 256;
const PACKED: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];
/// Range of the SH coefficients of degree 1 and above.
const SH_RANGE: f64 = 8.0;

/// True if the header is that of a compressed PLY.
pub(super) fn is_compressed(file: &PlyFile<'_>) -> bool {
    file.has("chunk") && file.has_property("vertex", PACKED[0])
}

/// The splats as the table of an ordinary PLY.
///
/// # Errors
/// Names the element or property that is missing, truncated or of another length.
pub(super) fn read(file: &PlyFile<'_>) -> Result<PlyTable, PlyError> {
    let (vertices, chunks) = (file.table("vertex", usize::MAX)?, file.table("chunk", usize::MAX)?);
    let packed = columns(&vertices, "vertex", PACKED)?;
    let ranges = Ranges::of(&chunks)?;
    let harmonics = if file.has("sh") { Some(file.table("sh", usize::MAX)?) } else { None };
    let (count, chunk_count) = (vertices.rows().len(), chunks.rows().len());
    if chunk_count < count.div_ceil(CHUNK) {
        return bad("element chunk", format!("{chunk_count} chunks are too few for {count} splats"));
    }
    if harmonics.as_ref().is_some_and(|sh| sh.rows().len() != count) {
        return bad("element sh", format!("must have a row for each of the {count} splats"));
    }
    let mut names: Vec<String> = ORDINARY.map(str::to_owned).to_vec();
    names.extend(harmonics.iter().flat_map(PlyTable::names).map(str::to_owned));
    let mut numbers = Vec::with_capacity(count * names.len());
    for (i, row) in vertices.rows().enumerate() {
        let packed = packed.map(|column| row[column] as u32);
        let chunk = chunks.rows().nth(i / CHUNK).unwrap_or_default();
        numbers.extend(splat(packed, &ranges, chunk));
        let levels = harmonics.as_ref().and_then(|sh| sh.rows().nth(i)).unwrap_or_default();
        numbers.extend(levels.iter().map(|level| SH_RANGE * (sh_share(*level) - 0.5)));
    }
    Ok(PlyTable::of_floats(names, file.comments().to_vec(), numbers))
}

/// Names of the values that [`splat`] returns.
const ORDINARY: [&str; 14] = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0",
    "rot_1", "rot_2", "rot_3",
];

/// Columns of the least and greatest values of a chunk.
struct Ranges {
    position: [[usize; 2]; 3],
    scale: [[usize; 2]; 3],
    /// Absent in files of the first version, whose colours are from 0 to 1.
    colour: Option<[[usize; 2]; 3]>,
}

impl Ranges {
    fn of(chunks: &PlyTable) -> Result<Self, PlyError> {
        let of = |axes: [&str; 3]| -> Result<[[usize; 2]; 3], PlyError> {
            let mut out = [[0; 2]; 3];
            for (o, axis) in out.iter_mut().zip(axes) {
                let names = [format!("min_{axis}"), format!("max_{axis}")];
                *o = columns(chunks, "chunk", [&names[0], &names[1]])?;
            }
            Ok(out)
        };
        Ok(Self {
            position: of(["x", "y", "z"])?,
            scale: of(["scale_x", "scale_y", "scale_z"])?,
            colour: of(["r", "g", "b"]).ok(),
        })
    }
}

fn columns<const N: usize>(
    table: &PlyTable,
    element: &str,
    names: [&str; N],
) -> Result<[usize; N], PlyError> {
    let mut out = [0; N];
    for (o, name) in out.iter_mut().zip(names) {
        match table.column(name) {
            Some(column) => *o = column,
            None => return bad(format!("property {name}"), format!("is missing in element {element}")),
        }
    }
    Ok(out)
}

/// The values of a splat: position, colour, opacity, scale and rotation, in the order of [`ORDINARY`].
fn splat([position, rotation, scale, colour]: [u32; 4], ranges: &Ranges, chunk: &[f64]) -> [f64; 14] {
    let within = |columns: [[usize; 2]; 3], shares: [f64; 3]| -> [f64; 3] {
        std::array::from_fn(|k| {
            let [least, greatest] = columns[k].map(|column| chunk.get(column).copied().unwrap_or_default());
            least * (1.0 - shares[k]) + greatest * shares[k]
        })
    };
    let [x, y, z] = within(ranges.position, shares_of_11_10_11(position));
    let [sx, sy, sz] = within(ranges.scale, shares_of_11_10_11(scale));
    let [r, g, b, opacity] = [24, 16, 8, 0].map(|shift| share(colour >> shift, 8));
    let shown = ranges.colour.map_or([r, g, b], |columns| within(columns, [r, g, b]));
    let [r, g, b] = shown.map(|c| (c - 0.5) / f64::from(Y_0));
    let [w, i, j, k] = quaternion(rotation);
    [x, y, z, r, g, b, (opacity / (1.0 - opacity)).ln(), sx, sy, sz, w, i, j, k]
}

/// The low bits of a number as a share of the greatest number with as many bits, 0 to 1.
fn share(number: u32, bits: u32) -> f64 {
    let greatest = (1u32 << bits) - 1;
    f64::from(number & greatest) / f64::from(greatest)
}

fn shares_of_11_10_11(packed: u32) -> [f64; 3] {
    [share(packed >> 21, 11), share(packed >> 11, 10), share(packed, 11)]
}

/// `w x y z`: the largest component has the index in the two upper bits, and follows from the unit length.
fn quaternion(packed: u32) -> [f64; 4] {
    let small = [20, 10, 0].map(|shift| (share(packed >> shift, 10) - 0.5) * std::f64::consts::SQRT_2);
    let largest = (1.0 - small.iter().map(|c| c * c).sum::<f64>()).max(0.0).sqrt();
    let mut out = small.to_vec();
    out.insert((packed >> 30) as usize, largest);
    [out[0], out[1], out[2], out[3]]
}

/// Middle of the interval of an SH level, 0 to 1; the outer levels are exact.
fn sh_share(level: f64) -> f64 {
    match level as u8 {
        0 => 0.0,
        255 => 1.0,
        level => (f64::from(level) + 0.5) / 256.0,
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::formats::splat_import::decode;
    use relume_scene::Field;

    /// Two splats in one chunk: at the least and at the greatest values of the ranges.
    pub(in crate::formats::splat_import) fn example(harmonics: bool) -> Vec<u8> {
        let mut text = String::from("ply\nformat binary_little_endian 1.0\nelement chunk 1\n");
        let axes = ["x", "y", "z", "scale_x", "scale_y", "scale_z", "r", "g", "b"];
        let names = ["min", "max"].map(|end| axes.map(|axis| format!("{end}_{axis}")));
        names.as_flattened().iter().for_each(|name| text += &format!("property float {name}\n"));
        text += "element vertex 2\n";
        PACKED.iter().for_each(|name| text += &format!("property uint {name}\n"));
        if harmonics {
            text += "element sh 2\n";
            (0..9).for_each(|k| text += &format!("property uchar f_rest_{k}\n"));
        }
        let mut out = (text + "end_header\n").into_bytes();
        let (least, greatest) = (
            [-1.0f32, -2.0, -3.0, -5.0, -5.0, -5.0, 0.0, 0.0, 0.0],
            [1.0f32, 2.0, 3.0, -1.0, -1.0, -1.0, 1.0, 1.0, 1.0],
        );
        least.iter().chain(&greatest).for_each(|v| out.extend(v.to_le_bytes()));
        // The identity: the largest component is w, the others are 512 of 1023, near 0.
        let identity = 512u32 << 20 | 512 << 10 | 512;
        let first = [0, identity, 0, 0xff_00_80_80];
        let second = [u32::MAX, 1 << 30 | identity, u32::MAX, 0x00_ff_80_ff];
        first.iter().chain(&second).for_each(|v: &u32| out.extend(v.to_le_bytes()));
        if harmonics {
            out.extend([0, 128, 255, 128, 128, 128, 128, 128, 128].repeat(2));
        }
        out
    }

    fn near(a: &[f32], b: &[f32], tolerance: f32) -> bool {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < tolerance)
    }

    #[test]
    fn packed_values_are_unpacked() {
        let model = decode(&example(true)).unwrap().model;
        let splats = crate::formats::splats::Splats::of(&model);
        assert!(near(&splats.positions[0].to_array(), &[-1.0, -2.0, -3.0], 1e-5));
        assert!(near(&splats.positions[1].to_array(), &[1.0, 2.0, 3.0], 1e-5));
        assert!(
            near(&splats.log_scales[0], &[-5.0; 3], 1e-5) && near(&splats.log_scales[1], &[-1.0; 3], 1e-5)
        );
        assert!((splats.opacity(0) - 128.0 / 255.0).abs() < 1e-5 && splats.opacity(1) == 1.0);
        let colour = splats.harmonics(0)[0].map(|c| 0.5 + Y_0 * c);
        assert!(near(&colour, &[1.0, 0.0, 128.0 / 255.0], 1e-5), "{colour:?}");
        assert!(near(model.gaussians.row(Field::Quaternion, 0), &[1.0, 0.0, 0.0, 0.0], 1e-2));
        assert!(near(model.gaussians.row(Field::Quaternion, 1), &[0.0, 1.0, 0.0, 0.0], 1e-2));
        let red: Vec<f32> = (1..4).map(|j| splats.harmonics(0)[j][0]).collect();
        assert!(near(&red, &[-4.0, 8.0 * (128.5 / 256.0 - 0.5), 4.0], 1e-5), "channel by channel: {red:?}");
        assert_eq!(model.card["imported"]["from"], "compressed ply");
        assert!(!model.shading.low_pass_compensation);
    }

    #[test]
    fn truncated_and_incomplete_files_are_refused() {
        let whole = example(true);
        assert!(decode(&whole).is_ok() && decode(&example(false)).is_ok());
        for cut in 1..120 {
            assert!(decode(&whole[..whole.len() - cut]).is_err(), "{cut} bytes less");
        }
        let text = String::from_utf8_lossy(&whole[..600]).into_owned();
        assert!(text.contains("min_y"));
        let at = whole.windows(5).position(|w| w == b"min_y").unwrap();
        let mut renamed = whole.clone();
        renamed[at + 4] = b'q';
        assert!(decode(&renamed).unwrap_err().to_string().contains("min_y"));
    }
}
