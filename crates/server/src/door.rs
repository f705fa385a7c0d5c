//! Where the command line finds a server that has its instrument: a file that only its owner can read, as long as it is served.

use scopeservo_library::files::{make_folder, replace_private};
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
        make_folder(folder)?;
        let path = folder.join(DOOR);
        let text = json!({"address": address.to_string(), "token": token}).to_string();
        replace_private(&path, text.as_bytes())?;
        Ok(Self(path))
    }
}

impl Drop for Door {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}
