//! The API key that commands send to a server.

use std::path::Path;

use crate::cli::error::CommandResult;

/// The key: the first line of `file`, or the environment variable.
pub(super) fn key(file: Option<&Path>) -> CommandResult<Option<String>> {
    let Some(file) = file else {
        return Ok(std::env::var("RELUME_API_KEY").ok().filter(|key| !key.is_empty()));
    };
    let text = std::fs::read_to_string(file).map_err(|e| format!("--key-file {}: {e}", file.display()))?;
    let key = text.lines().map(str::trim).find(|line| !line.is_empty());
    Ok(Some(key.ok_or_else(|| format!("--key-file {}: the file is empty", file.display()))?.to_owned()))
}
