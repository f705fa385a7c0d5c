//! An emulated camera on the web: a stream of images at `/stream`, single ones at `/shot`, the exposure at `/exposure?ms=`.

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Where an emulated camera gets an image from: a whole JPEG of what it sees now.
pub type View = Arc<dyn Fn() -> Vec<u8> + Send + Sync>;

/// How the camera sends its stream.
#[derive(Debug, Clone, Copy)]
pub enum Sending {
    /// Each image with its length, the answer without.
    Sized,
    /// Images without a length.
    Unsized,
    /// The whole answer in chunks.
    Chunked,
    /// As other cameras do.
    Own {
        /// The head of the answer, without its end.
        head: &'static str,
        /// A part, of an image.
        part: fn(&[u8]) -> Vec<u8>,
    },
}

/// What goes wrong with the answers from now on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraFault {
    /// Nothing.
    None,
    /// The connection ends in the middle of an image, and no other is taken.
    Unplugged,
    /// Nothing more is sent, and the connection stays.
    Silence,
    /// Each image breaks off, though the stream goes on.
    HalfPictures,
    /// Bytes that are no HTTP, or no part of a stream.
    Garbage,
    /// A head that promises 100 MB and more.
    Huge,
    /// One byte at a time.
    ByteByByte,
    /// Endless bytes without any end of a head or a part.
    Endless,
}

/// What is emulated.
#[derive(Clone)]
pub struct EmulatedCamera {
    /// What it sees.
    pub view: View,
    /// Between two images of the stream.
    pub period: Duration,
    /// From the exposure of an image until it is sent; single images come from a buffer that is so old at the most.
    pub delay: Duration,
    /// How the stream is sent.
    pub sending: Sending,
    /// `user:password` coded, where it wants to know.
    pub login: Option<String>,
}

struct State {
    camera: EmulatedCamera,
    fault: CameraFault,
    exposure_ms: f64,
    /// What single images are answered from.
    kept: Option<(Instant, Vec<u8>)>,
    open: Vec<TcpStream>,
}

/// The emulated camera on its port. It ends with this.
pub struct CameraEmulator {
    address: SocketAddr,
    state: Arc<Mutex<State>>,
    over: Arc<AtomicBool>,
}

fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

impl CameraEmulator {
    /// Starts it on a free port of 127.0.0.1.
    ///
    /// # Errors
    /// What the system says when there is no port.
    pub fn serve(camera: EmulatedCamera) -> std::io::Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let address = listener.local_addr()?;
        let state = Arc::new(Mutex::new(State {
            camera,
            fault: CameraFault::None,
            exposure_ms: 10.0,
            kept: None,
            open: Vec::new(),
        }));
        let over = Arc::new(AtomicBool::new(false));
        let (kept, ends) = (state.clone(), over.clone());
        thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                if ends.load(Ordering::SeqCst) {
                    return;
                }
                let (state, ends) = (kept.clone(), ends.clone());
                if let Ok(copy) = stream.try_clone() {
                    lock(&state).open.push(copy);
                }
                thread::spawn(move || {
                    // The other side may go at any time.
                    let _ = answer(stream, &state, &ends);
                });
            }
        });
        Ok(Self {
            address,
            state,
            over,
        })
    }

    /// `http://host:port`.
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// What goes wrong from now on.
    pub fn fault(&self, fault: CameraFault) {
        let mut state = lock(&self.state);
        state.fault = fault;
        if fault == CameraFault::Unplugged {
            for stream in state.open.drain(..) {
                let _ = stream.shutdown(Shutdown::Both);
            }
        }
    }

    /// The exposure that was set last, ms.
    pub fn exposure_ms(&self) -> f64 {
        lock(&self.state).exposure_ms
    }
}

impl Drop for CameraEmulator {
    fn drop(&mut self) {
        self.over.store(true, Ordering::SeqCst);
        self.fault(CameraFault::Unplugged);
        // Wakes the thread that waits for connections.
        let _ = TcpStream::connect(self.address);
    }
}

/// The question's path, and its login.
fn question(stream: &mut TcpStream) -> std::io::Result<(String, Option<String>)> {
    let mut bytes = Vec::new();
    let mut byte = [0];
    while !bytes.ends_with(b"\r\n\r\n") {
        stream.read_exact(&mut byte)?;
        bytes.push(byte[0]);
    }
    let text = String::from_utf8_lossy(&bytes);
    let mut lines = text.lines();
    let path = lines.next().and_then(|l| l.split(' ').nth(1));
    let login = lines.find_map(|l| l.strip_prefix("Authorization: Basic "));
    Ok((
        path.unwrap_or_default().to_string(),
        login.map(str::to_string),
    ))
}

