//! Point clouds from PLY files: positions and optional colours.

use glam::DVec3;

pub use crate::formats::ply_table::PlyError;
use crate::formats::ply_table::{PlyTable, bad};
use relume_scene::srgb;

/// A position and a linear Rec.709 colour; 0.5 in files without colours.
pub type Point = (DVec3, [f32; 3]);

/// Reads the vertices of a PLY file. Colours are taken as sRGB.
///
/// # Errors
/// Names the header line or vertex at fault. More than `max_points`, or more than a binary file's length allows,
/// is refused before memory is allocated for them.
pub fn read_points(bytes: &[u8], max_points: usize) -> Result<Vec<Point>, PlyError> {
    let table = PlyTable::read(bytes, max_points)?;
    let column = |name: &str| table.column(name);
    let (Some(x), Some(y), Some(z)) = (column("x"), column("y"), column("z")) else {
        return bad("property", "x, y and z are required");
    };
    let colour = match (column("red"), column("green"), column("blue")) {
        (Some(r), Some(g), Some(b)) => Some([r, g, b]),
        _ => None,
    };
    let mut points = Vec::with_capacity(table.rows().len());
    for (i, row) in table.rows().enumerate() {
        let position = DVec3::new(row[x], row[y], row[z]);
        if !position.is_finite() {
            return bad(format!("vertex {i}"), "has a position that is not finite");
        }
        let channel = |c: usize| srgb::decode((row[c] / table.white(c)) as f32);
        points.push((position, colour.map_or([0.5; 3], |c| c.map(channel))));
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ASCII: &str = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 2\nproperty float x\n\
        property float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
        end_header\n1 2 3 255 0 128\n-1 0.5 1e2 0 0 0\n";

    fn binary() -> Vec<u8> {
        let mut out =
            b"ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty double x\nproperty double y\n\
            property double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
                .to_vec();
        for (p, c) in [([1.0f64, 2.0, 3.0], [255u8, 0, 128]), ([-1.0, 0.5, 1e2], [0, 0, 0])] {
            p.iter().for_each(|v| out.extend(v.to_le_bytes()));
            out.extend(c);
        }
        out
    }

    #[test]
    fn big_endian_files_and_earlier_elements_are_read() {
        let mut big =
            b"ply\nformat binary_big_endian 1.0\nelement camera 2\nproperty int i\nelement vertex 1\n\
            property float x\nproperty double y\nproperty short z\nend_header\n"
                .to_vec();
        big.extend([9; 8]);
        big.extend([&1.5f32.to_be_bytes()[..], &(-2.5f64).to_be_bytes(), &300i16.to_be_bytes()].concat());
        assert_eq!(read_points(&big, 10).unwrap()[0].0, DVec3::new(1.5, -2.5, 300.0));
        let earlier = ASCII.replace("element vertex", "element camera 1\nproperty int i\nelement vertex");
        let earlier = earlier.replace("end_header\n", "end_header\n7\n");
        assert_eq!(read_points(earlier.as_bytes(), 10), read_points(ASCII.as_bytes(), 10));
    }

    #[test]
    fn ascii_and_binary_files_give_equal_points() {
        let points = read_points(ASCII.as_bytes(), 10).unwrap();
        assert_eq!(points, read_points(&binary(), 10).unwrap());
        assert_eq!(points[1].0, DVec3::new(-1.0, 0.5, 100.0));
        assert_eq!((points[0].1[0], points[0].1[1]), (1.0, 0.0));
        assert!((points[0].1[2] - 0.2158).abs() < 1e-3);
    }

    #[test]
    fn wrong_counts_in_headers_are_refused_without_allocation() {
        for count in ["99999999999", "3", "-1", "x"] {
            let text = ASCII.replace("vertex 2", &format!("vertex {count}"));
            assert!(read_points(text.as_bytes(), usize::MAX).is_err(), "{count}");
            let mut bytes = binary();
            let at = bytes.windows(8).position(|w| w == b"vertex 2").unwrap();
            bytes.splice(at..at + 8, format!("vertex {count}").bytes());
            assert!(read_points(&bytes, usize::MAX).is_err(), "{count}");
        }
        assert_eq!(read_points(ASCII.as_bytes(), 1).unwrap_err().field, "element vertex");
    }

    #[test]
    fn invalid_headers_and_values_are_refused_by_field() {
        for (from, to, field) in [
            ("ply", "plx", "header"),
            ("property float z\n", "", "property"),
            ("format ascii", "format binary_middle_endian", "format"),
            ("float z", "list uchar int z", "property list"),
            ("float z", "quad z", "property z"),
            ("-1 0.5 1e2", "-1 nan 1e2", "vertex 1"),
            ("-1 0.5 1e2 0 0 0", "-1 0.5", "vertex 1"),
            ("element vertex", "element face 3\nproperty list uchar int i\nelement vertex", "element"),
        ] {
            let error = read_points(ASCII.replace(from, to).as_bytes(), 10).unwrap_err();
            assert_eq!(error.field, field, "{from} -> {to}: {error}");
        }
    }
}
