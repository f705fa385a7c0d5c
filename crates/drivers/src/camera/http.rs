//! As much of HTTP/1.1 as a camera needs: one GET, its answer read piece by piece, each read with a deadline and ended by
//! closing the connection, which a camera that never stops sending needs and common client libraries do not offer.

use crate::link::{LinkError, Tcp, Transport};
use base64::Engine as _;
use scopeservo_scope::{ScopeError, visible};
use std::time::{Duration, Instant};
use thiserror::Error;

/// No image is larger.
pub const MAX_PICTURE_BYTES: usize = 64 << 20;
/// No head of an answer is larger.
const MAX_HEAD_BYTES: usize = 16 << 10;
const MAX_HEADERS: usize = 64;
/// A line before a chunk holds a number and little else.
const MAX_CHUNK_LINE_BYTES: usize = 256;
/// How much is read at once.
const READ_BYTES: usize = 64 << 10;

/// What can go wrong with a question to a camera.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum HttpError {
    /// The connection failed.
    #[error("{0}")]
    Link(#[from] LinkError),
    /// What came is not HTTP.
    #[error("it does not answer as HTTP does: {0}")]
    NotHttp(String),
    /// It answered, but not with an image.
    #[error("it answers {status} {reason}{hint}")]
    Status {
        /// The status.
        status: u16,
        /// Its words.
        reason: String,
        /// What to do.
        hint: String,
    },
    /// More than an image can have.
    #[error("its answer has more than {} MiB", MAX_PICTURE_BYTES >> 20)]
    TooLarge,
}

/// An address of the web: host, port, and what is asked for there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Url {
    host: String,
    port: u16,
    path: String,
}

impl Url {
    /// Reads `http://host:port/path?query`.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`] with what is wrong.
    pub fn parse(text: &str) -> Result<Self, ScopeError> {
        let bad = |what: &str| ScopeError::BadSetting {
            what: format!("the address '{}' {what}", without_user(text)),
        };
        let Some(rest) = text.strip_prefix("http://") else {
            return Err(bad(match text.starts_with("https://") {
                true => {
                    "asks for an encrypted connection, which is not supported: use a proxy on this machine"
                }
                false => "must begin with http://",
            }));
        };
        // A request is lines: nothing in it may end one.
        if !rest.bytes().all(|b| b.is_ascii_graphic()) {
            return Err(bad(
                "has spaces or special characters: write them as %20 and the like",
            ));
        }
        let at = rest.find(['/', '?']).unwrap_or(rest.len());
        let (place, path) = rest.split_at(at);
        if place.contains('@') {
            return Err(bad(
                "holds a user: put the name into user and the password into password_file",
            ));
        }
        let path = path.split('#').next().unwrap_or_default();
        let path = match path.starts_with('/') {
            true => path.to_string(),
            false => format!("/{path}"),
        };
        // Only a colon after the brackets of an IPv6 address begins a port.
        let after = place.rfind(']').map_or(0, |b| b + 1);
        let (host, port) = match place[after..].rfind(':') {
            Some(colon) => {
                let port = place[after + colon + 1..].parse().ok().filter(|p| *p > 0);
                let port = port.ok_or_else(|| bad("has no port that is a number up to 65535"))?;
                (&place[..after + colon], port)
            }
            None => (place, 80),
        };
        if host.is_empty() {
            return Err(bad("names no host"));
        }
        Ok(Self {
            host: host.to_string(),
            port,
            path,
        })
    }

    /// "host:port", for connecting.
    pub fn place(&self) -> String {
        format!("{}:{}", self.host, self.port)
    }
}

impl std::fmt::Display for Url {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let path = without_query(&self.path);
        write!(f, "http://{}:{}{path}", self.host, self.port)
    }
}

/// An address as it may be shown: without the password that somebody wrote into it, and without a query, which may hold one, too.
fn without_user(text: &str) -> String {
    let shown = match text.rfind('@') {
        Some(at) => format!("...{}", &text[at..]),
        None => text.to_string(),
    };
    without_query(&shown)
}

