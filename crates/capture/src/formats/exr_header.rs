//! Order of the attributes in the headers of an OpenEXR file.

/// Sorts the attributes of each header by name. The `exr` crate writes them in the order of a hash map, which differs
/// from run to run. Only attributes move, within their header. Bytes that are not an OpenEXR file stay unchanged. Returns the position
/// after the last complete header, and after the end of the list of headers if that is there.
pub(super) fn sort_attributes(file: &mut [u8]) -> usize {
    /// Magic number and version.
    const START: usize = 8;
    /// Bit of the version for several parts, each with a header.
    const MULTI_PART: u8 = 0x10;
    let Some(&flags) = file.get(5) else { return 0 };
    let mut at = START;
    loop {
        let Some(attributes) = attributes(file, at) else { return at };
        let end = attributes.last().map_or(at, |last| last.1);
        let mut sorted: Vec<&[u8]> = attributes.iter().map(|&(start, end)| &file[start..end]).collect();
        sorted.sort_unstable();
        let sorted = sorted.concat();
        file[at..end].copy_from_slice(&sorted);
        // A header ends with an empty name, and the list of headers with another.
        at = end + 1;
        match file.get(at) {
            _ if flags & MULTI_PART == 0 => return at,
            Some(0) => return at + 1,
            Some(_) => {}
            None => return at,
        }
    }
}

/// Start and end of each attribute of the header at `at`; `None` if the header is truncated.
fn attributes(file: &[u8], mut at: usize) -> Option<Vec<(usize, usize)>> {
    let mut found = Vec::new();
    while *file.get(at)? != 0 {
        let after_name = after_text(file, at)?;
        let size_at = after_text(file, after_name)?;
        let size = u32::from_le_bytes(*file.get(size_at..)?.first_chunk()?);
        let end = size_at.checked_add(4)?.checked_add(usize::try_from(size).ok()?)?;
        file.get(..end)?;
        found.push((at, end));
        at = end;
    }
    Some(found)
}

/// The position after the zero-terminated text at `at`.
fn after_text(file: &[u8], at: usize) -> Option<usize> {
    Some(at + file.get(at..)?.iter().position(|byte| *byte == 0)? + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attribute(name: &str, value: &[u8]) -> Vec<u8> {
        [name.as_bytes(), b"\0string\0", &(value.len() as u32).to_le_bytes(), value].concat()
    }

    fn file(version: u8, headers: &[&[&str]]) -> Vec<u8> {
        let mut out = vec![0x76, 0x2f, 0x31, 0x01, 2, version, 0, 0];
        for header in headers {
            header.iter().for_each(|name| out.extend(attribute(name, &[0, 7])));
            out.push(0);
        }
        out.extend(b"\0pixels");
        out
    }

    #[test]
    fn attributes_are_sorted_within_their_header() {
        let mut two = file(0x10, &[&["b", "a", "c"], &["z", "y"]]);
        assert_eq!(sort_attributes(&mut two), two.len() - b"pixels".len());
        assert_eq!(two, file(0x10, &[&["a", "b", "c"], &["y", "z"]]));
        let mut one = file(0, &[&["b", "a"]]);
        assert_eq!(sort_attributes(&mut one), one.len() - b"\0pixels".len());
        assert_eq!(one, file(0, &[&["a", "b"]]));
    }

    #[test]
    fn truncated_headers_are_left_unchanged() {
        let whole = file(0x10, &[&["b", "a"], &["d", "c"]]);
        for length in 0..20 {
            let mut cut = whole[..length].to_vec();
            sort_attributes(&mut cut);
            assert_eq!(cut, whole[..length], "{length}");
        }
    }
}
