//! Markdown reports of the bench commands.

use std::fmt::Display;
use std::path::Path;

use crate::cli::output;
use relume_engine::Device;

/// A table row with its newline.
pub(super) fn row<T: Display>(cells: impl IntoIterator<Item = T>) -> String {
    cells.into_iter().fold("|".to_owned(), |row, cell| format!("{row} {cell} |")) + "\n"
}

/// A table header: `text` columns, left-aligned, then `numbers` columns, right-aligned.
pub(super) fn head<T: Display>(text: &[&str], numbers: impl IntoIterator<Item = T>) -> String {
    let numbers: Vec<String> = numbers.into_iter().map(|name| name.to_string()).collect();
    let names = row(text.iter().map(|name| (*name).to_owned()).chain(numbers.iter().cloned()));
    format!("{names}|{}{}\n", "---|".repeat(text.len()), "---:|".repeat(numbers.len()))
}

/// The device and the host, for the line above a table.
pub(super) fn machine(device: &Device) -> String {
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    format!("Device: {}; host with {threads} threads", device.name())
}

/// Prints a report and writes it to `out`, if given.
pub(super) fn publish(report: &str, out: Option<&Path>) -> Result<(), String> {
    println!("{report}");
    out.map_or(Ok(()), |path| output::write_named(path, report.as_bytes()))
}
