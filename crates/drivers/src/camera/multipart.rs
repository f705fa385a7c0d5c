//! Images one after another in one answer: `multipart/x-mixed-replace`, which cameras call MJPEG.
//!
//! Read as browsers do: what stands between two images is looked for, and all else that a camera says of its stream may be wrong or missing.

use crate::camera::http::MAX_PICTURE_BYTES;
use thiserror::Error;

/// No head of a part is larger.
const MAX_PART_HEAD_BYTES: usize = 8 << 10;
/// No line between two images is longer.
const MAX_DELIMITER_BYTES: usize = 300;

/// No more line ends stand between an image and a delimiter.
const MAX_LINE_ENDS: usize = 16;

/// What is wrong with a stream of images.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum MultipartError {
    /// The answer does not hold images one after another.
    #[error("it sends '{0}' and not multipart/x-mixed-replace: for single images use snapshot")]
    OtherType(String),
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
    /// What the answer says that stands between two images, without dashes before it; empty where it does not say it.
    told: Vec<u8>,
    /// What does stand there: with its dashes, as it began the first part.
    delimiter: Option<Vec<u8>>,
    held: Vec<u8>,
    state: State,
    /// How much of `held` has been searched.
    searched: usize,
    /// How much has passed since the last image.
    passed: usize,
    /// Whether the last image said how long it is, and was.
    sized: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// Before a delimiter.
    Between,
    /// After a delimiter, in the head.
    Head,
    /// In an image that says that it has so many bytes.
    Sized(usize),
    /// In an image that ends where the next delimiter begins.
    Unsized,
    /// In something that is no image, up to the next delimiter.
    Other,
}

/// What the head of a part says of it.
#[derive(Debug, Default)]
struct Head {
    size: Option<usize>,
    is_other: bool,
}

