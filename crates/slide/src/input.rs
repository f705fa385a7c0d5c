//! Where bytes come from: a regular file, or memory.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use crate::Fault;

/// The bytes of one picture.
#[derive(Debug)]
pub(crate) enum Input<'a> {
    File { file: Mutex<File>, length: u64 },
    Bytes(&'a [u8]),
}

impl<'a> Input<'a> {
    pub(crate) fn open(path: &Path) -> Result<Self, Fault> {
        let (file, length) = scopeservo_files::open(path)?;
        Ok(Self::File {
            file: Mutex::new(file),
            length,
        })
    }

    pub(crate) fn length(&self) -> u64 {
        match self {
            Self::File { length, .. } => *length,
            Self::Bytes(bytes) => bytes.len() as u64,
        }
    }

    /// Reads what there is at `at`, as [`Read::read`] does.
    fn read_at(&self, at: u64, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::File { file, .. } => {
                let mut file = file.lock().unwrap_or_else(PoisonError::into_inner);
                file.seek(SeekFrom::Start(at))?;
                file.read(buffer)
            }
            Self::Bytes(bytes) => {
                let from = usize::try_from(at).unwrap_or(usize::MAX).min(bytes.len());
                (&bytes[from..]).read(buffer)
            }
        }
    }

    /// The `count` bytes from `at` on, or as many as there are, one after the other.
    pub(crate) fn part(&self, at: u64, count: u64) -> Part<'_, 'a> {
        Part {
            input: self,
            at,
            end: at.saturating_add(count),
        }
    }

    /// All bytes of a part that must be there.
    pub(crate) fn bytes(&self, at: u64, count: u64) -> Result<Vec<u8>, Fault> {
        if at.saturating_add(count) > self.length() {
            return Err(Fault::Truncated(format!(
                "it needs {} bytes and has {}",
                at.saturating_add(count),
                self.length()
            )));
        }
        let mut bytes = Vec::with_capacity(count as usize);
        self.part(at, count).read_to_end(&mut bytes)?;
        match bytes.len() as u64 == count {
            true => Ok(bytes),
            false => Err(Fault::Truncated(
                "it became shorter while it was read".into(),
            )),
        }
    }
}

/// A part of an input.
#[derive(Debug)]
pub(crate) struct Part<'i, 'a> {
    input: &'i Input<'a>,
    at: u64,
    end: u64,
}

impl Read for Part<'_, '_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = usize::try_from(self.end.saturating_sub(self.at)).unwrap_or(usize::MAX);
        let most = left.min(buffer.len());
        let n = self.input.read_at(self.at, &mut buffer[..most])?;
        self.at += n as u64;
        Ok(n)
    }
}

impl Seek for Part<'_, '_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::End(by) => self.end.checked_add_signed(by),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
        };
        self.at = at.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidInput))?;
        Ok(self.at)
    }
}
