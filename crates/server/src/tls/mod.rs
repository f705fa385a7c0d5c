//! TLS: with a certificate that somebody gives, or one that is made here and kept.

mod der;
mod own;

use base64::Engine as _;
use rustls::ServerConfig;
use rustls::client::verify_server_name;
use rustls::crypto::ring::default_provider;
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use rustls::server::ParsedCertificate;
use scopeservo_library::files::{make_folder, replace_private};
use sha2::{Digest as _, Sha256};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use thiserror::Error;

/// The certificate and the key of our own, in the server's folder.
const OWN: &str = "tls.pem";
/// Our own one is made anew so long before it ends.
const RENEWED: Duration = Duration::from_secs(30 * 86_400);

/// Whose certificate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Certificate {
    /// Made here, once, and kept.
    Own,
    /// These files in PEM form.
    Files {
        /// The certificate, and those that vouch for it.
        certificate: PathBuf,
        /// Its private key.
        key: PathBuf,
    },
}

/// Why TLS cannot be spoken.
#[derive(Debug, Error)]
pub enum TlsError {
    /// No certificate there.
    #[error(
        "the certificate {path} cannot be read: {why}. Give a file in PEM form: the certificate first, then those that vouch for it"
    )]
    Certificate {
        /// The file.
        path: PathBuf,
        /// Why.
        why: String,
    },
    /// No key there.
    #[error(
        "the key {path} cannot be read: {why}. Give a file in PEM form with the private key, not encrypted, that this user may read"
    )]
    Key {
        /// The file.
        path: PathBuf,
        /// Why.
        why: String,
    },
    /// They are not of one another.
    #[error(
        "the key {key} is not that of the certificate {certificate}: give the two that were made together"
    )]
    DoesNotFit {
        /// The certificate.
        certificate: PathBuf,
        /// The key.
        key: PathBuf,
    },
    /// It has ended.
    #[error(
        "the certificate {path} has ended ({until}): have it renewed, or leave --tls-cert and --tls-key out for one that is made here"
    )]
    Expired {
        /// The file.
        path: PathBuf,
        /// When.
        until: String,
    },
    /// It has not begun.
    #[error(
        "the certificate {path} holds only from {from} on: look whether this computer's clock is right"
    )]
    NotYet {
        /// The file.
        path: PathBuf,
        /// From when.
        from: String,
    },
    /// Our own cannot be made or kept.
    #[error(
        "a certificate cannot be made in {path}: {why}. Mend that, or give one with --tls-cert and --tls-key"
    )]
    NotMade {
        /// Where.
        path: PathBuf,
        /// Why.
        why: String,
    },
}

/// What TLS is spoken with.
pub(crate) struct Tls {
    pub(crate) config: Arc<ServerConfig>,
    /// The SHA-256 checksum of the certificate, as browsers show it.
    pub(crate) fingerprint: String,
}

impl Tls {
    /// With that certificate. One of our own is for these names, and is kept in that folder.
    ///
    /// # Errors
    /// [`TlsError`].
    pub(crate) fn with(
        whose: &Certificate,
        folder: &Path,
        names: &[String],
        now: SystemTime,
    ) -> Result<Self, TlsError> {
        match whose {
            Certificate::Files { certificate, key } => read(certificate, key, now),
            Certificate::Own => {
                let path = folder.join(OWN);
                match read(&path, &path, now + RENEWED) {
                    Ok(tls) if tls.is_for(&path, names) => Ok(tls),
                    // Not there, damaged, ended, or of other addresses: nobody loses anything by another one.
                    _ => {
                        make(&path, names, now)?;
                        read(&path, &path, now)
                    }
                }
            }
        }
    }

    fn is_for(&self, path: &Path, names: &[String]) -> bool {
        let first = certificates(path)
            .ok()
            .and_then(|mut all| (!all.is_empty()).then(|| all.remove(0)));
        let Some(first) = first else {
            return false;
        };
        ParsedCertificate::try_from(&first).is_ok_and(|parsed| {
            names.iter().all(|name| {
                let name = ServerName::try_from(name.as_str());
                name.is_ok_and(|name| verify_server_name(&parsed, &name).is_ok())
            })
        })
    }
}

fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, String> {
    let all = CertificateDer::pem_file_iter(path).map_err(|e| e.to_string())?;
    let all: Result<Vec<_>, _> = all.collect();
    all.map_err(|e| e.to_string())
}

fn read(certificate: &Path, key: &Path, now: SystemTime) -> Result<Tls, TlsError> {
    let unread = |why: String| TlsError::Certificate {
        path: certificate.into(),
        why,
    };
    let chain = certificates(certificate).map_err(unread)?;
    let first = chain
        .first()
        .ok_or_else(|| unread("there is none in it".into()))?;
    let fingerprint = fingerprint(first);
    let [from, until] = der::holds(first).ok_or_else(|| unread("it is damaged".into()))?;
    let path = certificate.to_owned();
    let now = own::stamp(now);
    if now > until {
        let until = spoken(&until);
        return Err(TlsError::Expired { path, until });
    }
    if now < from {
        let from = spoken(&from);
        return Err(TlsError::NotYet { path, from });
    }
    let no_key = |why: String| TlsError::Key {
        path: key.into(),
        why,
    };
    let private = PrivateKeyDer::from_pem_file(key).map_err(|e| no_key(e.to_string()))?;
    let config = ServerConfig::builder_with_provider(Arc::new(default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|e| no_key(e.to_string()))?
        .with_no_client_auth()
        .with_single_cert(chain, private);
    let mut config = config.map_err(|error| match error {
        rustls::Error::InconsistentKeys(_) => TlsError::DoesNotFit {
            certificate: certificate.into(),
            key: key.into(),
        },
        rustls::Error::InvalidCertificate(why) => unread(format!("{why:?}")),
        error => no_key(error.to_string()),
    })?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(Tls {
        config: Arc::new(config),
        fingerprint,
    })
}

fn fingerprint(certificate: &[u8]) -> String {
    let bytes = Sha256::digest(certificate);
    let pairs: Vec<String> = bytes.iter().map(|b| format!("{b:02X}")).collect();
    pairs.join(":")
}

/// A time of a certificate for people: its day.
fn spoken(time: &str) -> String {
    match (time.get(..4), time.get(4..6), time.get(6..8)) {
        (Some(year), Some(month), Some(day)) => format!("{year}-{month}-{day}"),
        _ => time.into(),
    }
}

fn make(path: &Path, names: &[String], now: SystemTime) -> Result<(), TlsError> {
    let failed = |why: String| TlsError::NotMade {
        path: path.into(),
        why,
    };
    let made = own::make(names, now).map_err(|e| failed(e.to_string()))?;
    let pem = [
        pem("CERTIFICATE", &made.certificate),
        pem("PRIVATE KEY", &made.key),
    ];
    let keep = || -> io::Result<()> {
        if let Some(folder) = path.parent() {
            make_folder(folder)?;
        }
        replace_private(path, pem.concat().as_bytes())
    };
    keep().map_err(|e| failed(e.to_string()))
}

fn pem(what: &str, der: &[u8]) -> String {
    let text = base64::engine::general_purpose::STANDARD.encode(der);
    let lines = text.as_bytes().chunks(64).map(String::from_utf8_lossy);
    let lines: Vec<_> = lines.collect();
    format!(
        "-----BEGIN {what}-----\n{}\n-----END {what}-----\n",
        lines.join("\n")
    )
}
