//! Images one after another in one answer: `multipart/x-mixed-replace`, which cameras call MJPEG.

use crate::camera::http::MAX_PICTURE_BYTES;
use thiserror::Error;

/// No head of a part is larger.
const MAX_PART_HEAD_BYTES: usize = 8 << 10;
const MAX_HEADERS: usize = 32;

/// What is wrong with a stream of images.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum MultipartError {
    /// The answer does not hold images one after another.
    #[error("it sends '{0}' and not multipart/x-mixed-replace: for single images use snapshot")]
    OtherType(String),
    /// The answer does not say what stands between two images.
    #[error("it does not say what stands between two images (boundary)")]
    NoBoundary,
    /// The head of an image makes no sense.
    #[error("the head of an image makes no sense: {0}")]
    Head(String),
    /// Something too large for an image, or no end of one.
    #[error("an image has more than {} MiB, or has no end", MAX_PICTURE_BYTES >> 20)]
    TooLarge,
}

/// Cuts a stream into images. It never holds more than one image of the greatest size and what was put in last.
#[derive(Debug)]
pub struct Parts {
    /// The line that begins a part, without its end.
    delimiter: Vec<u8>,
    held: Vec<u8>,
    state: State,
    /// How much of `held` has been searched.
    searched: usize,
    /// How much has passed since the last image.
    passed: usize,
    /// Whether the last image said how long it is.
    sized: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// Before a delimiter.
    Between,
    /// After a delimiter, in the head.
    Head,
    /// In an image of so many bytes.
    Sized(usize),
    /// In an image that ends where the next delimiter begins.
    Unsized,
}

impl Parts {
    /// For an answer with this content type.
    ///
    /// # Errors
    /// [`MultipartError::OtherType`], [`MultipartError::NoBoundary`].
    pub fn new(content_type: &str) -> Result<Self, MultipartError> {
        let mut words = content_type.split(';').map(str::trim);
        let kind = words.next().unwrap_or_default().to_ascii_lowercase();
        if !kind.starts_with("multipart/") {
            return Err(MultipartError::OtherType(kind));
        }
        let boundary = words
            .find_map(|word| {
                let (key, value) = word.split_once('=')?;
                key.trim()
                    .eq_ignore_ascii_case("boundary")
                    .then(|| value.trim().trim_matches('"'))
            })
            .filter(|b| !b.is_empty() && b.len() <= 200)
            .ok_or(MultipartError::NoBoundary)?;
        // Some cameras count the dashes in.
        let delimiter = match boundary.starts_with("--") {
            true => boundary.to_string(),
            false => format!("--{boundary}"),
        };
        Ok(Self {
            delimiter: delimiter.into_bytes(),
            held: Vec::new(),
            state: State::Between,
            searched: 0,
            passed: 0,
            sized: false,
        })
    }

    /// Room for what comes next.
    pub fn feed(&mut self) -> &mut Vec<u8> {
        &mut self.held
    }

    /// The next image, when it has come whole.
    ///
    /// # Errors
    /// [`MultipartError`]; the stream cannot be read on then.
    pub fn take(&mut self) -> Result<Option<Vec<u8>>, MultipartError> {
        loop {
            match self.state {
                State::Between => {
                    let Some(at) = self.find_delimiter() else {
                        // A delimiter may have come in part.
                        let keep = self.delimiter.len() + 2;
                        let drop = self.held.len().saturating_sub(keep);
                        self.held.drain(..drop);
                        self.searched = 0;
                        self.passed += drop;
                        return match self.passed > MAX_PICTURE_BYTES {
                            true => Err(MultipartError::TooLarge),
                            false => Ok(None),
                        };
                    };
                    self.cut(at + self.delimiter.len());
                    self.passed = 0;
                    self.state = State::Head;
                }
                State::Head => {
                    let Some(size) = self.head()? else {
                        return Ok(None);
                    };
                    self.sized = size.is_some();
                    self.state = size.map_or(State::Unsized, State::Sized);
                }
                State::Sized(size) => {
                    if self.held.len() < size {
                        return Ok(None);
                    }
                    let picture = self.cut(size);
                    self.state = State::Between;
                    if !picture.is_empty() {
                        return Ok(Some(picture));
                    }
                }
                State::Unsized => {
                    let Some(at) = self.find_delimiter() else {
                        if self.held.len() > MAX_PICTURE_BYTES {
                            return Err(MultipartError::TooLarge);
                        }
                        self.searched = self.held.len().saturating_sub(self.delimiter.len());
                        return Ok(None);
                    };
                    let mut picture = self.cut(at);
                    // The line end before a delimiter belongs to it.
                    for end in *b"\n\r" {
                        if picture.last() == Some(&end) {
                            picture.pop();
                        }
                    }
                    self.state = State::Between;
                    if !picture.is_empty() {
                        return Ok(Some(picture));
                    }
                }
            }
        }
    }

    /// Whether the last image said how long it is; one that did not ends where the next begins.
    pub fn was_sized(&self) -> bool {
        self.sized
    }

    fn cut(&mut self, at: usize) -> Vec<u8> {
        self.searched = 0;
        let rest = self.held.split_off(at);
        std::mem::replace(&mut self.held, rest)
    }

