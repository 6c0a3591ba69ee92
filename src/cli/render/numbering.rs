//! File names of a sequence.

use std::path::{Path, PathBuf};

/// A file name with a placeholder for the frame number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Numbering {
    before: String,
    after: String,
    /// Minimum number of digits.
    width: usize,
    first: u32,
}

impl Numbering {
    /// The requirement on the file name of a sequence.
    pub(super) const WANTED: &str = "the file name of a sequence must contain one placeholder for the frame number: %d, or %04d for at least four digits";

    /// The numbering of `out`, which must contain one `%d` or `%0Nd`. `first` is the number of the first frame.
    ///
    /// # Errors
    /// The error names the path.
    pub(super) fn of(out: &Path, first: u32) -> Result<Self, String> {
        let refused = || format!("{}: {}", out.display(), Self::WANTED);
        let text = out.to_str().ok_or_else(|| format!("{}: is not Unicode", out.display()))?;
        let (before, rest) = text.split_once('%').ok_or_else(refused)?;
        let (width, after) = rest.split_once('d').ok_or_else(refused)?;
        let width = match width {
            "" => Some(1),
            digits if digits.starts_with('0') => digits.parse().ok().filter(|n| (1..=9).contains(n)),
            _ => None,
        };
        let width = width.filter(|_| !after.contains('%')).ok_or_else(refused)?;
        Ok(Self { before: before.to_owned(), after: after.to_owned(), width, first })
    }

    /// The number of the frame with index `index`, from 0.
    pub(super) fn number(&self, index: usize) -> u64 {
        u64::from(self.first) + index as u64
    }

    /// The file of the frame with index `index`, from 0.
    pub(super) fn file(&self, index: usize) -> PathBuf {
        let Self { before, after, width, .. } = self;
        let number = self.number(index);
        PathBuf::from(format!("{before}{number:0width$}{after}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_files_are_numbered_by_a_printf_pattern() {
        let file = |pattern: &str, first, index| {
            Numbering::of(Path::new(pattern), first).map(|n| n.file(index).display().to_string())
        };
        assert_eq!(file("out/%04d.exr", 1001, 0).unwrap(), "out/1001.exr");
        assert_eq!(file("a.%04d.png", 1, 9).unwrap(), "a.0010.png");
        assert_eq!(file("%02d.png", 99, 1).unwrap(), "100.png", "more digits than requested");
        assert_eq!(file("%d.jpg", 0, 7).unwrap(), "7.jpg");
        for wrong in ["frame.png", "%s.png", "%04.png", "%4d.png", "%0d.png", "%04d_%04d.png", "%010d.png"] {
            assert!(file(wrong, 1, 0).unwrap_err().contains("%04d"), "{wrong}");
        }
    }
}
