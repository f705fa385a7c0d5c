//! Bytes to and from a device: TCP, and serial ports with the feature `serial`.
//!
//! A [`Transport`] can be read by one thread while another writes. A [`LineReader`] cuts what comes into lines, within a
//! time and within a length, whatever the other side sends.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};
use thiserror::Error;

/// What can go wrong with a link.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum LinkError {
    /// No connection could be made.
    #[error("no connection to {to}: {why}")]
    NoConnection {
        /// Address or port.
        to: String,
        /// The system's words.
        why: String,
    },
    /// Nothing came in time.
    #[error("no answer came in time")]
    Silence,
    /// A line was begun but not ended in time.
    #[error("the answer stopped in the middle of a line, after {bytes} bytes")]
    HalfLine {
        /// How many bytes of the line had come.
        bytes: usize,
    },
    /// A line longer than any that this device sends.
    #[error("the answer has a line of more than {limit} bytes")]
    LineTooLong {
        /// The longest line allowed, in bytes.
        limit: usize,
    },
    /// Bytes that are not printable ASCII.
    #[error("the answer is not text: '{line}'")]
    Garbage {
        /// What came, such bytes as their codes.
        line: String,
    },
    /// The other side ended the connection.
    #[error("the other side closed the connection")]
    Closed,
    /// The system reported a fault.
    #[error("the connection failed: {0}")]
    Io(String),
}

impl From<std::io::Error> for LinkError {
    fn from(error: std::io::Error) -> Self {
        match error.kind() {
            ErrorKind::ConnectionReset
            | ErrorKind::ConnectionAborted
            | ErrorKind::BrokenPipe
            | ErrorKind::NotConnected
            | ErrorKind::UnexpectedEof => Self::Closed,
            _ => Self::Io(error.to_string()),
        }
    }
}

/// A way to a device. Reading and writing may go on at once in two threads; two threads that write at once must agree
/// between themselves.
pub trait Transport: Send + Sync {
    /// Reads what is there, at least one byte, waiting for it until `deadline`.
    ///
    /// # Errors
    /// [`LinkError::Silence`] when nothing came in time, [`LinkError::Closed`], [`LinkError::Io`].
    fn read(&self, into: &mut [u8], deadline: Instant) -> Result<usize, LinkError>;
    /// Writes all bytes.
    ///
    /// # Errors
    /// [`LinkError::Closed`], [`LinkError::Io`], also when the other side does not take the bytes within a second.
    fn write(&self, bytes: &[u8]) -> Result<(), LinkError>;
    /// Ends the connection. Reads and writes fail from now on.
    fn close(&self);
}

/// How long a few bytes may take to be sent.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// Time left until `deadline`; `None` when it has passed.
fn left(deadline: Instant) -> Option<Duration> {
    deadline
        .checked_duration_since(Instant::now())
        .filter(|d| !d.is_zero())
}

/// What a read with a time limit came to: `None` to try again.
fn read_outcome(outcome: std::io::Result<usize>) -> Option<Result<usize, LinkError>> {
    match outcome {
        Ok(0) => Some(Err(LinkError::Closed)),
        Ok(n) => Some(Ok(n)),
        Err(e) => match e.kind() {
            ErrorKind::WouldBlock | ErrorKind::TimedOut => Some(Err(LinkError::Silence)),
            ErrorKind::Interrupted => None,
            _ => Some(Err(e.into())),
        },
    }
}

/// A TCP connection.
#[derive(Debug)]
pub struct Tcp(TcpStream);

impl Tcp {
    /// Connects to `address`, "host:port", waiting at most `timeout` for each address that the name stands for.
    ///
    /// # Errors
    /// [`LinkError::NoConnection`].
    pub fn connect(address: &str, timeout: Duration) -> Result<Self, LinkError> {
        let refused = |why: String| LinkError::NoConnection {
            to: address.to_string(),
            why,
        };
        let mut why = "the name has no address".to_string();
        for socket in address
            .to_socket_addrs()
            .map_err(|e| refused(e.to_string()))?
        {
            match TcpStream::connect_timeout(&socket, timeout) {
                Ok(stream) => return Self::over(stream).map_err(|e| refused(e.to_string())),
                Err(e) => why = e.to_string(),
            }
        }
        Err(refused(why))
    }

