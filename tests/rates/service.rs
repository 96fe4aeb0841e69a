//! The program as a child process on a port of its own, with a temporary folder.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use serde_json::Value;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;

use super::client::answer;

/// A running service; it ends when it is dropped.
pub(crate) struct Service {
    child: Child,
    /// `127.0.0.1:PORT`.
    pub(crate) address: String,
    _folder: tempfile::TempDir,
}

impl Service {
    pub(crate) fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_shapelex"));
        for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("SHAPELEX_")) {
            command.env_remove(name);
        }
        command.env_remove("DATABASE_URL");
        command.args(["serve", "--listen", "127.0.0.1:0", "--no-example", "--log", "warn", "--data-dir"]);
        let mut child = command.arg(folder.path()).stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim().rsplit("http://").next().unwrap().to_owned();
        Self { child, address, _folder: folder }
    }

    /// Bytes that the process has read so far, from files and connections, where the system counts them.
    pub(crate) fn bytes_read(&self) -> Option<u64> {
        let counted = std::fs::read_to_string(format!("/proc/{}/io", self.child.id())).ok()?;
        counted.lines().find_map(|line| line.strip_prefix("rchar: "))?.parse().ok()
    }

    /// The JSON with which it answers one request.
    pub(crate) async fn ask(&self, request: &[u8]) -> Value {
        let mut stream = TcpStream::connect(&self.address).await.unwrap();
        stream.write_all(request).await.unwrap();
        let (status, body) = answer(&mut stream, &mut Vec::new()).await.unwrap();
        assert!((200..300).contains(&status), "{status} {}", String::from_utf8_lossy(&body));
        serde_json::from_slice(&body).unwrap()
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}
