//! `.splat` files (antimatter15): 32 bytes a splat, without a header.
//!
//! Position and standard deviations as six f32, colour and opacity as four u8, and the quaternion `w x y z` as four u8
//! with 128 as zero and 128 steps to 1.

use crate::formats::ply_table::PlyTable;
use crate::formats::splats::Y_0;

/// Bytes of a splat.
const RECORD: usize = 32;
/// Share of plausible records in a file that is recognised by its content.
const PLAUSIBLE: f64 = 0.9;
/// Greatest position and standard deviation of a plausible record.
const MAX_LENGTH: f32 = 1e6;

const NAMES: [&str; 14] = [
    "x", "y", "z", "scale_0", "scale_1", "scale_2", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "rot_0",
    "rot_1", "rot_2", "rot_3",
];

/// True if the bytes are records whose positions, sizes and unit quaternions are plausible. The format has no signature.
pub(super) fn is_splat(bytes: &[u8]) -> bool {
    let (records, rest) = bytes.as_chunks::<RECORD>();
    if records.is_empty() || !rest.is_empty() {
        return false;
    }
    let plausible = records.iter().filter(|record| is_plausible(record)).count();
    plausible as f64 >= PLAUSIBLE * records.len() as f64
}

fn is_plausible(record: &[u8; RECORD]) -> bool {
    let lengths: [f32; 6] = std::array::from_fn(|k| float(record, k));
    let is_position = |v: &f32| v.abs() <= MAX_LENGTH;
    let is_scale = |v: &f32| *v > 0.0 && *v <= MAX_LENGTH;
    let norm = quaternion(record).iter().map(|c| c * c).sum::<f64>();
    lengths[..3].iter().all(is_position) && lengths[3..].iter().all(is_scale) && (0.9..1.1).contains(&norm)
}

fn float(record: &[u8; RECORD], index: usize) -> f32 {
    f32::from_le_bytes(std::array::from_fn(|k| record[4 * index + k]))
}

fn quaternion(record: &[u8; RECORD]) -> [f64; 4] {
    std::array::from_fn(|k| (f64::from(record[28 + k]) - 128.0) / 128.0)
}

/// The splats as the table of an ordinary PLY. Bytes after the last record are ignored.
pub(super) fn read(bytes: &[u8]) -> PlyTable {
    let records = bytes.as_chunks::<RECORD>().0;
    let mut numbers = Vec::with_capacity(records.len() * NAMES.len());
    for record in records {
        let lengths: [f64; 6] = std::array::from_fn(|k| f64::from(float(record, k)));
        numbers.extend_from_slice(&lengths[..3]);
        numbers.extend(lengths[3..].iter().map(|s| s.ln()));
        let colour = record[24..27].iter().map(|c| (f64::from(*c) / 255.0 - 0.5) / f64::from(Y_0));
        numbers.extend(colour);
        let opacity = f64::from(record[27]) / 255.0;
        numbers.push((opacity / (1.0 - opacity)).ln());
        numbers.extend(quaternion(record));
    }
    PlyTable::of_floats(NAMES.map(str::to_owned).to_vec(), Vec::new(), numbers)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::formats::splat_import::decode;
    use crate::formats::splats::Splats;

    /// Two splats: one opaque and red, one half transparent.
    pub(in crate::formats::splat_import) fn example() -> Vec<u8> {
        let record = |x: f32, scale: f32, bytes: [u8; 8]| {
            let lengths = [x, 0.5, -0.5, scale, 2.0 * scale, scale];
            [lengths.iter().flat_map(|v| v.to_le_bytes()).collect(), bytes.to_vec()].concat()
        };
        let first: Vec<u8> = record(1.0, 0.1, [255, 0, 0, 255, 255, 128, 128, 128]);
        [first, record(-1.0, 0.2, [0, 0, 255, 51, 128, 128, 128, 0])].concat()
    }

    #[test]
    fn records_are_read() {
        let model = decode(&example()).unwrap().model;
        let splats = Splats::of(&model);
        assert_eq!(splats.len(), 2);
        assert!((splats.positions[1].x + 1.0).abs() < 1e-5 && (splats.scale(1)[1] - 0.4).abs() < 1e-5);
        assert!(splats.opacity(0) == 1.0 && (splats.opacity(1) - 0.2).abs() < 1e-5);
        let colour = splats.harmonics(0)[0].map(|c| 0.5 + Y_0 * c);
        assert!((colour[0] - 1.0).abs() < 1e-5 && colour[1].abs() < 1e-5, "{colour:?}");
        assert!((splats.rotations[0].w - 1.0).abs() < 1e-6 && (splats.rotations[1].z + 1.0).abs() < 1e-6);
        assert_eq!(model.card["imported"]["from"], "splat");
    }

    #[test]
    fn other_bytes_are_not_taken_for_records() {
        assert!(is_splat(&example()));
        assert!(!is_splat(&[]) && !is_splat(&example()[..63]) && !is_splat(&[0; 64]));
        let noise: Vec<u8> = (0..32 * 50u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
        assert!(!is_splat(&noise));
        let mut long = example();
        long[31] = 0;
        assert!(!is_splat(&long[..32]), "its quaternion is no unit");
    }
}