    fn over(stream: TcpStream) -> Result<Self, LinkError> {
        // A command of a few bytes must not wait for more.
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
        Ok(Self(stream))
    }
}

impl Transport for Tcp {
    fn read(&self, into: &mut [u8], deadline: Instant) -> Result<usize, LinkError> {
        loop {
            let Some(wait) = left(deadline) else {
                return Err(LinkError::Silence);
            };
            self.0.set_read_timeout(Some(wait))?;
            if let Some(outcome) = read_outcome((&self.0).read(into)) {
                return outcome;
            }
        }
    }
    fn write(&self, bytes: &[u8]) -> Result<(), LinkError> {
        (&self.0).write_all(bytes)?;
        Ok(())
    }
    fn close(&self) {
        // It may be closed already.
        let _ = self.0.shutdown(Shutdown::Both);
    }
}

#[cfg(feature = "serial")]
pub use serial::Serial;

#[cfg(feature = "serial")]
mod serial {
    use super::*;
    use serialport::SerialPort;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::{Mutex, PoisonError};

    /// A serial port, 8 data bits, no parity, one stop bit, no flow control.
    pub struct Serial {
        reader: Mutex<Box<dyn SerialPort>>,
        writer: Mutex<Box<dyn SerialPort>>,
        closed: AtomicBool,
    }

    /// How often a waiting read looks whether the port was closed.
    const LOOK: Duration = Duration::from_millis(20);

    impl Serial {
        /// Opens the port, e.g. "/dev/ttyACM0" or "COM3". Boards with a USB bridge may restart when that happens.
        ///
        /// # Errors
        /// [`LinkError::NoConnection`].
        pub fn open(port: &str, bits_per_second: u32) -> Result<Self, LinkError> {
            let refused = |e: serialport::Error| LinkError::NoConnection {
                to: port.to_string(),
                why: e.to_string(),
            };
            let reader = serialport::new(port, bits_per_second)
                .timeout(LOOK)
                .open()
                .map_err(refused)?;
            let mut writer = reader.try_clone().map_err(refused)?;
            writer.set_timeout(WRITE_TIMEOUT).map_err(refused)?;
            Ok(Self {
                reader: Mutex::new(reader),
                writer: Mutex::new(writer),
                closed: AtomicBool::new(false),
            })
        }
    }

    impl Transport for Serial {
        fn read(&self, into: &mut [u8], deadline: Instant) -> Result<usize, LinkError> {
            let mut port = self.reader.lock().unwrap_or_else(PoisonError::into_inner);
            loop {
                if self.closed.load(Ordering::SeqCst) {
                    return Err(LinkError::Closed);
                }
                let Some(wait) = left(deadline) else {
                    return Err(LinkError::Silence);
                };
                // Whole milliseconds at least, or some systems do not wait at all.
                let wait = wait.clamp(Duration::from_millis(1), LOOK);
                port.set_timeout(wait)
                    .map_err(|e| LinkError::Io(e.to_string()))?;
                match read_outcome(port.read(into)) {
                    None | Some(Err(LinkError::Silence)) => {}
                    Some(outcome) => return outcome,
                }
            }
        }
        fn write(&self, bytes: &[u8]) -> Result<(), LinkError> {
            if self.closed.load(Ordering::SeqCst) {
                return Err(LinkError::Closed);
            }
            let mut port = self.writer.lock().unwrap_or_else(PoisonError::into_inner);
            port.write_all(bytes)?;
            port.flush()?;
            Ok(())
        }
        fn close(&self) {
            self.closed.store(true, Ordering::SeqCst);
        }
    }
}

/// Cuts bytes into lines that end in LF. It never holds more than one line of the greatest length and one read.
#[derive(Debug)]
pub struct LineReader {
    held: Vec<u8>,
    /// How much of `held` has been searched for an LF.
    searched: usize,
    max_line_bytes: usize,
}

