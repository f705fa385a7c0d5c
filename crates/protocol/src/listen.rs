//! Speaking for devices of ours on a TCP port: who may come in, and who is kept waiting and for how long.

use crate::secret::Secret;
use crate::server::{Offer, Seats, converse};
use crate::wire::WireError;
use std::collections::VecDeque;
use std::io::{BufReader, ErrorKind, Read};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream, ToSocketAddrs};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// What strangers are allowed.
#[derive(Debug, Clone, Copy)]
struct Patience {
    /// How long one may take until it has said hello, and proved the secret, all in all.
    hello: Duration,
    /// How many may be connected at once. One more ends the connection of the one that has been there longest.
    strangers: usize,
}

const PATIENCE: Patience = Patience {
    hello: Duration::from_secs(15),
    strangers: 16,
};

/// How long one waits after a connection could not be accepted.
const AGAIN: Duration = Duration::from_millis(50);

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // No panic leaves these half written.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An address that other machines can reach is for those who know a secret.
fn check(address: &SocketAddr, secret: Option<&Secret>) -> std::io::Result<()> {
    if address.ip().is_loopback() || secret.is_some() {
        return Ok(());
    }
    Err(std::io::Error::new(
        ErrorKind::PermissionDenied,
        format!(
            "{address} can be reached from other machines: give a secret, or listen on 127.0.0.1"
        ),
    ))
}

/// Takes a port, "host:port", for [`listen`]. Whether it may is asked before.
///
/// # Errors
/// [`ErrorKind::PermissionDenied`] for an address that other machines can reach, without a secret; those of the system.
pub fn bind(address: &str, secret: Option<&Secret>) -> std::io::Result<TcpListener> {
    let all: Vec<SocketAddr> = address.to_socket_addrs()?.collect();
    for address in &all {
        check(address, secret)?;
    }
    TcpListener::bind(&all[..])
}

/// Serves one client after the other on a TCP port, for ever. A second client at the same time is told that the first is there. Who does not
/// say hello takes nobody's place. `told` hears how a conversation ended when it did not end well, and what keeps clients from coming in.
///
/// # Errors
/// [`ErrorKind::PermissionDenied`] for an address that other machines can reach, without a secret.
pub fn listen(
    listener: &TcpListener,
    offer: &Offer,
    secret: Option<&Secret>,
    told: &(dyn Fn(&str) + Sync),
) -> std::io::Result<()> {
    check(&listener.local_addr()?, secret)?;
    let house = House {
        offer,
        secret,
        told,
        patience: PATIENCE,
        seats: Seats::default(),
        strangers: Mutex::default(),
    };
    house.receive(listener)
}

/// All that the conversations on one port share.
struct House<'a> {
    offer: &'a Offer,
    secret: Option<&'a Secret>,
    told: &'a (dyn Fn(&str) + Sync),
    patience: Patience,
    seats: Seats,
    /// Who has not said hello yet, the longest first.
    strangers: Mutex<VecDeque<Arc<TcpStream>>>,
}

impl House<'_> {
    fn receive(&self, listener: &TcpListener) -> std::io::Result<()> {
        std::thread::scope(|scope| {
            let mut trouble: Option<ErrorKind> = None;
            loop {
                let begun = listener.accept().and_then(|(stream, _)| {
                    let stream = Arc::new(stream);
                    self.let_wait(&stream);
                    let begun = std::thread::Builder::new()
                        .spawn_scoped(scope, {
                            let stream = stream.clone();
                            move || self.meet(&stream)
                        })
                        .map(drop);
                    if begun.is_err() {
                        self.forget(&stream);
                    }
                    begun
                });
                // Too many files, say, or threads: some end, at the latest when strangers have had their time.
                let Err(error) = begun else {
                    trouble = None;
                    continue;
                };
                if trouble.replace(error.kind()) != Some(error.kind()) {
                    (self.told)(&format!("a connection could not be taken: {error}"));
                }
                std::thread::sleep(AGAIN);
            }
        })
    }

    /// One more stranger. There are never more than may be: the one that has been there longest goes.
    fn let_wait(&self, stream: &Arc<TcpStream>) {
        let mut strangers = lock(&self.strangers);
        strangers.push_back(stream.clone());
        if strangers.len() > self.patience.strangers
            && let Some(longest) = strangers.pop_front()
        {
            // It may have gone.
            let _ = longest.shutdown(Shutdown::Both);
        }
    }

    /// It is no stranger any more, or gone.
    fn forget(&self, stream: &Arc<TcpStream>) {
        lock(&self.strangers).retain(|s| !Arc::ptr_eq(s, stream));
    }

    fn meet(&self, stream: &Arc<TcpStream>) {
        let outcome = self.client(stream);
        self.forget(stream);
        if let Err(error) = outcome {
            (self.told)(&format!("a client was disconnected: {error}"));
        }
    }

    fn client(&self, stream: &Arc<TcpStream>) -> Result<(), WireError> {
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(self.patience.hello))?;
        let until = Mutex::new(Some(Instant::now() + self.patience.hello));
        let admitted = || {
            *lock(&until) = None;
            self.forget(stream);
            keep_alive(stream);
            stream.set_read_timeout(None)
        };
        let mut input = BufReader::new(Until {
            stream,
            deadline: &until,
        });
        let (offer, secret, seats) = (self.offer, self.secret, &self.seats);
        converse(offer, secret, &mut input, &**stream, seats, &admitted)
    }
}

