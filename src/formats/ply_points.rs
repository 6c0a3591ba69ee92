//! Point clouds from PLY files: ASCII and binary little-endian, positions and optional colours.

use glam::DVec3;

use crate::formats::srgb;

/// Why a PLY file was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {reason}")]
pub struct PlyError {
    /// The header line, property or vertex at fault.
    pub field: String,
    /// What is wrong.
    pub reason: String,
}

fn bad<T>(field: impl Into<String>, reason: impl Into<String>) -> Result<T, PlyError> {
    Err(PlyError { field: field.into(), reason: reason.into() })
}

/// A position and a linear Rec.709 colour; 0.5 in files without colours.
pub type Point = (DVec3, [f32; 3]);

/// Longest accepted header, bytes.
const MAX_HEADER: usize = 1 << 16;

/// A scalar type of PLY.
#[derive(Clone, Copy)]
struct Scalar {
    /// Its two names.
    names: [&'static str; 2],
    /// Bytes in a binary file.
    size: usize,
    /// The value that means full brightness in a colour.
    white: f64,
    /// The value in the first `size` bytes, little-endian.
    read: fn(&[u8]) -> Option<f64>,
}

macro_rules! scalar {
    ($short:literal, $long:literal, $type:ty, $white:literal) => {
        Scalar {
            names: [$short, $long],
            size: size_of::<$type>(),
            white: $white,
            read: |bytes| bytes.first_chunk().map(|b| f64::from(<$type>::from_le_bytes(*b))),
        }
    };
}

const SCALARS: [Scalar; 8] = [
    scalar!("char", "int8", i8, 255.0),
    scalar!("uchar", "uint8", u8, 255.0),
    scalar!("short", "int16", i16, 255.0),
    scalar!("ushort", "uint16", u16, 255.0),
    scalar!("int", "int32", i32, 255.0),
    scalar!("uint", "uint32", u32, 255.0),
    scalar!("float", "float32", f32, 1.0),
    scalar!("double", "float64", f64, 1.0),
];

struct PlyHeader {
    binary: bool,
    vertices: usize,
    properties: Vec<(String, Scalar)>,
    /// Bytes of the header, its last newline included.
    length: usize,
}

/// Reads the vertices of a PLY file; colours are taken as sRGB.
///
/// # Errors
/// Names the header line or vertex at fault. More than `max_points`, or more than a binary file's length allows,
/// is refused before memory is allocated for them.
pub fn read_points(bytes: &[u8], max_points: usize) -> Result<Vec<Point>, PlyError> {
    let header = header(bytes)?;
    if header.vertices > max_points {
        return bad("element vertex", format!("{} points, {max_points} allowed", header.vertices));
    }
    let column = |name: &str| header.properties.iter().position(|(n, _)| n == name);
    let (Some(x), Some(y), Some(z)) = (column("x"), column("y"), column("z")) else {
        return bad("property", "x, y and z must be there");
    };
    let colour = match (column("red"), column("green"), column("blue")) {
        (Some(r), Some(g), Some(b)) => Some([r, g, b]),
        _ => None,
    };
    let body = &bytes[header.length..];
    let rows = if header.binary { binary_rows(body, &header)? } else { ascii_rows(body, &header)? };
    let mut points = Vec::with_capacity(header.vertices);
    for (i, row) in rows.chunks_exact(header.properties.len()).enumerate() {
        let position = DVec3::new(row[x], row[y], row[z]);
        if !position.is_finite() {
            return bad(format!("vertex {i}"), "has a position that is not finite");
        }
        let channel = |c: usize| srgb::decode((row[c] / header.properties[c].1.white) as f32);
        points.push((position, colour.map_or([0.5; 3], |c| c.map(channel))));
    }
    Ok(points)
}

fn header(bytes: &[u8]) -> Result<PlyHeader, PlyError> {
    let window = &bytes[..bytes.len().min(MAX_HEADER)];
    const END: &[u8] = b"end_header";
    let end = window.windows(END.len()).position(|w| w == END);
    let (true, Some(end)) = (bytes.starts_with(b"ply"), end) else {
        return bad("header", "this is no PLY file");
    };
    let newline = window[end..].iter().position(|&b| b == b'\n');
    let Some(newline) = newline else { return bad("header", "is cut short") };
    let text = String::from_utf8_lossy(&window[..end]);
    let mut out = PlyHeader { binary: false, vertices: 0, properties: Vec::new(), length: end + newline + 1 };
    let (mut format_seen, mut element) = (false, None);
    for line in text.lines().skip(1) {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["format", "ascii", _] => format_seen = true,
            ["format", "binary_little_endian", _] => (format_seen, out.binary) = (true, true),
            ["format", other, ..] => return bad("format", format!("{other} is not supported")),
            ["element", name, count] => {
                if name != "vertex" && element.is_none() {
                    return bad("element", format!("{name} comes before vertex, which is not supported"));
                }
                element = Some(name == "vertex");
                if name == "vertex" {
                    let Ok(vertices) = count.parse() else {
                        return bad("element vertex", format!("{count:?} is no count"));
                    };
                    out.vertices = vertices;
                }
            }
            ["property", "list", ..] if element == Some(true) => {
                return bad("property list", "is not supported in vertices");
            }
            ["property", kind, name] if element == Some(true) => {
                match SCALARS.iter().find(|s| s.names.contains(&kind)) {
                    Some(scalar) => out.properties.push((name.to_owned(), *scalar)),
                    None => return bad(format!("property {name}"), format!("{kind} is no type")),
                }
            }
            _ => {}
        }
    }
    if !format_seen || out.properties.is_empty() {
        return bad("header", "has no format or no vertex properties");
    }
    Ok(out)
}