fn without_query(text: &str) -> String {
    match text.split_once('?') {
        Some((path, _)) => format!("{path}?..."),
        None => text.to_string(),
    }
}

/// Name and password, for Basic authentication.
#[derive(Clone, PartialEq, Eq)]
pub struct Login {
    /// The name.
    pub user: String,
    /// The password.
    pub password: String,
}

impl std::fmt::Debug for Login {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Login({})", self.user)
    }
}

/// The bytes of a question.
pub fn encode_get(url: &Url, login: Option<&Login>) -> Vec<u8> {
    let login = login.map_or(String::new(), |l| {
        let both = format!("{}:{}", l.user, l.password);
        let coded = base64::engine::general_purpose::STANDARD.encode(both);
        format!("Authorization: Basic {coded}\r\n")
    });
    format!(
        "GET {} HTTP/1.1\r\nHost: {}:{}\r\nUser-Agent: scopeservo\r\nAccept: */*\r\n{login}Connection: close\r\n\r\n",
        url.path, url.host, url.port
    )
    .into_bytes()
}

/// The head of an answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Head {
    /// 200 when all is well.
    pub status: u16,
    /// Its words.
    pub reason: String,
    /// What follows: `image/jpeg`, `multipart/x-mixed-replace; boundary=...`.
    pub content_type: String,
    /// Where else to ask.
    location: Option<String>,
    /// How it wants to know who asks.
    authenticate: Option<String>,
    coding: Coding,
}

/// How the end of a body is told.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Coding {
    /// So many bytes are still to come.
    Length(u64),
    Chunked(Chunk),
    /// When the connection ends.
    UntilClosed,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Chunk {
    /// The line with the size of the next one, as far as it came.
    Size(Vec<u8>),
    /// So many bytes of it are still to come.
    Data(u64),
    /// The line end after it: so many bytes still.
    End(u8),
    /// The last one has come.
    Over,
}

/// The head at the start of `bytes` and how many bytes it has; `None` when it has not come whole.
///
/// # Errors
/// [`HttpError::NotHttp`].
pub fn decode_head(bytes: &[u8]) -> Result<Option<(Head, usize)>, HttpError> {
    let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
    let mut answer = httparse::Response::new(&mut headers);
    let not_http = |what: String| HttpError::NotHttp(what);
    // As browsers do: a line that is no header counts for nothing.
    let lenient = httparse::ParserConfig::default()
        .ignore_invalid_headers_in_responses(true)
        .allow_spaces_after_header_name_in_responses(true)
        .allow_obsolete_multiline_headers_in_responses(true)
        .clone();
    let length = match lenient.parse_response(&mut answer, bytes) {
        Ok(httparse::Status::Complete(length)) => length,
        Ok(httparse::Status::Partial) if bytes.len() >= MAX_HEAD_BYTES => {
            return Err(not_http(format!(
                "its head has more than {MAX_HEAD_BYTES} bytes"
            )));
        }
        Ok(httparse::Status::Partial) => return Ok(None),
        Err(error) => return Err(not_http(error.to_string())),
    };
    let header = |name: &str| {
        let found = answer
            .headers
            .iter()
            .find(|h| h.name.eq_ignore_ascii_case(name))?;
        std::str::from_utf8(found.value).ok().map(str::trim)
    };
    let chunked = header("Transfer-Encoding").is_some_and(|v| !v.eq_ignore_ascii_case("identity"));
    // What has no end has no length, whatever it says.
    let kind = header("Content-Type").unwrap_or_default();
    let stream = kind.to_ascii_lowercase().starts_with("multipart/");
    let coding = match (chunked, header("Content-Length")) {
        (true, _) => Coding::Chunked(Chunk::Size(Vec::new())),
        (false, _) if stream => Coding::UntilClosed,
        (false, Some(text)) => Coding::Length(
            text.parse()
                .map_err(|_| not_http(format!("a length of '{text}'")))?,
        ),
        (false, None) => Coding::UntilClosed,
    };
    let head = Head {
        status: answer.code.unwrap_or(0),
        reason: answer.reason.unwrap_or_default().to_string(),
        content_type: kind.to_string(),
        location: header("Location").map(str::to_string),
        authenticate: header("WWW-Authenticate").map(str::to_string),
        coding,
    };
    Ok(Some((head, length)))
}

