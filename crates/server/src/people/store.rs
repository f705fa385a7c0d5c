//! The file of users and tokens: readable for its owner alone.

use super::role::Role;
use crate::error::ApiError;
use scopeservo_library::files::{make_folder, replace_private};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// No such file is larger, bytes.
const LARGEST: u64 = 1 << 20;
const SCHEMA: u32 = 1;

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Account {
    pub(super) name: String,
    pub(super) role: Role,
    /// As argon2id has it.
    pub(super) password: String,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Token {
    pub(super) name: String,
    pub(super) role: Role,
    pub(super) made_by: String,
    pub(super) checksum: String,
}

#[derive(Debug, Default, Clone, Serialize, Deserialize)]
pub(super) struct Accounts {
    schema: u32,
    pub(super) users: Vec<Account>,
    pub(super) tokens: Vec<Token>,
    /// Where they are kept; nowhere in a demonstration.
    #[serde(skip)]
    file: Option<PathBuf>,
}

impl Accounts {
    pub(super) fn read(file: PathBuf) -> Result<Self, String> {
        let bytes = match scopeservo_files::read(&file, LARGEST) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                return Ok(Self {
                    schema: SCHEMA,
                    file: Some(file),
                    ..Self::default()
                });
            }
            bytes => bytes.map_err(|e| e.to_string())?,
        };
        let read: Self = serde_json::from_slice(&bytes).map_err(|e| e.to_string())?;
        if read.schema != SCHEMA {
            let schema = read.schema;
            return Err(format!(
                "it has schema {schema}, and this version reads {SCHEMA}"
            ));
        }
        Ok(Self {
            file: Some(file),
            ..read
        })
    }

    pub(super) fn user(&self, name: &str) -> Option<&Account> {
        self.users.iter().find(|a| a.name == name)
    }

    /// Changes them, on disk first: what could not be kept did not happen.
    pub(super) fn change(
        &mut self,
        change: impl FnOnce(&mut Self) -> Result<(), ApiError>,
    ) -> Result<(), ApiError> {
        let mut changed = self.clone();
        change(&mut changed)?;
        if let Some(file) = &self.file {
            let kept = changed.write(file);
            kept.map_err(|e| {
                ApiError::fault(format!("{} could not be kept: {e}", file.display()))
            })?;
        }
        *self = changed;
        Ok(())
    }

    fn write(&self, file: &Path) -> std::io::Result<()> {
        if let Some(folder) = file.parent() {
            make_folder(folder)?;
        }
        let bytes = serde_json::to_vec_pretty(self).map_err(std::io::Error::other)?;
        replace_private(file, &bytes)
    }
}