fn answer(mut stream: TcpStream, state: &Mutex<State>, over: &AtomicBool) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let (path, login) = question(&mut stream)?;
    let (fault, camera) = {
        let state = lock(state);
        (state.fault, state.camera.clone())
    };
    match fault {
        CameraFault::Unplugged => return Ok(()),
        CameraFault::Garbage => return stream.write_all(&[0xfe; 3000]),
        CameraFault::Silence => {
            wait(over, Duration::from_secs(20));
            return Ok(());
        }
        CameraFault::Endless => return endless(&mut stream, over),
        _ => {}
    }
    if camera.login.is_some() && camera.login != login {
        return stream.write_all(
            b"HTTP/1.1 401 Unauthorized\r\nWWW-Authenticate: Basic realm=\"camera\"\r\nContent-Length: 0\r\n\r\n",
        );
    }
    if let Some(ms) = path.strip_prefix("/exposure?ms=") {
        let Ok(ms) = ms.parse() else {
            return stream.write_all(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n");
        };
        lock(state).exposure_ms = ms;
        return stream.write_all(b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nok");
    }
    match path.as_str() {
        "/shot" => shot(&mut stream, state, &camera),
        "/stream" => send_stream(&mut stream, state, &camera, over),
        _ => stream.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n"),
    }
}

/// A single image, from the buffer unless that is too old.
fn shot(
    stream: &mut TcpStream,
    state: &Mutex<State>,
    camera: &EmulatedCamera,
) -> std::io::Result<()> {
    let kept = lock(state).kept.clone();
    let fresh = kept.filter(|(at, _)| at.elapsed() < camera.delay);
    let (at, mut picture) = fresh.unwrap_or_else(|| (Instant::now(), (camera.view)()));
    let fault = {
        let mut state = lock(state);
        state.kept = Some((at, picture.clone()));
        state.fault
    };
    let mut length = picture.len();
    match fault {
        CameraFault::HalfPictures => {
            length /= 2;
            picture.truncate(length);
        }
        CameraFault::Huge => length = 100_000_000,
        _ => {}
    }
    let head =
        format!("HTTP/1.1 200 OK\r\nContent-Type: image/jpeg\r\nContent-Length: {length}\r\n\r\n");
    send(stream, head.as_bytes(), fault)?;
    send(stream, &picture, fault)?;
    if fault == CameraFault::Huge {
        for _ in 0..2000 {
            stream.write_all(&[0; 50_000])?;
        }
    }
    Ok(())
}

fn send_stream(
    stream: &mut TcpStream,
    state: &Mutex<State>,
    camera: &EmulatedCamera,
    over: &AtomicBool,
) -> std::io::Result<()> {
    let chunked = matches!(camera.sending, Sending::Chunked);
    let coding = if chunked {
        "Transfer-Encoding: chunked\r\n"
    } else {
        ""
    };
    let head = format!(
        "HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n{coding}\r\n"
    );
    match camera.sending {
        Sending::Own { head, .. } => stream.write_all(format!("{head}\r\n\r\n").as_bytes())?,
        _ => stream.write_all(head.as_bytes())?,
    }
    let mut on_the_way = VecDeque::new();
    while !over.load(Ordering::SeqCst) {
        on_the_way.push_back((Instant::now(), (camera.view)()));
        thread::sleep(camera.period);
        let mut due = None;
        while on_the_way
            .front()
            .is_some_and(|(at, _): &(Instant, Vec<u8>)| at.elapsed() >= camera.delay)
        {
            due = on_the_way.pop_front();
        }
        let Some((_, mut picture)) = due else {
            continue;
        };
        let fault = lock(state).fault;
        let mut length = picture.len();
        match fault {
            CameraFault::Unplugged => return Ok(()),
            CameraFault::Silence => continue,
            CameraFault::Garbage => picture.fill(0xfe),
            CameraFault::Endless => return endless(stream, over),
            CameraFault::HalfPictures => {
                length /= 2;
                picture.truncate(length);
            }
            CameraFault::Huge => length = 100_000_000,
            CameraFault::None | CameraFault::ByteByByte => {}
        }
        let size = match camera.sending {
            Sending::Unsized if fault != CameraFault::Huge => String::new(),
            _ => format!("Content-Length: {length}\r\n"),
        };
        let mut part = format!("--frame\r\nContent-Type: image/jpeg\r\n{size}\r\n").into_bytes();
        part.extend_from_slice(&picture);
        part.extend_from_slice(b"\r\n");
        if let Sending::Own { part: own, .. } = camera.sending {
            part = own(&picture);
        }
        if chunked {
            // The border between chunks falls anywhere.
            let (a, b) = part.split_at(part.len() / 3);
            part = [a, b]
                .map(|c| [format!("{:x}\r\n", c.len()).as_bytes(), c, b"\r\n"].concat())
                .concat();
        }
        send(stream, &part, fault)?;
    }
    Ok(())
}

fn send(stream: &mut TcpStream, bytes: &[u8], fault: CameraFault) -> std::io::Result<()> {
    match fault {
        CameraFault::ByteByByte => bytes.iter().try_for_each(|b| stream.write_all(&[*b])),
        _ => stream.write_all(bytes),
    }
}

fn endless(stream: &mut TcpStream, over: &AtomicBool) -> std::io::Result<()> {
    while !over.load(Ordering::SeqCst) {
        stream.write_all(&[b'a'; 10_000])?;
    }
    Ok(())
}

fn wait(over: &AtomicBool, longest: Duration) {
    let start = Instant::now();
    while start.elapsed() < longest && !over.load(Ordering::SeqCst) {
        thread::sleep(Duration::from_millis(10));
    }
}
