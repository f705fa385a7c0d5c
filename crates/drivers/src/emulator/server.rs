//! One emulated device behind a TCP port, and what may go wrong on the way to it.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// What goes wrong with everything the device says from now on. It hears all the same.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Fault {
    /// Nothing.
    #[default]
    None,
    /// It says nothing.
    Silence,
    /// It ends the connection instead of speaking.
    Disconnect,
    /// It says bytes that are no text.
    Garbage,
    /// It says its first half and then nothing.
    Half,
    /// It says a line without an end.
    EndlessLine,
    /// It says lines without an end.
    EndlessLines,
    /// It says one byte, waits this many milliseconds, says the next.
    SlowBytes(u64),
}

/// A fault to come, after so many answers as they should be.
#[derive(Default)]
struct Ahead {
    answers: u32,
    fault: Fault,
}

impl Ahead {
    /// What goes wrong with the next answer.
    fn next(&mut self) -> Fault {
        if self.answers == 0 {
            return self.fault;
        }
        self.answers -= 1;
        Fault::None
    }
}

/// What an emulated device does with bytes and time.
pub(crate) trait Device: Send + 'static {
    /// Takes a byte and appends what it says to that.
    fn hear(&mut self, byte: u8, says: &mut Vec<u8>);
    /// Appends what it says by itself.
    fn tick(&mut self, says: &mut Vec<u8>);
}

/// A device being served. It ends when this is dropped.
pub struct Server<D> {
    address: SocketAddr,
    device: Arc<Mutex<D>>,
    ahead: Arc<Mutex<Ahead>>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<D> Server<D> {
    /// Serves the device on a free port of 127.0.0.1, one connection after another.
    pub(crate) fn start(device: D) -> std::io::Result<Self>
    where
        D: Device,
    {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let address = listener.local_addr()?;
        let device = Arc::new(Mutex::new(device));
        let ahead = Arc::new(Mutex::new(Ahead::default()));
        let ends = Arc::new(AtomicBool::new(false));
        let (d, a, e) = (device.clone(), ahead.clone(), ends.clone());
        let thread = thread::spawn(move || {
            while let Ok((stream, _)) = listener.accept() {
                if e.load(Ordering::SeqCst) {
                    return;
                }
                // A connection that failed is over; the next may come.
                let _ = serve(stream, &d, &a, &e);
            }
        });
        Ok(Self {
            address,
            device,
            ahead,
            ends,
            thread: Some(thread),
        })
    }

    /// "host:port" to connect to.
    pub fn address(&self) -> String {
        self.address.to_string()
    }

    /// Makes something go wrong from now on.
    pub fn set_fault(&self, fault: Fault) {
        self.set_fault_after(0, fault);
    }

    /// Makes something go wrong after so many answers more.
    pub fn set_fault_after(&self, answers: u32, fault: Fault) {
        *lock(&self.ahead) = Ahead { answers, fault };
    }

    pub(crate) fn device(&self) -> MutexGuard<'_, D> {
        lock(&self.device)
    }
}

impl<D> Drop for Server<D> {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::SeqCst);
        // Wakes the thread that waits for a connection.
        let _ = TcpStream::connect(self.address);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Hears in this thread and speaks in another, so that a device that speaks slowly still hears.
fn serve<D: Device>(
    stream: TcpStream,
    device: &Mutex<D>,
    ahead: &Mutex<Ahead>,
    ends: &AtomicBool,
) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(Duration::from_millis(1)))?;
    stream.set_write_timeout(Some(Duration::from_millis(200)))?;
    let over = AtomicBool::new(false);
    let (to_speaker, said) = mpsc::channel::<Vec<u8>>();
    thread::scope(|s| {
        let (speaks, over) = (&stream, &over);
        s.spawn(move || {
            for says in said {
                let now = lock(ahead).next();
                if say(speaks, &says, now, over).is_err() {
                    return;
                }
            }
        });
        let heard = hear(&stream, device, to_speaker, ends);
        over.store(true, Ordering::SeqCst);
        // It may be closed already.
        let _ = stream.shutdown(Shutdown::Both);
        heard
    })
}

fn hear<D: Device>(
    mut stream: &TcpStream,
    device: &Mutex<D>,
    to_speaker: mpsc::Sender<Vec<u8>>,
    ends: &AtomicBool,
) -> std::io::Result<()> {
    let mut bytes = [0; 512];
    while !ends.load(Ordering::SeqCst) {
        let mut says = Vec::new();
        match stream.read(&mut bytes) {
            Ok(0) => return Ok(()),
            Ok(n) => {
                let mut device = lock(device);
                for byte in &bytes[..n] {
                    device.hear(*byte, &mut says);
                }
            }
            Err(e) => match e.kind() {
                ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted => {}
                _ => return Err(e),
            },
        }
        lock(device).tick(&mut says);
        if !says.is_empty() && to_speaker.send(says).is_err() {
            return Ok(());
        }
    }
    Ok(())
}

fn say(
    mut stream: &TcpStream,
    says: &[u8],
    fault: Fault,
    over: &AtomicBool,
) -> std::io::Result<()> {
    match fault {
        Fault::None => stream.write_all(says),
        Fault::Silence => Ok(()),
        Fault::Disconnect => stream.shutdown(Shutdown::Both),
        Fault::Garbage => stream.write_all(&[0xff, 0x00, 0x9c, b'\n']),
        Fault::Half => stream.write_all(&says[..says.len() / 2]),
        Fault::EndlessLine | Fault::EndlessLines => {
            let end = if fault == Fault::EndlessLine {
                b'7'
            } else {
                b'\n'
            };
            let chunk = [b"7 7 7 7 7 7 ", &[b' ', end][..]].concat();
            while !over.load(Ordering::SeqCst) {
                stream.write_all(&chunk)?;
            }
            Ok(())
        }
        Fault::SlowBytes(ms) => {
            for byte in says {
                stream.write_all(&[*byte])?;
                thread::sleep(Duration::from_millis(ms));
            }
            Ok(())
        }
    }
}