impl Head {
    /// Whether an image may follow.
    ///
    /// # Errors
    /// [`HttpError::Status`] with what to do.
    pub fn check(&self, login: Option<&Login>) -> Result<(), HttpError> {
        let hint = match self.status {
            200 => return Ok(()),
            301 | 302 | 303 | 307 | 308 => match &self.location {
                Some(there) => format!("; ask at {there} instead"),
                None => String::new(),
            },
            401 => match &self.authenticate {
                Some(how) if !how.to_ascii_lowercase().starts_with("basic") => {
                    "; it wants to know who asks in a way that is not supported: allow Basic authentication in its settings".into()
                }
                _ if login.is_some() => {
                    "; the user, or the password in password_file, is not the right one".into()
                }
                _ => "; it wants to know who asks: set user and password_file (beside settings)"
                    .into(),
            },
            403 => "; it does not let this machine or this user in".into(),
            404 => "; it has no such path: look into its manual for the address of the image"
                .into(),
            503 => "; it serves others already: close them".into(),
            _ => String::new(),
        };
        Err(HttpError::Status {
            status: self.status,
            reason: visible(&self.reason),
            hint: visible(&hint),
        })
    }

    /// Takes what belongs to the body from the start of `input`, and returns how much of the input that was.
    ///
    /// # Errors
    /// [`HttpError::NotHttp`].
    pub fn take_body(&mut self, input: &[u8], body: &mut Vec<u8>) -> Result<usize, HttpError> {
        let mut used = 0;
        let mut copy = |left: &mut u64, used: &mut usize| {
            let n = (input.len() - *used).min(usize::try_from(*left).unwrap_or(usize::MAX));
            body.extend_from_slice(&input[*used..*used + n]);
            *left -= n as u64;
            *used += n;
        };
        match &mut self.coding {
            Coding::UntilClosed => copy(&mut { u64::MAX }, &mut used),
            Coding::Length(left) => copy(left, &mut used),
            Coding::Chunked(chunk) => {
                while used < input.len() {
                    match chunk {
                        Chunk::Over => return Ok(input.len()),
                        Chunk::Data(left) => {
                            copy(left, &mut used);
                            if *left == 0 {
                                *chunk = Chunk::End(2);
                            }
                        }
                        Chunk::End(left) => {
                            *left -= 1;
                            used += 1;
                            if *left == 0 {
                                *chunk = Chunk::Size(Vec::new());
                            }
                        }
                        Chunk::Size(line) => {
                            line.push(input[used]);
                            used += 1;
                            let size = match httparse::parse_chunk_size(line) {
                                Ok(httparse::Status::Complete((_, size))) => size,
                                Ok(httparse::Status::Partial)
                                    if line.len() < MAX_CHUNK_LINE_BYTES =>
                                {
                                    continue;
                                }
                                _ => {
                                    return Err(HttpError::NotHttp(
                                        "the size of a chunk is no number".into(),
                                    ));
                                }
                            };
                            *chunk = match size {
                                0 => Chunk::Over,
                                size => Chunk::Data(size),
                            };
                        }
                    }
                }
            }
        }
        Ok(used)
    }

    /// Whether the whole body has come. Only the end of the connection tells for some.
    pub fn body_is_whole(&self) -> bool {
        matches!(
            self.coding,
            Coding::Length(0) | Coding::Chunked(Chunk::Over)
        )
    }
}

/// An answer under way.
pub struct Answer {
    tcp: Tcp,
    /// Its head.
    pub head: Head,
    /// Came with the head, and is not taken yet.
    rest: Vec<u8>,
}

