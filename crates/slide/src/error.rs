//! Why a file is not a picture, or a region cannot be read.

use std::io;
use std::path::{Path, PathBuf};

/// What is wrong with a picture, whatever it came from: a file, a camera, a target.
#[derive(thiserror::Error, Debug)]
#[non_exhaustive]
pub enum Fault {
    /// The content is none of the formats that are read, whatever a name says.
    #[error("it is no image that is read here ({0})")]
    NotAnImage(String),
    /// It starts well and ends too early.
    #[error("it is cut short ({0})")]
    Truncated(String),
    /// The format is right and the content is broken.
    #[error("its image data is damaged ({0})")]
    Damaged(String),
    /// It has no pixels.
    #[error("it is {width} x {height} pixels and therefore empty")]
    ZeroSize {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Reading it takes more memory than it may.
    #[error(
        "{width} x {height} pixels take {needed_mb} MB of memory to read, and {allowed_mb} MB may be used"
    )]
    TooLarge {
        /// Columns asked for.
        width: u32,
        /// Rows asked for.
        height: u32,
        /// What it takes, millions of bytes.
        needed_mb: u64,
        /// What it may, millions of bytes.
        allowed_mb: u64,
    },
    /// Valid, and uses something that is not read.
    #[error("{0} is not supported")]
    Unsupported(String),
    /// A level, page or channel that it does not have.
    #[error("{what} {asked} was asked for and it has {available}, counted from 0")]
    NotThere {
        /// "level", "page" or "channel".
        what: &'static str,
        /// Which was asked for.
        asked: usize,
        /// How many there are.
        available: usize,
    },
    /// The operating system refused.
    #[error(transparent)]
    Io(io::Error),
}

impl From<io::Error> for Fault {
    fn from(e: io::Error) -> Self {
        match e.kind() {
            io::ErrorKind::UnexpectedEof => {
                Self::Truncated("the data ends inside the image".into())
            }
            io::ErrorKind::IsADirectory => Self::NotAnImage("it is a folder".into()),
            io::ErrorKind::InvalidInput | io::ErrorKind::FileTooLarge => {
                Self::NotAnImage(e.to_string())
            }
            // What decompressors say of bytes that are none of theirs.
            io::ErrorKind::InvalidData | io::ErrorKind::Other => Self::Damaged(e.to_string()),
            _ => Self::Io(e),
        }
    }
}

/// Refuses pictures without pixels.
pub(crate) fn check_not_empty(width: u32, height: u32) -> Result<(), Fault> {
    match width == 0 || height == 0 {
        true => Err(Fault::ZeroSize { width, height }),
        false => Ok(()),
    }
}

/// Why a slide could not be opened or read. Every message names the file and says what to do.
#[derive(thiserror::Error, Debug)]
pub enum SlideError {
    /// There is no file at this path.
    #[error("{}: no such file; check the path", path.display())]
    NotFound {
        /// The path as given.
        path: PathBuf,
    },
    /// The content is none of the formats that are read, whatever the extension says.
    #[error("{}: not a readable image ({why}); give a PNG, JPEG, JPEG 2000, TIFF or SVS file", path.display())]
    NotAnImage {
        /// The file.
        path: PathBuf,
        /// What was found instead.
        why: String,
    },
    /// The file starts well and ends too early.
    #[error("{}: the file is cut short ({why}); copy or download it again", path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Where the data ended.
        why: String,
    },
    /// The format is right and the content is broken.
    #[error("{}: the image data is damaged ({why}); copy or export the file again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What the decoder met.
        why: String,
    },
    /// The image has no pixels.
    #[error("{}: the image is {width} x {height} pixels and therefore empty; export it again", path.display())]
    ZeroSize {
        /// The file.
        path: PathBuf,
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Reading takes more memory than it may.
    #[error(
        "{}: {width} x {height} pixels take {needed_mb} MB of memory to read, and {allowed_mb} MB may be used; \
         crop it, or save it as a tiled pyramid and read a coarser level or a region",
        path.display()
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Columns asked for.
        width: u32,
        /// Rows asked for.
        height: u32,
        /// What it takes, millions of bytes.
        needed_mb: u64,
        /// What it may, millions of bytes.
        allowed_mb: u64,
    },
    /// A valid file that uses something this reader does not know.
    #[error("{}: {what} is not supported; convert the file to PNG, JPEG, or TIFF with 8 or 16 bit grey or RGB", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What is not known, as the subject of a sentence.
        what: String,
    },
    /// A level that the slide does not have.
    #[error("{}: level {asked} was asked for and the slide has {available}, counted from 0 (finest)", path.display())]
    Level {
        /// The file.
        path: PathBuf,
        /// The level asked for.
        asked: usize,
        /// How many levels there are.
        available: usize,
    },
    /// A page or a channel that the file does not have.
    #[error("{}: {what} {asked} was asked for and the file has {available}, counted from 0", path.display())]
    NotThere {
        /// The file.
        path: PathBuf,
        /// "page" or "channel".
        what: &'static str,
        /// Which was asked for.
        asked: usize,
        /// How many there are.
        available: usize,
    },
    /// The operating system refused.
    #[error("{}: the file could not be read ({source}); check that it is a file and its permissions", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

impl SlideError {
    /// What is wrong with the file at `path`.
    pub(crate) fn of(path: &Path, fault: Fault) -> Self {
        let path = path.to_path_buf();
        match fault {
            Fault::NotAnImage(why) => Self::NotAnImage { path, why },
            Fault::Truncated(why) => Self::Truncated { path, why },
            Fault::Damaged(why) => Self::Damaged { path, why },
            Fault::ZeroSize { width, height } => Self::ZeroSize {
                path,
                width,
                height,
            },
            Fault::TooLarge {
                width,
                height,
                needed_mb,
                allowed_mb,
            } => Self::TooLarge {
                path,
                width,
                height,
                needed_mb,
                allowed_mb,
            },
            Fault::Unsupported(what) => Self::Unsupported { path, what },
            Fault::NotThere {
                what: "level",
                asked,
                available,
            } => Self::Level {
                path,
                asked,
                available,
            },
            Fault::NotThere {
                what,
                asked,
                available,
            } => Self::NotThere {
                path,
                what,
                asked,
                available,
            },
            Fault::Io(source) if source.kind() == io::ErrorKind::NotFound => {
                Self::NotFound { path }
            }
            Fault::Io(source) => Self::Io { path, source },
        }
    }
}
