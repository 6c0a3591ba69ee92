//! PLY files as tables of numbers: one table for each element, e.g. `vertex`. Supports ASCII and binary files of both
//! byte orders. Elements with lists can only follow the elements that are read.

use crate::formats::recognise_foreign;

/// Errors of reading PLY files and other files of splats.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {reason}")]
pub struct PlyError {
    /// The header line, property, vertex or part of the file at fault.
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
    /// The value in the first `size` bytes, big-endian.
    read_big: fn(&[u8]) -> Option<f64>,
}

macro_rules! scalar {
    ($short:literal, $long:literal, $type:ty, $white:literal) => {
        Scalar {
            names: [$short, $long],
            size: size_of::<$type>(),
            white: $white,
            read: |bytes| bytes.first_chunk().map(|b| f64::from(<$type>::from_le_bytes(*b))),
            read_big: |bytes| bytes.first_chunk().map(|b| f64::from(<$type>::from_be_bytes(*b))),
        }
    };
}

const FLOAT: Scalar = scalar!("float", "float32", f32, 1.0);
const SCALARS: [Scalar; 8] = [
    scalar!("char", "int8", i8, 255.0),
    scalar!("uchar", "uint8", u8, 255.0),
    scalar!("short", "int16", i16, 255.0),
    scalar!("ushort", "uint16", u16, 255.0),
    scalar!("int", "int32", i32, 255.0),
    scalar!("uint", "uint32", u32, 255.0),
    FLOAT,
    scalar!("double", "float64", f64, 1.0),
];

/// The rows of an element.
pub(super) struct PlyTable {
    properties: Vec<(String, Scalar)>,
    /// Complete header lines that begin with `comment `.
    pub(super) comments: Vec<String>,
    /// Values of all properties, row by row.
    numbers: Vec<f64>,
}

impl PlyTable {
    /// Reads the vertices of a file.
    ///
    /// # Errors
    /// Names the header line or vertex at fault. More than `most` vertices, or more than a binary file's length allows, are
    /// refused before memory is allocated for them.
    pub(super) fn read(bytes: &[u8], most: usize) -> Result<Self, PlyError> {
        PlyFile::parse(bytes)?.table("vertex", most)
    }

    /// A table of floats that another format contains. `numbers` has a value for each name in each row.
    pub(super) fn of_floats(names: Vec<String>, comments: Vec<String>, numbers: Vec<f64>) -> Self {
        let properties = names.into_iter().map(|name| (name, FLOAT)).collect();
        Self { properties, comments, numbers }
    }

    /// Index of property `name` in a row.
    pub(super) fn column(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|(n, _)| n == name)
    }

    /// Names of the properties, in order.
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.properties.iter().map(|(name, _)| name.as_str())
    }

    /// The value of full brightness in a colour of this column.
    pub(super) fn white(&self, column: usize) -> f64 {
        self.properties[column].1.white
    }

    /// The numbers of each row.
    pub(super) fn rows(&self) -> std::slice::ChunksExact<'_, f64> {
        self.numbers.chunks_exact(self.properties.len())
    }
}

/// How the numbers of a file are written.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

struct PlyElement {
    name: String,
    count: usize,
    properties: Vec<(String, Scalar)>,
    /// True if a property is a list, so that the length of a row is unknown.
    has_lists: bool,
}

impl PlyElement {
    /// Bytes of a row in a binary file.
    fn stride(&self) -> usize {
        self.properties.iter().map(|(_, scalar)| scalar.size).sum()
    }
}

/// A file with its header.
pub(super) struct PlyFile<'a> {
    encoding: Encoding,
    elements: Vec<PlyElement>,
    comments: Vec<String>,
    body: &'a [u8],
}

impl<'a> PlyFile<'a> {
    /// Reads the header.
    ///
    /// # Errors
    /// Names the header line at fault.
    pub(super) fn parse(bytes: &'a [u8]) -> Result<Self, PlyError> {
        let window = &bytes[..bytes.len().min(MAX_HEADER)];
        const END: &[u8] = b"end_header";
        let end = window.windows(END.len()).position(|w| w == END);
        let (true, Some(end)) = (bytes.starts_with(b"ply"), end) else {
            return bad("header", recognise_foreign(bytes).unwrap_or("this is not a PLY file"));
        };
        let newline = window[end..].iter().position(|&b| b == b'\n');
        let Some(newline) = newline else { return bad("header", "is truncated") };
        let text = String::from_utf8_lossy(&window[..end]);
        let mut encoding = None;
        let (mut elements, mut comments): (Vec<PlyElement>, Vec<String>) = (Vec::new(), Vec::new());
        for line in text.lines().skip(1) {
            let words: Vec<&str> = line.split_whitespace().collect();
            match (&words[..], elements.last_mut()) {
                (["comment", ..], _) => comments.push(line.to_owned()),
                (["format", name, ..], _) => encoding = Some(format(name)?),
                (["element", name, count], _) => elements.push(element(name, count)?),
                (["property", ..], Some(element)) => read_property(&words[1..], element)?,
                _ => {}
            }
        }
        let has_vertices = elements.iter().any(|e| e.name == "vertex" && !e.properties.is_empty());
        match encoding {
            Some(encoding) if has_vertices => {
                Ok(Self { encoding, elements, comments, body: &bytes[end + newline + 1..] })
            }
            _ => bad("header", "has no format or no vertex properties"),
        }
    }

