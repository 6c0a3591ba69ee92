//! Vertices of PLY files as a table of numbers. Supports ASCII and binary little-endian files without lists in
//! vertices.

/// Errors of reading PLY files.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {reason}")]
pub struct PlyError {
    /// The header line, property or vertex at fault.
    pub field: String,
    /// The reason.
    pub reason: String,
}

pub(super) fn bad<T>(field: impl Into<String>, reason: impl Into<String>) -> Result<T, PlyError> {
    Err(PlyError { field: field.into(), reason: reason.into() })
}

/// Longest accepted header, bytes.
const MAX_HEADER: usize = 1 << 16;

/// A scalar type of PLY.
#[derive(Clone, Copy)]
struct Scalar {
    /// The type's two names.
    names: [&'static str; 2],
    /// Bytes in a binary file.
    size: usize,
    /// The value of full brightness in a colour.
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

/// The vertices of a file.
pub(super) struct PlyTable {
    properties: Vec<(String, Scalar)>,
    /// Complete header lines that begin with `comment `.
    pub(super) comments: Vec<String>,
    /// Values of all properties, vertex by vertex.
    numbers: Vec<f64>,
}

impl PlyTable {
    /// Reads the vertices of a file.
    ///
    /// # Errors
    /// Names the header line or vertex at fault. More than `most` vertices, or more than a binary file's length allows, are
    /// refused before memory is allocated for them.
    pub(super) fn read(bytes: &[u8], most: usize) -> Result<Self, PlyError> {
        let header = header(bytes)?;
        if header.vertices > most {
            return bad("element vertex", format!("{} points, {most} allowed", header.vertices));
        }
        let body = &bytes[header.length..];
        let numbers = if header.binary { binary_rows(body, &header)? } else { ascii_rows(body, &header)? };
        Ok(Self { properties: header.properties, comments: header.comments, numbers })
    }

    /// Index of property `name` in a row.
    pub(super) fn column(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|(n, _)| n == name)
    }

    /// The value of full brightness in a colour of this column.
    pub(super) fn white(&self, column: usize) -> f64 {
        self.properties[column].1.white
    }

    /// The numbers of each vertex.
    pub(super) fn rows(&self) -> std::slice::ChunksExact<'_, f64> {
        self.numbers.chunks_exact(self.properties.len())
    }
}

struct PlyHeader {
    binary: bool,
    vertices: usize,
    properties: Vec<(String, Scalar)>,
    comments: Vec<String>,
    /// Length of the header in bytes, including its last newline.
    length: usize,
}

fn header(bytes: &[u8]) -> Result<PlyHeader, PlyError> {
    let window = &bytes[..bytes.len().min(MAX_HEADER)];
    const END: &[u8] = b"end_header";
    let end = window.windows(END.len()).position(|w| w == END);
    let (true, Some(end)) = (bytes.starts_with(b"ply"), end) else {
        return bad("header", "this is not a PLY file");
    };
    let newline = window[end..].iter().position(|&b| b == b'\n');
    let Some(newline) = newline else { return bad("header", "is truncated") };
    let text = String::from_utf8_lossy(&window[..end]);
    let mut out = PlyHeader {
        binary: false,
        vertices: 0,
        properties: Vec::new(),
        comments: Vec::new(),
        length: end + newline + 1,
    };
    let (mut format_seen, mut element) = (false, None);
    for line in text.lines().skip(1) {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["comment", ..] => out.comments.push(line.to_owned()),
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
                        return bad("element vertex", format!("{count:?} is not a count"));
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
                    None => return bad(format!("property {name}"), format!("{kind} is not a PLY type")),
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
        return bad("element vertex", format!("{} points are more than the file contains", header.vertices));
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
    let Ok(text) = std::str::from_utf8(body) else { return bad("body", "is not UTF-8 text") };
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