impl Parts {
    /// For an answer with this content type, which may be missing.
    ///
    /// # Errors
    /// [`MultipartError::OtherType`].
    pub fn new(content_type: &str) -> Result<Self, MultipartError> {
        let kind = content_type.split(';').next().unwrap_or_default().trim();
        let kind = kind.to_ascii_lowercase();
        if !kind.starts_with("multipart/") && !kind.is_empty() && kind != "application/octet-stream"
        {
            return Err(MultipartError::OtherType(kind));
        }
        let told = boundary(content_type).unwrap_or_default();
        Ok(Self {
            told: told.trim_start_matches('-').as_bytes().to_vec(),
            delimiter: None,
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
            let picture = match self.state {
                State::Between => match self.find_delimiter() {
                    Some((at, length)) => {
                        self.cut(at + length);
                        self.passed = 0;
                        self.state = State::Head;
                        continue;
                    }
                    None => return self.pass(),
                },
                State::Head => {
                    let Some(head) = self.head()? else {
                        return Ok(None);
                    };
                    self.state = match head.size {
                        _ if head.is_other => State::Other,
                        Some(size) => State::Sized(size),
                        None => State::Unsized,
                    };
                    continue;
                }
                State::Sized(size) if self.held.len() < size => return Ok(None),
                State::Sized(size) => match self.is_end(size) {
                    Some(true) => self.cut(size),
                    Some(false) => {
                        self.state = State::Unsized;
                        continue;
                    }
                    None => return Ok(None),
                },
                State::Unsized => match self.find_delimiter() {
                    Some((at, _)) => {
                        self.sized = false;
                        self.cut(at)
                    }
                    None if self.held.len() > MAX_PICTURE_BYTES => {
                        return Err(MultipartError::TooLarge);
                    }
                    None => {
                        self.searched = self.held.len().saturating_sub(MAX_DELIMITER_BYTES);
                        return Ok(None);
                    }
                },
                State::Other => match self.find_delimiter() {
                    Some(_) => {
                        self.state = State::Between;
                        continue;
                    }
                    None => return self.pass(),
                },
            };
            self.state = State::Between;
            let picture = trimmed(picture);
            if !picture.is_empty() {
                return Ok(Some(picture));
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

    /// Lets go what is no image, but for what may be the beginning of a delimiter.
    fn pass(&mut self) -> Result<Option<Vec<u8>>, MultipartError> {
        let keep = MAX_DELIMITER_BYTES + MAX_DELIMITER_BYTES;
        let drop = self.held.len().saturating_sub(keep);
        self.held.drain(..drop);
        self.searched = 0;
        self.passed += drop;
        match self.passed > MAX_PICTURE_BYTES {
            true => Err(MultipartError::TooLarge),
            false => Ok(None),
        }
    }

    /// Where the next delimiter begins, and its length.
    fn find_delimiter(&mut self) -> Option<(usize, usize)> {
        let Some(delimiter) = &self.delimiter else {
            let (at, length) = self.first_delimiter()?;
            self.delimiter = Some(self.held[at..at + length].to_vec());
            return Some((at, length));
        };
        let n = delimiter.len();
        let from = self.searched.min(self.held.len());
        let found = self.held[from..].windows(n).enumerate();
        let mut found = found.filter(|(_, w)| w == delimiter);
        // Without dashes it may be a word within an image, but at the beginning of a line.
        let dashed = delimiter.starts_with(b"--");
        let begins = |at: usize| dashed || at == 0 || self.held[at - 1] == b'\n';
        found
            .find(|(at, _)| begins(from + at))
            .map(|(at, _)| (from + at, n))
    }

    /// The line that begins the first part: the one that was told, with any number of dashes, or one with dashes before a head of a part.
    fn first_delimiter(&self) -> Option<(usize, usize)> {
        let mut at = 0;
        while let Some(length) = self.held[at..].iter().position(|b| *b == b'\n') {
            let line = self.held[at..at + length].trim_ascii_end();
            let next = at + length + 1;
            let dashes = line.iter().take_while(|b| **b == b'-').count();
            let word = &line[dashes..];
            let fits = line.len() <= MAX_DELIMITER_BYTES;
            if fits
                && !self.told.is_empty()
                && word.strip_suffix(b"--").unwrap_or(word) == self.told
            {
                return Some((at, dashes + self.told.len()));
            }
            let may_be = fits && dashes >= 2 && !word.is_empty();
            if may_be && word.iter().all(u8::is_ascii_graphic) {
                const HEAD: &[u8] = b"content-";
                let head = self.held[next..].iter().take(HEAD.len());
                let head: Vec<u8> = head.map(u8::to_ascii_lowercase).collect();
                if head == HEAD {
                    return Some((at, line.len()));
                }
                if HEAD.starts_with(&head) {
                    // It has not all come yet.
                    return None;
                }
            }
            at = next;
        }
        None
    }

    /// Whether an image ends after so many bytes, as it says; `None` while that cannot be told.
    fn is_end(&mut self, size: usize) -> Option<bool> {
        self.sized = is_whole(&self.held[..size]);
        if self.sized {
            return Some(true);
        }
        let behind = &self.held[size..];
        let line_ends = behind.iter().take(MAX_LINE_ENDS);
        let ends = line_ends.take_while(|b| b"\r\n".contains(*b)).count();
        let delimiter = self.delimiter.as_deref().unwrap_or_default();
        let next = &behind[ends..];
        if next.len() < delimiter.len() && delimiter.starts_with(next) {
            return None;
        }
        Some(next.starts_with(delimiter))
    }

    /// The head after a delimiter; `None` when it has not come whole. Lines in it that make no sense count for nothing.
    fn head(&mut self) -> Result<Option<Head>, MultipartError> {
        let mut head = Head::default();
        let mut first = true;
        let mut at = 0;
        loop {
            let rest = &self.held[at..];
            if !first && rest.starts_with(&SOI) {
                // Some leave out the empty line.
                break;
            }
            let Some(length) = rest.iter().position(|b| *b == b'\n') else {
                return match self.held.len() > MAX_PART_HEAD_BYTES {
                    true => Err(MultipartError::Head("it has no end".into())),
                    false => Ok(None),
                };
            };
            let line = rest[..length].trim_ascii();
            at += length + 1;
            if at > MAX_PART_HEAD_BYTES {
                return Err(MultipartError::Head("it has no end".into()));
            }
            // The first is the rest of the delimiter's line.
            if line.is_empty() && !first {
                break;
            }
            if !first {
                head.line(&String::from_utf8_lossy(line));
            }
            first = false;
        }
        self.cut(at);
        Ok(Some(head))
    }
}

impl Head {
    fn line(&mut self, line: &str) {
        let Some((name, value)) = line.split_once(':') else {
            return;
        };
        let value = value.trim();
        match name.trim().to_ascii_lowercase().as_str() {
            "content-length" if self.size.is_none() => {
                let end = value.find(|c: char| !c.is_ascii_digit());
                let size = value[..end.unwrap_or(value.len())].parse().ok();
                self.size = size.filter(|s| (1..=MAX_PICTURE_BYTES).contains(s));
            }
            "content-type" => {
                let kind = value.to_ascii_lowercase();
                let others = ["text/", "audio/", "application/json", "application/xml"];
                self.is_other = others.iter().any(|o| kind.starts_with(o));
            }
            _ => {}
        }
    }
}

/// How a JPEG begins and ends.
const SOI: [u8; 2] = [0xff, 0xd8];
const EOI: [u8; 2] = [0xff, 0xd9];
/// How a PNG ends.
const IEND: &[u8] = b"IEND\xaeB`\x82";

/// What may follow the end of a JPEG and is none of it.
fn is_filling(byte: u8) -> bool {
    matches!(byte, 0xff | 0 | b'\r' | b'\n')
}

/// How long a JPEG is without what fills it up; `None` where it has no end.
fn jpeg_length(bytes: &[u8]) -> Option<usize> {
    let last = bytes.iter().rposition(|b| !is_filling(*b))?;
    (bytes.starts_with(&SOI) && bytes[..=last].ends_with(&EOI)).then_some(last + 1)
}

/// Whether bytes end as an image does.
fn is_whole(bytes: &[u8]) -> bool {
    jpeg_length(bytes).is_some() || bytes.ends_with(IEND)
}

/// An image without the line end before a delimiter, which belongs to that, and what fills it up.
fn trimmed(mut picture: Vec<u8>) -> Vec<u8> {
    if let Some(length) = jpeg_length(&picture) {
        picture.truncate(length);
        return picture;
    }
    for end in *b"\n\r" {
        if picture.last() == Some(&end) {
            picture.pop();
        }
    }
    picture
}

/// The boundary that a content type tells: a word, or a text between quotes.
fn boundary(content_type: &str) -> Option<String> {
    let (_, mut rest) = content_type.split_once(';')?;
    loop {
        let (key, after) = rest.split_once('=')?;
        let after = after.trim_start();
        let (value, behind) = match after.strip_prefix('"') {
            Some(quoted) => quoted.split_once('"').unwrap_or((quoted, "")),
            None => after.split_once(';').unwrap_or((after, "")),
        };
        if key.trim().eq_ignore_ascii_case("boundary") {
            let value = value.trim();
            return (!value.is_empty() && value.len() <= 200).then(|| value.to_string());
        }
        rest = behind.trim_start().trim_start_matches(';');
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

    /// Two images as a camera sends them: `before` each, with `#` for its length, and `after` it.
    fn stream(before: &str, after: &str) -> Vec<u8> {
        let mut all = Vec::new();
        for picture in PICTURES {
            let before = before.replace('#', &picture.len().to_string());
            all.extend_from_slice(before.as_bytes());
            all.extend_from_slice(picture);
            all.extend_from_slice(after.as_bytes());
        }
        all.extend_from_slice(before.as_bytes());
        all
    }

    /// With what is not their end inside.
    const PICTURES: [&[u8]; 2] = [
        b"\xff\xd8\xff\xe0\r\n\r\n--fram\xff\xd9 frame\xff\xd9",
        b"\xff\xd8\r\n-\xff\xd9",
    ];

    #[track_caller]
    fn read_in_pieces(kind: &str, stream: &[u8]) {
        for piece in PIECES {
            let seen = pictures(kind, stream, piece).unwrap();
            assert_eq!(seen, PICTURES, "{piece}: {}", stream.escape_ascii());
        }
    }

    const FRAME: &str = "multipart/x-mixed-replace; boundary=frame";
    const JPEG: &str = "Content-Type: image/jpeg\r\n";

    #[test]
    fn a_boundary_is_found_however_it_is_told() {
        for kind in [
            "",
            "application/octet-stream",
            "multipart/x-mixed-replace",
            "multipart/x-mixed-replace;",
            "multipart/x-mixed-replace; boundary=",
            "multipart/x-mixed-replace; boundary=Stream",
            "multipart/x-mixed-replace; boundary=\"--frame\"; charset=x",
            "MULTIPART/mixed;charset=\"a;b\";BOUNDARY = frame ; x=y",
            "multipart/x-mixed-replace;boundary=--frame",
            FRAME,
        ] {
            for before in [
                "--frame\r\nContent-Type: image/jpeg\r\nContent-Length: #\r\n\r\n",
                "----frame\r\ncontent-length:#\r\ncontent-type:image/jpeg\r\n\r\n",
                "--frame\nContent-type: image/jpeg\n\n",
            ] {
                read_in_pieces(kind, &stream(before, "\r\n"));
                let hello = [b"HTTP\r\n--\r\n- -x\r\n".to_vec(), stream(before, "")].concat();
                read_in_pieces(kind, &hello);
            }
        }
        // Without dashes only a word that was told.
        read_in_pieces(FRAME, &stream("frame\r\nContent-Length: #\r\n\r\n", "\r\n"));
        read_in_pieces(FRAME, &stream("frame\r\n\r\n", "\r\n"));
        read_in_pieces(
            "multipart/x-mixed-replace; boundary=\"a b;c\"",
            &stream("--a b;c\r\n\r\n", "\n"),
        );
    }

    #[test]
    fn a_length_that_is_wrong_is_not_believed() {
        for length in [
            "0",
            "-1",
            "# bytes",
            "#;",
            "many",
            "",
            "1",
            "2",
            "99999999999999999999999",
            "3#",
            "99",
        ] {
            let before = format!("--frame\r\n{JPEG}Content-Length: {length}\r\n\r\n");
            // The longest wrong one takes what comes later, until there is so much.
            let mut all = stream(&before, "\r\n");
            all.extend_from_slice(&[b' '; 600]);
            for piece in PIECES {
                let seen = pictures(FRAME, &all, piece).unwrap();
                assert_eq!(seen[..2], PICTURES, "{length} {piece}");
            }
        }
        let counts: [fn(usize) -> usize; 5] =
            [|n| n - 2, |n| n - 1, |n| n + 1, |n| n + 2, |n| n + 4];
        for count in counts {
            let part = |picture: &[u8]| {
                let head = format!(
                    "--frame\r\n{JPEG}Content-Length: {}\r\n\r\n",
                    count(picture.len())
                );
                [head.as_bytes(), picture, b"\r\n"].concat()
            };
            let mut all: Vec<u8> = PICTURES.into_iter().flat_map(part).collect();
            all.extend_from_slice(b"--frame\r\n");
            read_in_pieces(FRAME, &all);
        }
    }

    #[test]
    fn a_head_may_hold_what_it_likes() {
        for head in [
            "X-Tags\r\nContent-Length: #\r\n",
            "Content-Length: #\r\nDate\r\n: no name\r\nX-\u{b5}: 1\r\n",
            "Content-Length: #\r\nContent-Length: 3\r\n continued\r\n",
            " content-LENGTH : #\r\n",
            "",
        ] {
            let before = format!("--frame\r\n{head}\r\n");
            read_in_pieces(FRAME, &stream(&before, "\r\n"));
            read_in_pieces(FRAME, &stream(&before.replace('\r', ""), "\n"));
            // No empty line behind it.
            if !head.is_empty() {
                read_in_pieces(FRAME, &stream(&format!("--frame\r\n{head}"), "\r\n"));
            }
        }
    }

    #[test]
    fn what_stands_between_two_pictures_is_passed_over() {
        for after in [
            "",
            "\r\n",
            "\n",
            "\r\n\r\n\r\n\r\n",
            "\r\n--frame--\r\n",
            "\r\n--frame\r\nContent-Type: text/plain\r\nContent-Length: 5\r\n\r\nalive\r\n",
            "\r\n--frame\r\nContent-Type: audio/basic\r\n\r\n\u{0}\u{1}\r\n",
            "\r\n--frame\r\n\r\n\r\n",
        ] {
            for head in [
                "Content-Type: image/jpeg\r\nContent-Length: #\r\n",
                "Content-Type: image/jpeg\r\n",
            ] {
                let before = format!("--frame\r\n{head}\r\n");
                read_in_pieces(FRAME, &stream(&before, after));
            }
        }
        // What fills an image up is none of it, whether it is counted or not.
        for fill in [&[0xff_u8; 8][..], &[0; 3], b"\r\n\0\xff"] {
            for counted in [fill.len(), 0] {
                let part = |picture: &[u8]| {
                    let size = picture.len() + counted;
                    let head = format!("--frame\r\nContent-Length: {size}\r\n\r\n");
                    [head.as_bytes(), picture, fill, b"\r\n"].concat()
                };
                let mut all: Vec<u8> = PICTURES.into_iter().flat_map(part).collect();
                all.extend_from_slice(b"--frame\r\n");
                read_in_pieces(FRAME, &all);
            }
        }
    }

    #[test]
    fn a_picture_of_a_known_length_is_there_before_the_next_one_begins() {
        for picture in [PICTURES[0], b"\x89PNG\r\n\x1a\n....IEND\xaeB`\x82"] {
            let mut parts = Parts::new(FRAME).unwrap();
            let head = format!("--frame\r\nContent-Length: {}\r\n\r\n", picture.len());
            parts.feed().extend_from_slice(head.as_bytes());
            parts.feed().extend_from_slice(picture);
            assert_eq!(parts.take(), Ok(Some(picture.to_vec())));
            assert!(parts.was_sized());
        }
        let mut parts = Parts::new(FRAME).unwrap();
        let wrong = b"--frame\r\nContent-Length: 4\r\n\r\n\xff\xd8..\xff\xd9\r\n--frame";
        parts.feed().extend_from_slice(wrong);
        assert_eq!(parts.take(), Ok(Some(b"\xff\xd8..\xff\xd9".to_vec())));
        assert!(!parts.was_sized());
    }

    #[test]
    fn what_is_no_stream_of_pictures_is_told() {
        assert_eq!(
            Parts::new("image/jpeg").unwrap_err(),
            MultipartError::OtherType("image/jpeg".into())
        );
        assert!(Parts::new("text/html; charset=utf-8").is_err());
        let kind = "multipart/x-mixed-replace; boundary=b";
        let long = [
            b"--b\r\nContent-Type: ".as_slice(),
            &[b'a'; 2 * MAX_PART_HEAD_BYTES],
        ]
        .concat();
        for piece in PIECES {
            let many = [&b"--b\r\n"[..], &b"X: y\r\n".repeat(2000)].concat();
            for wrong in [&long, &many] {
                let told = pictures(kind, wrong, piece).unwrap_err();
                assert!(matches!(told, MultipartError::Head(_)), "{told}");
            }
        }
    }

    #[test]
    fn nothing_piles_up_before_the_first_picture() {
        let mut parts = Parts::new("multipart/x-mixed-replace; boundary=b").unwrap();
        for _ in 0..100 {
            parts.feed().extend_from_slice(&[b'-'; 1000]);
            assert_eq!(parts.take(), Ok(None));
            assert!(parts.held.len() < 1000);
        }
        // And not for ever.
        let more = vec![b'-'; MAX_PICTURE_BYTES];
        parts.feed().extend_from_slice(&more);
        assert_eq!(parts.take(), Err(MultipartError::TooLarge));
    }
}