    /// True if the header names an element.
    pub(super) fn has(&self, element: &str) -> bool {
        self.elements.iter().any(|e| e.name == element)
    }

    /// True if an element has a property.
    pub(super) fn has_property(&self, element: &str, property: &str) -> bool {
        let properties = self.elements.iter().filter(|e| e.name == element).flat_map(|e| &e.properties);
        properties.into_iter().any(|(name, _)| name == property)
    }

    /// The header lines that begin with `comment `.
    pub(super) fn comments(&self) -> &[String] {
        &self.comments
    }

    /// Reads the rows of an element.
    ///
    /// # Errors
    /// Names the header line or row at fault. More than `most` rows, or more than a binary file's length allows, are
    /// refused before memory is allocated for them.
    pub(super) fn table(&self, name: &str, most: usize) -> Result<PlyTable, PlyError> {
        let Some(at) = self.elements.iter().position(|e| e.name == name) else {
            return bad(format!("element {name}"), "is missing");
        };
        let (before, element) = (&self.elements[..at], &self.elements[at]);
        if let Some(list) = before.iter().find(|e| e.has_lists) {
            return bad(
                "element",
                format!("{} with lists comes before {name}, which is not supported", list.name),
            );
        }
        if element.properties.is_empty() && !element.has_lists {
            return bad(format!("element {name}"), "has no properties");
        }
        if element.has_lists {
            return bad("property list", format!("is not supported in element {name}"));
        }
        if element.count > most {
            return bad(format!("element {name}"), format!("{} points, {most} allowed", element.count));
        }
        let numbers = match self.encoding {
            Encoding::Ascii => self.ascii_rows(before, element)?,
            encoding => self.binary_rows(before, element, encoding == Encoding::BigEndian)?,
        };
        Ok(PlyTable { properties: element.properties.clone(), comments: self.comments.clone(), numbers })
    }

    fn binary_rows(
        &self,
        before: &[PlyElement],
        element: &PlyElement,
        is_big: bool,
    ) -> Result<Vec<f64>, PlyError> {
        let bytes = |e: &PlyElement| e.count.checked_mul(e.stride());
        let start = before.iter().try_fold(0usize, |sum, e| sum.checked_add(bytes(e)?));
        let body = start.and_then(|start| self.body.get(start..)).unwrap_or_default();
        if bytes(element).is_none_or(|need| need > body.len()) {
            let reason = format!("{} points are more than the file contains", element.count);
            return bad(format!("element {}", element.name), reason);
        }
        let mut out = Vec::with_capacity(element.count * element.properties.len());
        for row in body.chunks_exact(element.stride().max(1)).take(element.count) {
            let mut at = 0;
            for (_, scalar) in &element.properties {
                let read = if is_big { scalar.read_big } else { scalar.read };
                out.extend(read(&row[at..]));
                at += scalar.size;
            }
        }
        Ok(out)
    }

    fn ascii_rows(&self, before: &[PlyElement], element: &PlyElement) -> Result<Vec<f64>, PlyError> {
        let Ok(text) = std::str::from_utf8(self.body) else { return bad("body", "is not UTF-8 text") };
        let skipped = before.iter().fold(0usize, |sum, e| sum.saturating_add(e.count));
        let mut lines = text.lines().filter(|l| !l.trim().is_empty()).skip(skipped);
        let mut out = Vec::new();
        for i in 0..element.count {
            let Some(line) = lines.next() else {
                let reason = format!("{} points stated, {i} found", element.count);
                return bad(format!("element {}", element.name), reason);
            };
            let before = out.len();
            let numbers = line.split_whitespace().map_while(|w| w.parse::<f64>().ok());
            out.extend(numbers.take(element.properties.len()));
            if out.len() - before != element.properties.len() {
                return bad(format!("{} {i}", element.name), "does not have a number for every property");
            }
        }
        Ok(out)
    }
}

fn format(name: &str) -> Result<Encoding, PlyError> {
    match name {
        "ascii" => Ok(Encoding::Ascii),
        "binary_little_endian" => Ok(Encoding::LittleEndian),
        "binary_big_endian" => Ok(Encoding::BigEndian),
        other => bad("format", format!("{other} is not supported")),
    }
}

fn element(name: &str, count: &str) -> Result<PlyElement, PlyError> {
    match count.parse() {
        Ok(count) => {
            Ok(PlyElement { name: name.to_owned(), count, properties: Vec::new(), has_lists: false })
        }
        Err(_) => bad(format!("element {name}"), format!("{count:?} is not a count")),
    }
}

/// Reads the words after `property`.
fn read_property(words: &[&str], element: &mut PlyElement) -> Result<(), PlyError> {
    match words {
        ["list", ..] => element.has_lists = true,
        [kind, name] => match SCALARS.iter().find(|s| s.names.contains(kind)) {
            Some(scalar) => element.properties.push(((*name).to_owned(), *scalar)),
            None => return bad(format!("property {name}"), format!("{kind} is not a PLY type")),
        },
        _ => {}
    }
    Ok(())
}