/// How much is read at once.
const CHUNK_BYTES: usize = 256;

impl LineReader {
    /// For lines of at most `max_line_bytes` bytes, the LF not counted.
    pub fn new(max_line_bytes: usize) -> Self {
        Self {
            held: Vec::with_capacity(max_line_bytes + CHUNK_BYTES),
            searched: 0,
            max_line_bytes,
        }
    }

    /// Whether bytes have come that no call has taken.
    pub fn has_more(&self) -> bool {
        !self.held.is_empty()
    }

    /// The next line as it came, without its LF and a CR before it.
    ///
    /// # Errors
    /// [`LinkError::Silence`] or [`LinkError::HalfLine`] when `deadline` passes first, [`LinkError::LineTooLong`],
    /// [`LinkError::Closed`], [`LinkError::Io`].
    pub fn bytes(&mut self, from: &dyn Transport, deadline: Instant) -> Result<Vec<u8>, LinkError> {
        loop {
            if let Some(at) = self.held[self.searched..].iter().position(|b| *b == b'\n') {
                let end = self.searched + at;
                let mut line: Vec<u8> = self.held.drain(..=end).take(end).collect();
                self.searched = 0;
                if line.last() == Some(&b'\r') {
                    line.pop();
                }
                if line.len() > self.max_line_bytes {
                    return Err(self.too_long());
                }
                return Ok(line);
            }
            self.searched = self.held.len();
            // A CR may stand before the LF that has not come yet.
            if self.held.len() > self.max_line_bytes + 1 {
                return Err(self.too_long());
            }
            let mut chunk = [0; CHUNK_BYTES];
            match from.read(&mut chunk, deadline) {
                Ok(n) => self.held.extend_from_slice(&chunk[..n.min(CHUNK_BYTES)]),
                Err(LinkError::Silence) if self.has_more() => {
                    return Err(LinkError::HalfLine {
                        bytes: self.held.len(),
                    });
                }
                Err(e) => return Err(e),
            }
        }
    }

    /// The next line as text.
    ///
    /// # Errors
    /// As [`LineReader::bytes`], and [`LinkError::Garbage`] when it holds anything but printable ASCII and tabs.
    pub fn text(&mut self, from: &dyn Transport, deadline: Instant) -> Result<String, LinkError> {
        let line = self.bytes(from, deadline)?;
        ascii(line)
    }

    fn too_long(&self) -> LinkError {
        LinkError::LineTooLong {
            limit: self.max_line_bytes,
        }
    }
}

fn is_text(byte: u8) -> bool {
    byte == b'\t' || (b' '..=b'~').contains(&byte)
}

/// A line as text.
///
/// # Errors
/// [`LinkError::Garbage`] when it holds anything but printable ASCII and tabs.
pub fn ascii(line: Vec<u8>) -> Result<String, LinkError> {
    match line.iter().all(|b| is_text(*b)) {
        true => Ok(shown(&line)),
        false => Err(LinkError::Garbage { line: shown(&line) }),
    }
}

/// A line as it may be shown: bytes that are no text as their codes, and no more than a line of a terminal holds.
pub fn shown(line: &[u8]) -> String {
    let mut shown = String::with_capacity(line.len());
    for byte in line {
        match is_text(*byte) {
            true => shown.push(char::from(*byte)),
            false => shown.push_str(&format!("\\x{byte:02x}")),
        }
    }
    shown
}

