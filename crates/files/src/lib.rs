//! Regular files only. A pipe waits for ever and a device never ends: neither is opened, and nothing is read beyond the
//! size that its reader expects.

#![warn(clippy::too_many_lines)]

use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::Path;

/// Most bytes of a configuration file.
pub const MAX_CONFIG_BYTES: u64 = 1 << 20;

/// Opens a regular file for reading; returns it with its length in bytes.
///
/// # Errors
/// [`ErrorKind::IsADirectory`] for a folder, [`ErrorKind::InvalidInput`] for a pipe, a socket or a device, and what the system says.
pub fn open(path: &Path) -> io::Result<(File, u64)> {
    // Asked before opening, which would wait for the other end of a pipe.
    check(&std::fs::metadata(path)?)?;
    let file = File::open(path)?;
    // And again of what was opened, should it have been put there meanwhile.
    let meta = file.metadata()?;
    check(&meta)?;
    Ok((file, meta.len()))
}

/// The bytes of a regular file that has at most `most`.
///
/// # Errors
/// As [`open`]; [`ErrorKind::FileTooLarge`] for a larger file.
pub fn read(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let (file, length) = open(path)?;
    let too_large = || {
        io::Error::new(
            ErrorKind::FileTooLarge,
            format!("it has more than {most} bytes, which no such file needs"),
        )
    };
    if length > most {
        return Err(too_large());
    }
    let mut bytes = Vec::with_capacity(length as usize);
    // It may grow meanwhile.
    file.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    match bytes.len() as u64 > most {
        true => Err(too_large()),
        false => Ok(bytes),
    }
}

/// The text of a regular file that has at most `most` bytes.
///
/// # Errors
/// As [`read`]; [`ErrorKind::InvalidData`] for what is no UTF-8.
pub fn read_text(path: &Path, most: u64) -> io::Result<String> {
    String::from_utf8(read(path, most)?).map_err(|e| {
        let line = e.as_bytes()[..e.utf8_error().valid_up_to()]
            .split(|b| *b == b'\n')
            .count();
        io::Error::new(
            ErrorKind::InvalidData,
            format!("line {line} is no UTF-8 text"),
        )
    })
}

fn check(meta: &std::fs::Metadata) -> io::Result<()> {
    if meta.is_file() {
        return Ok(());
    }
    Err(match meta.is_dir() {
        true => io::Error::new(ErrorKind::IsADirectory, "it is a folder"),
        false => io::Error::new(
            ErrorKind::InvalidInput,
            "it is a pipe or a device and no regular file",
        ),
    })
}
