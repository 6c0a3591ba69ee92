//! Options about API keys.

use std::path::{Path, PathBuf};

use crate::cli::CommandResult;
use crate::server::ApiKeys;

/// Options about API keys.
#[derive(Debug, clap::Args)]
pub(super) struct KeyArgs {
    /// Keys that may do everything in the tenant `default`, beside those of `relume keys`; several with commas, sent as
    /// `Authorization: Bearer KEY`. Others on this machine see a command line: prefer the variable or a file.
    #[arg(
        long = "api-key",
        env = "RELUME_API_KEYS",
        hide_env_values = true,
        value_delimiter = ',',
        value_parser = api_key
    )]
    api_keys: Vec<String>,
    /// A file with more of them, one a line; read when the server starts. Empty lines and lines with # do not count.
    #[arg(long, env = "RELUME_API_KEY_FILE", value_name = "FILE")]
    api_key_file: Option<PathBuf>,
}

impl KeyArgs {
    /// The keys of the options and of the file.
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
    if keys.is_empty() { Err(format!("{}: holds no key", path.display()).into()) } else { Ok(keys) }
}

/// A key that is too long to be guessed.
fn api_key(text: &str) -> Result<String, String> {
    let key = text.trim();
    if key.len() < 16 { Err("a key needs at least 16 characters".to_owned()) } else { Ok(key.to_owned()) }
}
