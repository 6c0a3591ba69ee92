//! The server as a separate process.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use relume_client::Client;

/// A server process, which is killed with the test.
pub struct Server {
    pub child: Child,
    pub client: Client,
}

impl Server {
    pub fn start(data: &Path) -> Self {
        Self::start_under(Command::new(env!("CARGO_BIN_EXE_relume")), data)
    }

    /// `command` runs the server when the server's own arguments are added.
    pub fn start_under(mut command: Command, data: &Path) -> Self {
        command.args(["serve", "--listen", "127.0.0.1:0", "--data-dir"]).arg(data);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let base = line.trim().strip_prefix("listening on ").unwrap_or_else(|| panic!("{line:?}"));
        Self { client: Client::new(base, None).unwrap(), child }
    }

    /// SIGKILL: the server flushes and releases nothing.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
