//! The server on a disk with injected faults.

use std::path::PathBuf;
use std::process::Command;

use relume::store::inspect;
use tempfile::TempDir;

use crate::server_process::Server;

/// A server under `faults.c`, with its log in a file.
pub struct FaultyDisk {
    pub server: Server,
    folder: TempDir,
}

impl FaultyDisk {
    pub fn start() -> Self {
        let folder = TempDir::new().unwrap();
        let library = folder.path().join("faults.so");
        let source = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/faults/faults.c");
        let built = Command::new("cc")
            .args(["-shared", "-fPIC", "-O1", "-o"])
            .arg(&library)
            .arg(source)
            .arg("-ldl")
            .status();
        assert!(built.unwrap().success());
        let mut shell = Command::new("sh");
        shell.args(["-c", "exec \"$@\" 2> \"$0\""]).arg(folder.path().join("log"));
        shell.arg("env").arg(format!("LD_PRELOAD={}", library.display())).arg(env!("CARGO_BIN_EXE_relume"));
        shell.env("RELUME_TEST_FAULTS", folder.path().join("fault")).env("NO_COLOR", "1");
        let server = Server::start_under(shell, &folder.path().join("data"));
        Self { server, folder }
    }

    /// From now on reads, writes or both fail with `errno`; if that is 0, each only takes `delay_ms` longer.
    pub fn fails(&self, what: &str, errno: i32, delay_ms: u32) {
        self.say(&format!("{what} {errno} {delay_ms} 0"));
    }

    /// From now on a file can be read only up to a byte.
    pub fn fails_behind(&self, byte: u64, errno: i32) {
        self.say(&format!("read {errno} 0 {byte}"));
    }

    fn say(&self, fault: &str) {
        let next = self.folder.path().join("next");
        std::fs::write(&next, fault).unwrap();
        std::fs::rename(next, self.folder.path().join("fault")).unwrap();
    }

    /// Ends the faults.
    pub fn mends(&self) {
        std::fs::remove_file(self.folder.path().join("fault")).unwrap();
    }

    /// Stops the server and starts it again without faults. The data must be intact, and the server must not
    /// have panicked.
    pub async fn ends_sound(mut self) {
        std::fs::remove_file(self.folder.path().join("fault")).ok();
        let terminated = Command::new("kill").arg(self.server.child.id().to_string()).status().unwrap();
        assert!(terminated.success());
        assert!(self.server.child.wait().unwrap().success());
        let log = std::fs::read_to_string(self.folder.path().join("log")).unwrap();
        assert!(!log.contains("panick"), "{log}");
        let data = self.folder.path().join("data");
        let found = inspect(&data).await.unwrap();
        assert!(found.faults.is_empty(), "{:?}", found.faults);
        let server = Server::start(&data);
        server.client.models().await.unwrap();
        let found = inspect(&data).await.unwrap();
        assert!(found.faults.is_empty() && found.orphans.is_empty(), "{found:?}");
    }
}