impl Answer {
    /// Asks, and waits for the head of the answer.
    ///
    /// # Errors
    /// [`HttpError`], also for a status other than 200.
    pub fn get(url: &Url, login: Option<&Login>, timeout: Duration) -> Result<Self, HttpError> {
        let tcp = Tcp::connect(&url.place(), timeout)?;
        tcp.write(&encode_get(url, login))?;
        let deadline = Instant::now() + timeout;
        let mut bytes = Vec::new();
        let mut chunk = [0; 4096];
        loop {
            let n = tcp.read(&mut chunk, deadline)?;
            bytes.extend_from_slice(&chunk[..n]);
            if let Some((head, length)) = decode_head(&bytes)? {
                head.check(login)?;
                bytes.drain(..length);
                return Ok(Self {
                    tcp,
                    head,
                    rest: bytes,
                });
            }
        }
    }

    /// Appends what comes next to `body`, waiting for it until `deadline`. `false` when the body has ended.
    ///
    /// # Errors
    /// [`LinkError::Silence`] when nothing came in time, and as [`Answer::get`].
    pub fn more(&mut self, body: &mut Vec<u8>, deadline: Instant) -> Result<bool, HttpError> {
        if self.head.body_is_whole() {
            return Ok(false);
        }
        if self.rest.is_empty() {
            let mut chunk = vec![0; READ_BYTES];
            match self.tcp.read(&mut chunk, deadline) {
                Ok(n) => self.rest.extend_from_slice(&chunk[..n]),
                Err(LinkError::Closed) if self.head.coding == Coding::UntilClosed => {
                    return Ok(false);
                }
                Err(error) => return Err(error.into()),
            }
        }
        let rest = std::mem::take(&mut self.rest);
        let used = self.head.take_body(&rest, body)?;
        // What comes after the body is nobody's.
        if !self.head.body_is_whole() {
            self.rest.extend_from_slice(&rest[used..]);
        }
        Ok(true)
    }

    /// The whole body.
    ///
    /// # Errors
    /// [`HttpError::TooLarge`], and as [`Answer::more`].
    pub fn whole(mut self, timeout: Duration) -> Result<Vec<u8>, HttpError> {
        let deadline = Instant::now() + timeout;
        let mut body = Vec::new();
        while self.more(&mut body, deadline)? {
            if body.len() > MAX_PICTURE_BYTES {
                return Err(HttpError::TooLarge);
            }
        }
        Ok(body)
    }
}

