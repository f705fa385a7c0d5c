//! Cameras on the web, and the secrets that they ask for.

use super::contract::{Around, ConnectError};
use crate::camera::http::Login;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// A file that nobody else should read, and where it is.
///
/// # Errors
/// [`ConnectError::Secret`].
pub fn read_secret(
    resolve: &dyn Fn(&Path) -> PathBuf,
    file: &Path,
) -> Result<(PathBuf, Vec<u8>), ConnectError> {
    let path = resolve(file);
    match scopeservo_files::read(&path, scopeservo_files::MAX_CONFIG_BYTES) {
        Ok(bytes) => Ok((path, bytes)),
        Err(error) => Err(ConnectError::Secret {
            path,
            what: error.to_string(),
        }),
    }
}

/// A camera on the web, and who may see its images.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OnTheWeb<T> {
    /// Where it wants to know who asks.
    pub user: Option<String>,
    /// A file with the password.
    pub password_file: Option<PathBuf>,
    /// How the camera is set up.
    pub settings: T,
}

impl<T> OnTheWeb<T> {
    pub(crate) fn has_whole_login(&self) -> Result<(), String> {
        match self.user.is_some() == self.password_file.is_some() {
            true => Ok(()),
            false => Err("user and password_file belong together".into()),
        }
    }

    pub(crate) fn login(&self, around: &Around<'_>) -> Result<Option<Login>, ConnectError> {
        let (Some(user), Some(file)) = (&self.user, &self.password_file) else {
            return Ok(None);
        };
        let (path, bytes) = read_secret(around.resolve, file)?;
        let password = String::from_utf8(bytes).map_err(|_| ConnectError::Secret {
            path,
            what: "it is not text".into(),
        })?;
        Ok(Some(Login {
            user: user.clone(),
            // Editors end a file with a line end.
            password: password.trim_end_matches(['\r', '\n']).to_string(),
        }))
    }
}
