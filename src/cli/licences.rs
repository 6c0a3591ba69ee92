//! `relume licences`: the licences of the program and of the packages in it.

use std::io::Write;

use crate::cli::error::CommandResult;

/// The licences of the packages, with their texts. Empty if the build did not name their file.
const PACKAGES: &str = include_str!(concat!(env!("OUT_DIR"), "/licences.txt"));

/// Prints the licences.
pub(super) fn run() -> CommandResult {
    if PACKAGES.is_empty() {
        return Err("this build does not contain the licences of its packages; build it with RELUME_LICENCES=FILE, where \
                    `.ci/licences FILE` writes the file"
            .into());
    }
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "Relume is licensed under the Apache License, Version 2.0, or the MIT licence, as you choose.\n"
    )?;
    out.write_all(PACKAGES.as_bytes())?;
    Ok(())
}