    fn find_delimiter(&self) -> Option<usize> {
        let n = self.delimiter.len();
        let from = self.searched.min(self.held.len());
        self.held[from..]
            .windows(n)
            .position(|w| w == self.delimiter)
            .map(|at| from + at)
    }

    /// The head after a delimiter: the size of the image if it says so; `None` when it has not come whole.
    fn head(&mut self) -> Result<Option<Option<usize>>, MultipartError> {
        // The rest of the delimiter's line.
        let Some(line) = self.held.iter().position(|b| *b == b'\n') else {
            return match self.held.len() > MAX_PART_HEAD_BYTES {
                true => Err(MultipartError::Head("a delimiter without an end".into())),
                false => Ok(None),
            };
        };
        let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
        let head = &self.held[line + 1..];
        let (length, size) = match httparse::parse_headers(head, &mut headers) {
            Ok(httparse::Status::Complete((length, found))) => {
                let size = found
                    .iter()
                    .find(|h| h.name.eq_ignore_ascii_case("Content-Length"));
                let size = size.map(|h| {
                    let text = String::from_utf8_lossy(h.value);
                    let bad = || MultipartError::Head(format!("a length of '{text}'"));
                    text.trim().parse::<usize>().map_err(|_| bad())
                });
                (length, size.transpose()?)
            }
            Ok(httparse::Status::Partial) if head.len() > MAX_PART_HEAD_BYTES => {
                return Err(MultipartError::Head("it has no end".into()));
            }
            Ok(httparse::Status::Partial) => return Ok(None),
            Err(error) => return Err(MultipartError::Head(error.to_string())),
        };
        if size.is_some_and(|s| s > MAX_PICTURE_BYTES) {
            return Err(MultipartError::TooLarge);
        }
        self.cut(line + 1 + length);
        Ok(Some(size))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a stream holds, put in in pieces.
    fn pictures(
        content_type: &str,
        stream: &[u8],
        piece: usize,
    ) -> Result<Vec<Vec<u8>>, MultipartError> {
        let mut parts = Parts::new(content_type)?;
        let mut all = Vec::new();
        for chunk in stream.chunks(piece) {
            parts.feed().extend_from_slice(chunk);
            while let Some(picture) = parts.take()? {
                all.push(picture);
            }
        }
        Ok(all)
    }

    const PIECES: [usize; 5] = [1, 2, 5, 13, 1000];

    #[test]
    fn pictures_come_whole_as_different_cameras_send_them() {
        let sized = b"preamble\r\n--frame\r\nContent-Type: image/jpeg\r\nContent-Length: 9\r\n\r\n\xff\xd8--frame\r\n--frame\r\n\
            X-Timestamp: 1.5\r\nContent-Length:2\r\n\r\nab\r\n--frame--\r\n";
        let open = b"--frame\r\nContent-Type: image/jpeg\r\n\r\n\xff\xd8\n\r\nc\r\n--frame\r\nContent-Type: image/jpeg\r\n\r\nde\
            \r\n--frame\r\n";
        for piece in PIECES {
            for kind in [
                "multipart/x-mixed-replace; boundary=frame",
                "Multipart/X-Mixed-Replace;boundary=\"frame\"",
                "multipart/x-mixed-replace; x=y; Boundary=--frame",
            ] {
                // What looks like a delimiter inside an image of a known size is none.
                assert_eq!(
                    pictures(kind, sized, piece).unwrap(),
                    [b"\xff\xd8--frame".to_vec(), b"ab".to_vec()]
                );
                assert_eq!(
                    pictures(kind, open, piece).unwrap(),
                    [b"\xff\xd8\n\r\nc".to_vec(), b"de".to_vec()]
                );
            }
        }
    }

    #[test]
    fn what_is_no_stream_of_pictures_is_told() {
        assert_eq!(
            Parts::new("image/jpeg").unwrap_err(),
            MultipartError::OtherType("image/jpeg".into())
        );
        assert_eq!(
            Parts::new("multipart/x-mixed-replace").unwrap_err(),
            MultipartError::NoBoundary
        );
        let kind = "multipart/x-mixed-replace; boundary=b";
        let long = [
            b"--b\r\nContent-Type: ".as_slice(),
            &[b'a'; 2 * MAX_PART_HEAD_BYTES],
        ]
        .concat();
        for piece in PIECES {
            for wrong in [
                b"--b\r\nContent-Length: 99999999999\r\n\r\n".as_slice(),
                b"--b\r\nContent-Length: many\r\n\r\n",
                b"--b\r\n\x00\x01\r\n\r\n",
                &long,
            ] {
                assert!(pictures(kind, wrong, piece).is_err(), "{wrong:?}");
            }
        }
    }

    #[test]
    fn nothing_piles_up_before_the_first_picture() {
        let mut parts = Parts::new("multipart/x-mixed-replace; boundary=b").unwrap();
        for _ in 0..100 {
            parts.feed().extend_from_slice(&[b'-'; 1000]);
            assert_eq!(parts.take(), Ok(None));
            assert!(parts.held.len() < 20);
        }
        // And not for ever.
        let more = vec![b'-'; MAX_PICTURE_BYTES];
        parts.feed().extend_from_slice(&more);
        assert_eq!(parts.take(), Err(MultipartError::TooLarge));
    }
}