/// A client whose machine has gone must not keep the place for hours.
#[cfg(unix)]
fn keep_alive(stream: &TcpStream) {
    use rustix::net::sockopt;
    // A system that cannot is as good as one without.
    let _ = sockopt::set_socket_keepalive(stream, true);
    #[cfg(target_os = "linux")]
    {
        let _ = sockopt::set_tcp_keepidle(stream, Duration::from_secs(10));
        let _ = sockopt::set_tcp_keepintvl(stream, Duration::from_secs(5));
        let _ = sockopt::set_tcp_keepcnt(stream, 3);
    }
}

#[cfg(not(unix))]
fn keep_alive(_: &TcpStream) {}

/// A stream that can be read until a time, all reads together, and without an end once that was taken away.
struct Until<'a> {
    stream: &'a TcpStream,
    deadline: &'a Mutex<Option<Instant>>,
}

impl Read for Until<'_> {
    fn read(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        if let Some(deadline) = *lock(self.deadline) {
            let left = deadline.saturating_duration_since(Instant::now());
            let late = || {
                let why = "it did not say hello in time";
                std::io::Error::new(ErrorKind::TimedOut, why)
            };
            if left.is_zero() {
                return Err(late());
            }
            self.stream.set_read_timeout(Some(left))?;
            return (&*self.stream).read(into).map_err(|e| match e.kind() {
                ErrorKind::WouldBlock | ErrorKind::TimedOut => late(),
                _ => e,
            });
        }
        (&*self.stream).read(into)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_scope::{Devices, SystemClock};
    use serde_json::{Value, json};
    use std::io::{BufRead, Write};
    use std::sync::mpsc::{Sender, channel};

    /// For what a test waits for, however loaded the machine is.
    const LONG: Duration = Duration::from_secs(60);

    /// A port with nothing on offer. Strangers have so long.
    fn house(secret: Option<Secret>, hello: Duration, told: Sender<String>) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        serve(listener, secret, hello, told);
        address
    }

    fn serve(listener: TcpListener, secret: Option<Secret>, hello: Duration, told: Sender<String>) {
        std::thread::spawn(move || {
            let clock = Arc::new(SystemClock::new());
            let offer = Offer {
                name: "nothing".into(),
                devices: Devices::none(clock),
            };
            let told = Mutex::new(told);
            let house = House {
                offer: &offer,
                secret: secret.as_ref(),
                told: &|what| drop(lock(&told).send(what.into())),
                patience: Patience {
                    hello,
                    strangers: 4,
                },
                seats: Seats::default(),
                strangers: Mutex::default(),
            };
            house.receive(&listener)
        });
    }

    struct Client(BufReader<TcpStream>);

    impl Client {
        fn at(address: SocketAddr) -> Self {
            let stream = TcpStream::connect(address).unwrap();
            stream.set_read_timeout(Some(LONG)).unwrap();
            Self(BufReader::new(stream))
        }
        fn ask(&mut self, what: Value) -> Value {
            writeln!(self.0.get_mut(), "{what}").unwrap();
            let mut line = String::new();
            self.0.read_line(&mut line).unwrap();
            serde_json::from_str(&line).unwrap_or(Value::Null)
        }
        fn hello(&mut self, proof: Option<String>) -> Value {
            self.ask(json!({"id":1,"call":"hello","protocol":1,"client":"t","proof":proof}))
        }
        /// Whether the other side has ended it, in the end.
        fn is_ended(&mut self) -> bool {
            let end = self.0.read(&mut [0]);
            matches!(end, Ok(0)) || end.is_err_and(|e| e.kind() == ErrorKind::ConnectionReset)
        }
    }

    fn secret() -> Secret {
        Secret::new(b"correct horse battery").unwrap()
    }

    #[test]
    fn who_says_nothing_takes_nobodys_place() {
        for asked in [None, Some(secret())] {
            let address = house(asked.clone(), LONG, channel().0);
            let mut silent: Vec<Client> = (0..3).map(|_| Client::at(address)).collect();
            writeln!(silent[0].0.get_mut(), " ").unwrap_or_default();
            let mut owner = Client::at(address);
            let mut said = owner.hello(None);
            if asked.is_some() {
                let nonce = said["nonce"].as_str().unwrap();
                said = owner.hello(Some(secret().proof(nonce)));
            }
            assert_eq!(said["ok"], true, "{said}");
            // Who is late is told, and stops nothing when he goes.
            let mut second = Client::at(address);
            let mut told = second.hello(None);
            if asked.is_some() {
                let nonce = told["nonce"].as_str().unwrap();
                told = second.hello(Some(secret().proof(nonce)));
            }
            assert_eq!(told["error"], "busy", "{told}");
            assert!(second.is_ended());
            drop(silent);
            assert_eq!(owner.ask(json!({"id":2,"call":"stop"}))["ok"], true);
        }
    }

    #[test]
    fn a_hello_has_one_deadline_however_slowly_it_is_said() {
        let (tell, told) = channel();
        let address = house(Some(secret()), Duration::from_millis(300), tell);
        for drip in [" ", "x", "{"] {
            let mut slow = Client::at(address);
            // Each byte comes long before the time is over, until it is.
            while slow.0.get_mut().write_all(drip.as_bytes()).is_ok() {
                std::thread::sleep(Duration::from_millis(20));
            }
        }
        let mut silent = Client::at(address);
        assert!(silent.is_ended());
        let all: Vec<String> = (0..4).map(|_| told.recv_timeout(LONG).unwrap()).collect();
        assert!(
            all.iter().all(|t| t.contains("say hello in time")),
            "{all:?}"
        );
        // Who is in has as long as he likes.
        let address = house(None, Duration::from_millis(300), channel().0);
        let mut owner = Client::at(address);
        assert_eq!(owner.hello(None)["ok"], true);
        std::thread::sleep(Duration::from_millis(600));
        assert_eq!(owner.ask(json!({"id":2,"call":"stop"}))["ok"], true);
    }

    #[test]
    fn the_strangers_who_are_there_longest_go_when_there_are_too_many() {
        let address = house(None, LONG, channel().0);
        let mut many: Vec<Client> = (0..12).map(|_| Client::at(address)).collect();
        let mut owner = Client::at(address);
        assert_eq!(owner.hello(None)["ok"], true);
        let mut first = many.remove(0);
        assert!(first.is_ended());
        // And more of them never put out who is in.
        many.extend((0..12).map(|_| Client::at(address)));
        assert!(many[0].is_ended());
        assert_eq!(owner.ask(json!({"id":2,"call":"stop"}))["ok"], true);
    }

    #[test]
    fn a_connection_that_cannot_be_taken_is_told_once_and_does_not_end_the_service() {
        let (tell, told) = channel();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        // Whenever nobody is there to be accepted that is an error then.
        listener.set_nonblocking(true).unwrap();
        serve(listener, None, LONG, tell);
        let trouble = told.recv_timeout(LONG).unwrap();
        assert!(trouble.contains("could not be taken"), "{trouble}");
        for _ in 0..3 {
            let mut client = Client::at(address);
            assert_eq!(client.hello(None)["ok"], true);
            assert_eq!(client.ask(json!({"id":2,"call":"bye"}))["ok"], true);
            assert!(client.is_ended());
        }
    }

    #[test]
    fn nothing_is_answered_before_hello() {
        for (asked, code) in [(None, "bad_request"), (Some(secret()), "refused")] {
            let address = house(asked.clone(), LONG, channel().0);
            let mut client = Client::at(address);
            for call in ["position", "motion", "stop", "grab", "home", "bye"] {
                let said = client.ask(json!({"id":7,"call":call}));
                assert_eq!(said["error"], code, "{call}: {said}");
                assert_eq!(said["id"], 7);
            }
            let said = client.ask(json!({"id":8,"call":"move","x_um":1}));
            assert_eq!(said["error"], code, "{said}");
            let said = client.hello(None);
            match asked {
                None => assert_eq!(said["ok"], true, "{said}"),
                Some(_) => assert_eq!(said["error"], "secret", "{said}"),
            }
        }
    }

    #[test]
    fn a_port_for_others_is_not_taken_without_a_secret() {
        let free = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = free.local_addr().unwrap().port();
        // It is taken on this machine already, and that is not even noticed.
        for address in ["0.0.0.0", "[::]"] {
            let refused = bind(&format!("{address}:{port}"), None).unwrap_err();
            assert_eq!(refused.kind(), ErrorKind::PermissionDenied, "{refused}");
        }
        assert!(bind("127.0.0.1:0", None).is_ok());
        assert!(bind("0.0.0.0:0", Some(&secret())).is_ok());
    }
}
