//! Sizes on the command line.

/// Parses bytes, or a number with a unit.
pub(super) fn size(text: &str) -> Result<u64, String> {
    let text = text.trim();
    let units = [("KiB", 10), ("MiB", 20), ("GiB", 30), ("TiB", 40), ("", 0)];
    let read = units.iter().find_map(|(unit, shift)| {
        let number: u64 = text.strip_suffix(unit)?.trim().parse().ok()?;
        number.checked_mul(1 << shift).filter(|bytes| *bytes > 0)
    });
    read.ok_or_else(|| "must be bytes, or a whole number with KiB, MiB, GiB or TiB, above 0".to_owned())
}
