//! Lights as they are named on the command line.

use crate::capture::{BUILTIN, builtin};
use crate::formats::environment;
use crate::scene::EnvMap;

/// A built-in map or the contents of a `.hdr` or `.exr` file; `others` says what else could have been named.
pub(super) fn named_light(name: &str, others: &str) -> Result<EnvMap, String> {
    if let Some(map) = builtin(name) {
        return Ok(map);
    }
    let bytes = std::fs::read(name).map_err(|error| {
        format!("{name}: {error}; expected a file, {others}or one of {}", BUILTIN.join(", "))
    })?;
    let loaded = environment::decode(&bytes).map_err(|error| format!("{name}: {error}"))?;
    for warning in &loaded.warnings {
        eprintln!("warning: {name}: {warning}");
    }
    Ok(loaded.map)
}
