//! Options for API keys.

use std::path::{Path, PathBuf};

use crate::cli::CommandResult;
use crate::server::ApiKeys;

/// Options for API keys.
#[derive(Debug, clap::Args)]
pub(super) struct KeyArgs {
    /// API keys with all scopes in the tenant `default`, in addition to those of `relume keys`, separated by commas. Clients send
    /// a key as `Authorization: Bearer KEY`. Prefer the variable or a file, because other users of this machine can read the
    /// command line.
    #[arg(
        long = "api-key",
        env = "RELUME_API_KEYS",
        hide_env_values = true,
        value_delimiter = ',',
        value_parser = api_key
    )]
    api_keys: Vec<String>,
    /// A file with additional API keys, one per line. The server reads it at start and ignores empty lines and lines that begin
    /// with #.
    #[arg(long, env = "RELUME_API_KEY_FILE", value_name = "FILE")]
    api_key_file: Option<PathBuf>,
}

impl KeyArgs {
    /// The keys from the options and the file.
    pub(super) fn configured(self) -> CommandResult<ApiKeys> {
        let mut keys = self.api_keys;
        if let Some(path) = &self.api_key_file {
            keys.extend(read(path)?);
        }
        Ok(ApiKeys::new(keys))
    }
}

fn read(path: &Path) -> CommandResult<Vec<String>> {
    let text = std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    let mut keys = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        if !line.trim().is_empty() && !line.trim_start().starts_with('#') {
            keys.push(api_key(line).map_err(|e| format!("{}, line {number}: {e}", path.display()))?);
        }
    }
    if keys.is_empty() { Err(format!("{}: contains no key", path.display()).into()) } else { Ok(keys) }
}

/// Parses a key and refuses keys that are short enough to be guessed.
fn api_key(text: &str) -> Result<String, String> {
    let key = text.trim();
    if key.len() < 16 { Err("a key must have at least 16 characters".to_owned()) } else { Ok(key.to_owned()) }
}