fn binary_rows(body: &[u8], header: &PlyHeader) -> Result<Vec<f64>, PlyError> {
    let stride: usize = header.properties.iter().map(|(_, s)| s.size).sum();
    if header.vertices.checked_mul(stride).is_none_or(|need| need > body.len()) {
        return bad("element vertex", format!("{} points are more than the file holds", header.vertices));
    }
    let mut out = Vec::with_capacity(header.vertices * header.properties.len());
    for row in body.chunks_exact(stride).take(header.vertices) {
        let mut at = 0;
        for (_, scalar) in &header.properties {
            out.extend((scalar.read)(&row[at..]));
            at += scalar.size;
        }
    }
    Ok(out)
}

fn ascii_rows(body: &[u8], header: &PlyHeader) -> Result<Vec<f64>, PlyError> {
    let Ok(text) = std::str::from_utf8(body) else { return bad("body", "is not text") };
    let mut out = Vec::new();
    let mut lines = text.lines().filter(|l| !l.trim().is_empty());
    for i in 0..header.vertices {
        let Some(line) = lines.next() else {
            return bad("element vertex", format!("{} points stated, {i} found", header.vertices));
        };
        let before = out.len();
        out.extend(
            line.split_whitespace().map_while(|w| w.parse::<f64>().ok()).take(header.properties.len()),
        );
        if out.len() - before != header.properties.len() {
            return bad(format!("vertex {i}"), "does not have a number for every property");
        }
    }
    Ok(out)
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
    fn ascii_and_binary_say_the_same() {
        let points = read_points(ASCII.as_bytes(), 10).unwrap();
        assert_eq!(points, read_points(&binary(), 10).unwrap());
        assert_eq!(points[1].0, DVec3::new(-1.0, 0.5, 100.0));
        assert_eq!((points[0].1[0], points[0].1[1]), (1.0, 0.0));
        assert!((points[0].1[2] - 0.2158).abs() < 1e-3);
    }

    #[test]
    fn counts_that_lie_are_refused_before_they_cost_anything() {
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
    fn broken_headers_and_values_are_named() {
        for (from, to, field) in [
            ("ply", "plx", "header"),
            ("property float z\n", "", "property"),
            ("format ascii", "format binary_big_endian", "format"),
            ("float z", "list uchar int z", "property list"),
            ("float z", "quad z", "property z"),
            ("-1 0.5 1e2", "-1 nan 1e2", "vertex 1"),
            ("-1 0.5 1e2 0 0 0", "-1 0.5", "vertex 1"),
            ("element vertex", "element face 3\nelement vertex", "element"),
        ] {
            let error = read_points(ASCII.replace(from, to).as_bytes(), 10).unwrap_err();
            assert_eq!(error.field, field, "{from} -> {to}: {error}");
        }
    }
}
