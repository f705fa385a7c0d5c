//! Why a file is not a slide, or a region cannot be read.

use std::io;
use std::path::{Path, PathBuf};

/// Why a slide could not be opened or read. Every message names the file and says what to do.
#[derive(thiserror::Error, Debug)]
pub enum SlideError {
    /// There is no file at this path.
    #[error("{}: no such file; check the path", path.display())]
    NotFound {
        /// The path as given.
        path: PathBuf,
    },
    /// The content is neither PNG, JPEG nor TIFF, whatever the extension says.
    #[error("{}: not a readable image ({why}); give a PNG, JPEG, TIFF or SVS file", path.display())]
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
    /// More pixels than are read in one piece.
    #[error(
        "{}: {width} x {height} pixels are more than the {max_pixels} read in one piece; \
         crop it, or save it as a tiled pyramid and read a coarser level or a region",
        path.display()
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Columns asked for.
        width: u64,
        /// Rows asked for.
        height: u64,
        /// The limit, pixels.
        max_pixels: u64,
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
    pub(crate) fn io(path: &Path, source: io::Error) -> Self {
        let path = path.to_path_buf();
        match source.kind() {
            io::ErrorKind::NotFound => Self::NotFound { path },
            io::ErrorKind::UnexpectedEof => Self::Truncated {
                path,
                why: "the data ends inside the image".into(),
            },
            _ => Self::Io { path, source },
        }
    }

    pub(crate) fn truncated(path: &Path, why: impl Into<String>) -> Self {
        Self::Truncated {
            path: path.to_path_buf(),
            why: why.into(),
        }
    }

    pub(crate) fn damaged(path: &Path, why: impl Into<String>) -> Self {
        Self::Damaged {
            path: path.to_path_buf(),
            why: why.into(),
        }
    }

    pub(crate) fn unsupported(path: &Path, what: impl Into<String>) -> Self {
        Self::Unsupported {
            path: path.to_path_buf(),
            what: what.into(),
        }
    }

    /// Refuses empty images and images of more than [`crate::MAX_PIXELS`].
    pub(crate) fn check_size(path: &Path, width: u32, height: u32) -> Result<(), Self> {
        if width == 0 || height == 0 {
            return Err(Self::ZeroSize {
                path: path.to_path_buf(),
                width,
                height,
            });
        }
        if u64::from(width) * u64::from(height) > crate::MAX_PIXELS {
            return Err(Self::TooLarge {
                path: path.to_path_buf(),
                width: width.into(),
                height: height.into(),
                max_pixels: crate::MAX_PIXELS,
            });
        }
        Ok(())
    }

    pub(crate) fn from_image(path: &Path, e: image::ImageError) -> Self {
        use image::ImageError as E;
        match e {
            E::IoError(source) => Self::io(path, source),
            E::Unsupported(u) => Self::unsupported(path, format!("this kind of image ({u})")),
            E::Limits(_) => {
                Self::damaged(path, "the header asks for more memory than any image needs")
            }
            other => {
                let why = other.to_string();
                if why.to_lowercase().contains("eof") || why.contains("end of") {
                    Self::truncated(path, "the data ends inside the image")
                } else {
                    Self::damaged(path, why)
                }
            }
        }
    }

    pub(crate) fn from_tiff(path: &Path, e: tiff::TiffError) -> Self {
        use tiff::TiffError as E;
        match e {
            E::IoError(source) => Self::io(path, source),
            E::UnsupportedError(u) => Self::unsupported(path, format!("this kind of TIFF ({u})")),
            E::LimitsExceeded => Self::damaged(path, "a tag or tile claims an impossible size"),
            E::FormatError(f) => Self::damaged(path, f.to_string()),
            other => Self::damaged(path, other.to_string()),
        }
    }
}