impl Drop for Answer {
    fn drop(&mut self) {
        self.tcp.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read() {
        let url = |text: &str| Url::parse(text).map(|u| (u.place(), u.path));
        let ok = |place: &str, path: &str| Ok((place.to_string(), path.to_string()));
        assert_eq!(url("http://cam"), ok("cam:80", "/"));
        assert_eq!(url("http://cam:8080?x=1"), ok("cam:8080", "/?x=1"));
        assert_eq!(url("http://[::1]:81/a/b?c#d"), ok("[::1]:81", "/a/b?c"));
        assert_eq!(url("http://[::1]/"), ok("[::1]:80", "/"));
        for (wrong, why) in [
            ("https://cam/", "encrypted"),
            ("cam/picture", "must begin with http://"),
            ("http:///picture", "names no host"),
            ("http://cam:0/", "no port"),
            ("http://cam:70000/", "no port"),
            ("http://cam/a b", "%20"),
            ("http://cam/a\r\nX: y", "%20"),
            ("http://me:secret@cam/", "password_file"),
            ("http://cam:0/?pwd=secret", "no port"),
        ] {
            let error = Url::parse(wrong).expect_err(wrong).to_string();
            assert!(error.contains(why) && !error.contains("secret"), "{error}");
        }
    }

    #[test]
    fn a_query_is_asked_for_and_not_shown() {
        let url = Url::parse("http://cam/shot?user=me&pwd=secret").unwrap();
        assert_eq!(url.to_string(), "http://cam:80/shot?...");
        assert!(String::from_utf8_lossy(&encode_get(&url, None)).contains("pwd=secret"));
    }

    #[test]
    fn a_question_is_one_request() {
        let url = Url::parse("http://cam:81/shot?q=9").unwrap();
        let login = Login {
            user: "me".into(),
            password: "secret".into(),
        };
        let text = String::from_utf8(encode_get(&url, Some(&login))).unwrap();
        assert!(text.starts_with("GET /shot?q=9 HTTP/1.1\r\nHost: cam:81\r\n"));
        assert!(text.contains("\r\nAuthorization: Basic bWU6c2VjcmV0\r\n"));
        assert!(text.ends_with("\r\nConnection: close\r\n\r\n"));
        assert!(!format!("{login:?}").contains("secret"));
    }

    /// An answer in pieces of `piece` bytes: its body and whether it is whole.
    fn body(answer: &[u8], piece: usize) -> Result<(Vec<u8>, bool), HttpError> {
        let (mut head, length) = decode_head(answer)?.expect("a whole head");
        let mut body = Vec::new();
        for chunk in answer[length..].chunks(piece) {
            let mut chunk = chunk;
            while !chunk.is_empty() && !head.body_is_whole() {
                let used = head.take_body(chunk, &mut body)?;
                chunk = &chunk[used..];
            }
        }
        Ok((body, head.body_is_whole()))
    }

    #[test]
    fn bodies_come_whole_however_they_are_sent_and_cut() {
        let length = b"HTTP/1.1 200 OK\r\ncontent-length: 5\r\n\r\npixelsand more";
        let chunked = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n3\r\npix\r\n2;a=b\r\nel\r\n0\r\n\r\n";
        let open = b"HTTP/1.0 200 OK\r\nContent-Type: image/jpeg\r\n\r\npixel";
        for piece in [1, 2, 3, 7, 100] {
            assert_eq!(body(length, piece).unwrap(), (b"pixel".to_vec(), true));
            assert_eq!(body(chunked, piece).unwrap(), (b"pixel".to_vec(), true));
            assert_eq!(body(open, piece).unwrap(), (b"pixel".to_vec(), false));
        }
        let cut = &chunked[..chunked.len() - 7];
        assert_eq!(body(cut, 100).unwrap(), (b"pixel".to_vec(), false));
        let wrong = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nxyz\r\npix\r\n";
        assert!(matches!(body(wrong, 1), Err(HttpError::NotHttp(_))));
        let endless = [
            b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n3;".as_slice(),
            &[b'a'; 1000],
        ]
        .concat();
        assert!(matches!(body(&endless, 100), Err(HttpError::NotHttp(_))));
    }

    #[test]
    fn heads_are_read_or_refused() {
        assert_eq!(decode_head(b"HTTP/1.1 200 OK\r\nContent-"), Ok(None));
        let long = [b"HTTP/1.1 200 OK\r\nX: ".as_slice(), &[b'a'; 20_000]].concat();
        for wrong in [
            b"+OK POP3\r\n\r\n".as_slice(),
            b"HTTP/1.1 200 OK\r\nContent-Length: -4\r\n\r\n",
            &long,
        ] {
            assert!(matches!(decode_head(wrong), Err(HttpError::NotHttp(_))));
        }
        let refused = |text: &str| {
            let (head, _) = decode_head(text.as_bytes()).unwrap().unwrap();
            head.check(None).expect_err(text).to_string()
        };
        let moved = refused("HTTP/1.1 301 Moved\r\nLocation: http://cam/x\r\n\r\n");
        assert!(moved.contains("ask at http://cam/x"), "{moved}");
        let basic = refused("HTTP/1.1 401 No\r\nWWW-Authenticate: Basic realm=\"c\"\r\n\r\n");
        assert!(basic.contains("set user and password_file"), "{basic}");
        let digest = refused("HTTP/1.1 401 No\r\nWWW-Authenticate: Digest realm=\"c\"\r\n\r\n");
        assert!(digest.contains("allow Basic"), "{digest}");
    }
}
