//! Messages on a stream: a line of JSON, and raw bytes behind a reply that announces them.

use serde_json::{Map, Value};
use std::io::{self, BufRead, Write};
use thiserror::Error;

/// The longest line, its end included.
pub const MAX_LINE: usize = 65_536;

/// A JSON object.
pub type Object = Map<String, Value>;

/// What is not a message.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum WireError {
    /// The stream failed.
    #[error("the connection failed: {0}")]
    Io(#[from] io::Error),
    /// A line has no end within [`MAX_LINE`].
    #[error("a line is longer than {MAX_LINE} bytes")]
    TooLong,
    /// The stream ended within a message.
    #[error("the connection ended in the middle of a message")]
    Cut,
    /// A line is no JSON object.
    #[error("a line is no JSON object: {0}")]
    NotAnObject(String),
}

/// Reads one line and parses it; `None` when the stream has ended. Never takes more memory than [`MAX_LINE`].
///
/// # Errors
/// [`WireError`]; the stream is of no further use then, but for [`WireError::NotAnObject`].
pub fn read_line(stream: &mut impl BufRead) -> Result<Option<Object>, WireError> {
    let mut line = Vec::new();
    loop {
        let buffer = match stream.fill_buf() {
            Ok(buffer) => buffer,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error.into()),
        };
        if buffer.is_empty() {
            return match line.is_empty() {
                true => Ok(None),
                false => Err(WireError::Cut),
            };
        }
        let end = buffer.iter().position(|&b| b == b'\n');
        let taken = end.map_or(buffer.len(), |at| at + 1);
        if line.len() + taken > MAX_LINE {
            return Err(WireError::TooLong);
        }
        line.extend_from_slice(&buffer[..taken]);
        stream.consume(taken);
        if end.is_some() {
            return parse(&line).map(Some);
        }
    }
}

/// A line as an object.
///
/// # Errors
/// [`WireError::NotAnObject`].
pub fn parse(line: &[u8]) -> Result<Object, WireError> {
    serde_json::from_slice(line).map_err(|error| WireError::NotAnObject(error.to_string()))
}

/// Reads exactly as many raw bytes as were agreed on.
///
/// # Errors
/// [`WireError::Cut`] and [`WireError::Io`].
pub fn read_bytes(stream: &mut impl BufRead, count: usize) -> Result<Vec<u8>, WireError> {
    let mut bytes = vec![0; count];
    match stream.read_exact(&mut bytes) {
        Ok(()) => Ok(bytes),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Err(WireError::Cut),
        Err(error) => Err(error.into()),
    }
}

/// Writes one line and, behind it, raw bytes.
///
/// # Errors
/// Those of the stream.
pub fn write(
    stream: &mut impl Write,
    message: &impl serde::Serialize,
    bytes: &[u8],
) -> io::Result<()> {
    // One write per line: a line must not arrive in pieces when the other side reads them one by one.
    let mut line = serde_json::to_vec(message)?;
    line.push(b'\n');
    stream.write_all(&line)?;
    stream.write_all(bytes)?;
    stream.flush()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::BufReader;

    fn lines(bytes: &[u8], at_a_time: usize) -> Vec<Result<Option<Object>, WireError>> {
        let mut stream = BufReader::with_capacity(at_a_time, bytes);
        let mut out = Vec::new();
        loop {
            let line = read_line(&mut stream);
            let last = matches!(
                line,
                Ok(None) | Err(WireError::TooLong | WireError::Cut | WireError::Io(_))
            );
            out.push(line);
            if last {
                return out;
            }
        }
    }

    #[test]
    fn a_line_is_the_same_in_pieces_of_any_size() {
        let bytes = b"{\"id\":1,\"ok\":true}\r\n{\"id\":2}\n";
        for at_a_time in [1, 2, 7, 64] {
            let all = lines(bytes, at_a_time);
            assert_eq!(all.len(), 3);
            assert_eq!(all[0].as_ref().unwrap().as_ref().unwrap()["id"], 1);
            assert_eq!(all[1].as_ref().unwrap().as_ref().unwrap()["id"], 2);
            assert!(matches!(all[2], Ok(None)));
        }
    }

    #[test]
    fn what_is_no_message_says_so_and_takes_no_memory() {
        for (bytes, word) in [
            (&b"{\"id\":1"[..], "middle"),
            (b"hello\n", "no JSON object"),
            (b"[1]\n", "no JSON object"),
            (b"\n", "no JSON object"),
            (b"\xff\xfe{}\n", "no JSON object"),
            (b"{\"id\":1}{\"id\":2}\n", "no JSON object"),
        ] {
            let first = lines(bytes, 3).swap_remove(0).unwrap_err().to_string();
            assert!(first.contains(word), "{first}");
        }
        let endless = vec![b' '; 10 * MAX_LINE];
        assert!(matches!(lines(&endless, 4096)[0], Err(WireError::TooLong)));
        let deep = [b'['].repeat(60_000);
        let deep = [b"{\"a\":", &deep[..], b"\n"].concat();
        assert!(matches!(
            lines(&deep, 4096)[0],
            Err(WireError::NotAnObject(_))
        ));
        let mut whole = vec![b' '; MAX_LINE - 3];
        whole.extend_from_slice(b"{}\n");
        assert!(matches!(lines(&whole, 4096)[0], Ok(Some(_))));
    }

    #[test]
    fn bytes_follow_their_line() {
        let mut out = Vec::new();
        write(
            &mut out,
            &serde_json::json!({"id": 3, "bytes": 4}),
            b"\n{}\n",
        )
        .unwrap();
        let mut stream = BufReader::with_capacity(2, &out[..]);
        assert_eq!(read_line(&mut stream).unwrap().unwrap()["bytes"], 4);
        assert_eq!(read_bytes(&mut stream, 4).unwrap(), b"\n{}\n");
        assert!(matches!(read_line(&mut stream), Ok(None)));
        let mut short = BufReader::new(&b"ab"[..]);
        assert!(matches!(read_bytes(&mut short, 3), Err(WireError::Cut)));
    }
}
