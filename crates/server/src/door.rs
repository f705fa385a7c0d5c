//! Where the command line finds a server that has its instrument: a file that only its owner can read, as long as it is served.

use serde_json::json;
use std::fs;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// The file, in the server's folder.
pub const DOOR: &str = "door.json";

/// Gone with the server.
pub(crate) struct Door(PathBuf);

impl Door {
    /// Writes where the server is and what opens it.
    pub(crate) fn open(folder: &Path, address: SocketAddr, token: &str) -> io::Result<Self> {
        scopeservo_library::files::make_folder(folder)?;
        let path = folder.join(DOOR);
        let text = json!({"address": address.to_string(), "token": token}).to_string();
        // Nobody else may read it, from the first moment on.
        let _ = fs::remove_file(&path);
        let mut options = fs::OpenOptions::new();
        options.write(true).create_new(true);
        #[cfg(unix)]
        {
            use std::os::unix::fs::OpenOptionsExt as _;
            options.mode(0o600);
        }
        io::Write::write_all(&mut options.open(&path)?, text.as_bytes())?;
        Ok(Self(path))
    }
}

impl Drop for Door {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}
