//! One program at a time drives an instrument: a lock for each driver that can move something, by where its device is, so that two
//! descriptions of one device are one instrument; and one for its name in its data folder, so that two instruments never keep their jobs
//! in one journal.
//!
//! The lock is the operating system's, on a file in the folder for temporary files. It is gone with the process that holds it, however
//! that ends; the file stays, and means nothing by itself.

use crate::SetupError;
use crate::config::{Config, DriverConfig};
use scopeservo_drivers::factory::Place;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How long one waits for the program before to leave.
const PATIENCE: Duration = Duration::from_secs(2);
const AGAIN: Duration = Duration::from_millis(50);

/// That this program alone drives an instrument, for as long as it is kept.
#[derive(Debug)]
pub struct Held {
    _files: Vec<File>,
}

impl Held {
    /// Takes the devices of a description.
    ///
    /// # Errors
    /// [`SetupError::InUse`], [`SetupError::Held`].
    pub(crate) fn take(config: &Config) -> Result<Self, SetupError> {
        let named = config.drivers.iter();
        let places = named
            .filter_map(|(name, driver)| Some((format!("drivers.{name}"), place(config, driver)?)));
        Self::all(places)
    }

    /// Takes a driver that is a program, or listens at an address, without a description of an instrument.
    ///
    /// # Errors
    /// [`SetupError::InUse`], [`SetupError::Held`].
    pub fn driver(program: &[String], tcp: Option<&str>) -> Result<Self, SetupError> {
        let program = (!program.is_empty()).then(|| program_at(program, Path::new("")));
        let place = tcp.map(at_address).or(program);
        Self::all(place.map(|place| ("the driver".to_owned(), place)))
    }

    /// Takes the name and the data folder of a description: what is kept there of a job under way is that of one instrument, whatever its
    /// devices are.
    ///
    /// # Errors
    /// [`SetupError::NameInUse`], [`SetupError::Held`].
    pub fn data(config: &Config) -> Result<Self, SetupError> {
        let folder = config.resolve(&config.data_folder);
        let place = format!("data {}\0{}", begun(&folder).display(), config.name);
        Self::all([(config.name.clone(), place)]).map_err(|error| match error {
            SetupError::InUse {
                what: name,
                process,
            } => SetupError::NameInUse {
                name,
                folder,
                process,
            },
            error => error,
        })
    }

    fn all(places: impl IntoIterator<Item = (String, String)>) -> Result<Self, SetupError> {
        let mut named: Vec<(String, String)> =
            places.into_iter().map(|(name, at)| (at, name)).collect();
        // Two programs that want the same ones ask in the same order, and one device is taken once.
        named.sort();
        named.dedup_by(|a, b| a.0 == b.0);
        let files = named.into_iter().map(|(place, name)| lock(&place, name));
        Ok(Self {
            _files: files.collect::<Result<_, _>>()?,
        })
    }
}

/// Where the device is of a driver that can move something. The simulated microscope of this program is nobody else's, and whoever only
/// looks may share a camera.
fn place(config: &Config, driver: &DriverConfig) -> Option<String> {
    if let Some(program) = &driver.program {
        return Some(program_at(program, &config.resolve(Path::new(""))));
    }
    if let Some(address) = &driver.tcp {
        return Some(at_address(address));
    }
    let place = driver.own.first()?.place()?;
    Some(match place {
        Place::Tcp(address) => at_address(address),
        Place::Serial(port) => format!("serial {}", real(Path::new(port)).display()),
    })
}

fn at_address(address: &str) -> String {
    format!("tcp {}", address.replace("localhost", "127.0.0.1"))
}

/// A program and its arguments, those that are files by where these lie: the program from `folder` on if it has a `/`, the others from
/// where this program runs.
fn program_at(program: &[String], folder: &Path) -> String {
    let words = program.iter().enumerate().map(|(k, word)| {
        let path = match k == 0 && word.contains('/') {
            true => folder.join(word),
            false => word.into(),
        };
        real(&path).display().to_string()
    });
    format!("program {}", words.collect::<Vec<_>>().join("\0"))
}

/// The path without links and detours, where there is such a file.
fn real(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.into())
}

/// The path without links and detours as far as it exists; the rest may come.
fn begun(path: &Path) -> PathBuf {
    let whole = std::path::absolute(path).unwrap_or_else(|_| path.into());
    let there = whole.ancestors().find_map(|at| {
        let rest = whole.strip_prefix(at).ok()?;
        // By its parts: joining nothing to it would add a slash.
        let there = at.canonicalize().ok()?;
        Some(there.components().chain(rest.components()).collect())
    });
    there.unwrap_or(whole)
}

/// The same for every version of this program: the name is the place's FNV-1a sum.
fn file_of(place: &str) -> PathBuf {
    let sum = |sum: u64, byte: u8| (sum ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    let sum = place.bytes().fold(0xcbf2_9ce4_8422_2325, sum);
    std::env::temp_dir().join(format!("scopeservo-{sum:016x}.lock"))
}

fn lock(place: &str, what: String) -> Result<File, SetupError> {
    let path = file_of(place);
    let failed = |source| SetupError::Held {
        path: path.clone(),
        source,
    };
    let mut file = open(&path).map_err(failed)?;
    let start = Instant::now();
    loop {
        match file.try_lock() {
            Ok(()) => break,
            Err(TryLockError::WouldBlock) if start.elapsed() < PATIENCE => {
                std::thread::sleep(AGAIN);
            }
            Err(TryLockError::WouldBlock) => {
                let mut text = String::new();
                let read = file.read_to_string(&mut text);
                let process = read.ok().and_then(|_| text.trim().parse().ok());
                return Err(SetupError::InUse { what, process });
            }
            Err(TryLockError::Error(source)) => return Err(failed(source)),
        }
    }
    // For whoever finds it taken. What another user began cannot be written to, and is locked all the same.
    let _ = file
        .set_len(0)
        .and_then(|()| file.rewind())
        .and_then(|()| write!(file, "{}", std::process::id()));
    Ok(file)
}

fn open(path: &Path) -> std::io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(true);
    match options.clone().create_new(true).open(path) {
        Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
            // A link that somebody laid there is not written through.
            match path.symlink_metadata()?.is_file() {
                true => options.open(path).or_else(|_| File::open(path)),
                false => Err(error),
            }
        }
        opened => opened,
    }
}