/// A line from a board on a wire that is not free of noise. What is no text counts for nothing around a line: bytes of a start, and fillings
/// between two lines. Within it, it stays, as its codes, so that no number is read out of what was damaged. `None` when nothing else came.
pub fn past_noise(line: &[u8]) -> Option<String> {
    let begin = line.iter().position(|b| is_text(*b))?;
    // Behind a number a byte may have been a digit.
    let fills = |b: &u8| b.is_ascii_control();
    let end = line.iter().rposition(|b| !fills(b))?;
    Some(shown(line.get(begin..=end)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;
    use std::thread;

    const TIMEOUT: Duration = Duration::from_millis(150);

    /// A connection to a peer that does as told and then keeps the connection open for a while.
    fn peer(acts: impl FnOnce(&mut TcpStream) + Send + 'static) -> Tcp {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            stream.set_nodelay(true).unwrap();
            acts(&mut stream);
        });
        Tcp::connect(&address, Duration::from_secs(2)).unwrap()
    }

    /// Keeps a peer's connection open for longer than any test waits.
    fn stay() {
        thread::sleep(Duration::from_secs(3));
    }

    /// The first line within the time-out, how long that took, and what the reader holds afterwards. Whoever waits longer than that is told of the
    /// end of the connection instead.
    fn line(tcp: &Tcp, max: usize) -> (Result<String, LinkError>, Duration, usize) {
        let mut reader = LineReader::new(max);
        let start = Instant::now();
        let answer = reader.text(tcp, start + TIMEOUT);
        (answer, start.elapsed(), reader.held.capacity())
    }

    #[test]
    fn lines_come_whole_however_they_are_cut() {
        let tcp = peer(|s| {
            for byte in b"one\r\ntwo\n\nlast \n" {
                s.write_all(&[*byte]).unwrap();
                thread::sleep(Duration::from_millis(2));
            }
            stay();
        });
        let mut reader = LineReader::new(8);
        let deadline = Instant::now() + Duration::from_secs(2);
        for want in ["one", "two", "", "last "] {
            assert_eq!(reader.text(&tcp, deadline).unwrap(), want);
        }
        assert!(!reader.has_more());
    }

    #[test]
    fn silence_is_told_within_the_time_out() {
        let (answer, took, _) = line(&peer(|_| stay()), 80);
        assert_eq!(answer, Err(LinkError::Silence));
        assert!(took >= TIMEOUT);
    }

    #[test]
    fn half_a_line_is_told_within_the_time_out() {
        let tcp = peer(|s| {
            s.write_all(b"X=1.").unwrap();
            stay();
        });
        let (answer, _, _) = line(&tcp, 80);
        assert_eq!(answer, Err(LinkError::HalfLine { bytes: 4 }));
    }

    #[test]
    fn a_byte_now_and_then_does_not_put_off_the_time_out() {
        let tcp = peer(|s| {
            for _ in 0..200 {
                if s.write_all(b"1").is_err() {
                    return;
                }
                thread::sleep(Duration::from_millis(10));
            }
        });
        let (answer, _, _) = line(&tcp, 800);
        assert!(
            matches!(answer, Err(LinkError::HalfLine { .. })),
            "{answer:?}"
        );
    }

    #[test]
    fn an_endless_line_is_cut_off_without_keeping_it() {
        let tcp = peer(|s| while s.write_all(&[b'7'; 4096]).is_ok() {});
        let (answer, _, held) = line(&tcp, 80);
        assert_eq!(answer, Err(LinkError::LineTooLong { limit: 80 }));
        assert!(held <= 2 * (80 + CHUNK_BYTES), "{held}");
    }

    #[test]
    fn the_longest_line_allowed_passes_and_one_byte_more_does_not() {
        for (bytes, passes) in [(80, true), (81, false)] {
            for end in ["\n", "\r\n"] {
                let tcp = peer(move |s| {
                    s.write_all(&vec![b'7'; bytes]).unwrap();
                    s.write_all(end.as_bytes()).unwrap();
                    stay();
                });
                let (answer, _, _) = line(&tcp, 80);
                assert_eq!(answer.is_ok(), passes, "{bytes} {end:?} {answer:?}");
            }
        }
    }

    #[test]
    fn bytes_that_are_not_text_are_told() {
        let tcp = peer(|s| {
            s.write_all(&[b'X', 0xfe, 0x00, b'\n']).unwrap();
            stay();
        });
        let (answer, _, _) = line(&tcp, 80);
        let line = r"X\xfe\x00".to_string();
        assert_eq!(answer, Err(LinkError::Garbage { line }));
    }

    #[test]
    fn noise_around_a_line_is_passed_over_and_within_it_stays() {
        for (line, text) in [
            (&b"\xff\x00\x00start"[..], "start"),
            (b"\0ok", "ok"),
            (b"ok\0", "ok"),
            (b"ok\r\r", "ok"),
            (b"\x11\xfeX:1.00\x13\x7f", "X:1.00"),
            // A digit may be gone.
            (b"Count X:10\xff", r"Count X:10\xff"),
            (b"X:1\x00.5", r"X:1\x00.5"),
            (b"T:20 \xc2\xb0C", r"T:20 \xc2\xb0C"),
            (b" say \"no\" \\", r#" say "no" \"#),
        ] {
            assert_eq!(past_noise(line).as_deref(), Some(text), "{line:?}");
        }
        for noise in [&b""[..], b"\0", b"\xff\x00\x9c", b"\r"] {
            assert_eq!(past_noise(noise), None);
        }
    }

    #[test]
    fn an_ended_connection_is_told_at_once() {
        let (answer, _, _) = line(&peer(|_| {}), 80);
        assert_eq!(answer, Err(LinkError::Closed));
    }

    #[test]
    fn closing_ends_a_read_that_waits() {
        let tcp = peer(|_| stay());
        let start = Instant::now();
        thread::scope(|s| {
            let reads = s.spawn(|| tcp.read(&mut [0; 8], start + Duration::from_secs(2)));
            thread::sleep(Duration::from_millis(50));
            tcp.close();
            assert_eq!(reads.join().unwrap(), Err(LinkError::Closed));
        });
    }

    #[test]
    fn nobody_there_is_told() {
        let free = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = free.local_addr().unwrap().to_string();
        drop(free);
        let answer = Tcp::connect(&address, TIMEOUT);
        assert!(
            matches!(answer, Err(LinkError::NoConnection { .. })),
            "{answer:?}"
        );
    }

    #[cfg(feature = "serial")]
    #[test]
    fn a_serial_port_that_is_not_there_is_told() {
        let answer = Serial::open("/nowhere/tty", 115_200).map(|_| ());
        assert!(
            matches!(answer, Err(LinkError::NoConnection { .. })),
            "{answer:?}"
        );
    }

    #[cfg(all(feature = "serial", unix))]
    #[test]
    fn a_serial_port_reads_while_another_thread_writes_and_keeps_its_time_outs() {
        use serialport::{SerialPort, TTYPort};
        let (mut device, mut port) = TTYPort::pair().unwrap();
        port.set_exclusive(false).unwrap();
        device.set_timeout(Duration::from_secs(2)).unwrap();
        let name = port.name().unwrap();
        // Only one may have it open.
        drop(port);
        let serial = Serial::open(&name, 115_200).unwrap();
        let mut reader = LineReader::new(80);
        let start = Instant::now();
        thread::scope(|s| {
            s.spawn(|| {
                // Only what is written while the reader waits is answered.
                let mut heard = [0; 5];
                device.read_exact(&mut heard).unwrap();
                assert_eq!(&heard, b"stop\n");
                device.write_all(b"Move aborted\r\n1").unwrap();
            });
            s.spawn(|| {
                thread::sleep(Duration::from_millis(60));
                serial.write(b"stop\n").unwrap();
            });
            let line = reader.text(&serial, start + Duration::from_secs(2));
            assert_eq!(line.unwrap(), "Move aborted");
        });
        assert!(start.elapsed() >= Duration::from_millis(60));
        let start = Instant::now();
        let half = reader.text(&serial, start + TIMEOUT);
        assert_eq!(half, Err(LinkError::HalfLine { bytes: 1 }));
        assert!(start.elapsed() >= TIMEOUT);
        serial.close();
        let later = Instant::now() + TIMEOUT;
        assert_eq!(serial.read(&mut [0; 8], later), Err(LinkError::Closed));
        assert_eq!(serial.write(b"p?\n"), Err(LinkError::Closed));
    }
}
