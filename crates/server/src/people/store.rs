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
            let lost = |e: std::io::Error| {
                ApiError::fault(format!("{} could not be kept: {e}", file.display()))
            };
            let bytes = serde_json::to_vec_pretty(&changed).map_err(|e| lost(e.into()))?;
            // What is written must be read again.
            if bytes.len() as u64 > LARGEST {
                let message = "there are too many users and tokens: end those that nobody needs";
                return Err(ApiError::conflict("too_many", message));
            }
            write(file, &bytes).map_err(lost)?;
        }
        *self = changed;
        Ok(())
    }
}

fn write(file: &Path, bytes: &[u8]) -> std::io::Result<()> {
    if let Some(folder) = file.parent() {
        make_folder(folder)?;
    }
    replace_private(file, bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_would_be_too_much_to_be_read_again_is_refused_and_nothing_is_lost() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("people.json");
        let mut accounts = Accounts::read(file.clone()).unwrap();
        let mut add = |count: usize| {
            accounts.change(|accounts| {
                for _ in 0..count {
                    let n = accounts.tokens.len();
                    accounts.tokens.push(Token {
                        name: format!("token-{n}"),
                        role: Role::Viewer,
                        made_by: "anna".into(),
                        checksum: "0".repeat(64),
                    });
                }
                Ok(())
            })
        };
        add(1000).unwrap();
        let refused = add(10_000).unwrap_err();
        assert_eq!(refused.code, "too_many");
        let again = Accounts::read(file).unwrap();
        assert_eq!(again.tokens.len(), 1000);
    }
}
