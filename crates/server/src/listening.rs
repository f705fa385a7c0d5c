//! Connections as they come: so many at once, by TLS or without, and each told at which address it came.

use crate::error::ApiError;
use crate::peer::{Peer, network};
use axum::Router;
use axum::response::IntoResponse as _;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::collections::HashMap;
use std::io;
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;
use tokio_rustls::TlsAcceptor;

/// So many connections at once; one more is closed as it comes.
const CONNECTIONS: usize = 256;
/// Of them so many of this computer or one proxy: some stay for the others.
const OF_ONE_NEAR: usize = 192;
/// So many more are told that they are too many; the others are closed as they come.
const TOLD: usize = 16;
/// Who does not say what is wanted within so long is cut off.
const HEAD: Duration = Duration::from_secs(10);
/// Whoever is told that they are too many is to listen within so long.
const TELLING: Duration = Duration::from_secs(2);
/// What TLS begins with: whatever else comes is something else.
const HANDSHAKE: u8 = 0x16;
/// What whoever speaks without TLS is told where it is needed.
const BY_TLS: &str = "HTTP/1.1 400 Bad Request\r\ncontent-type: application/json\r\nconnection: close\r\ncontent-length: 100\r\n\r\n\
    {\"code\":\"not_tls\",\"kind\":\"input\",\"message\":\"this address is spoken to by TLS: begin with https://\"}\n";

/// What all connections share.
#[derive(Clone)]
pub(crate) struct Listening {
    pub(crate) router: Router,
    pub(crate) proxies: Arc<[IpAddr]>,
    places: Arc<Semaphore>,
    told: Arc<Semaphore>,
    /// So many connections of another address.
    of_one: usize,
    taken: Arc<Mutex<HashMap<String, usize>>>,
}

/// A connection's place among those of its address.
struct Place {
    _place: OwnedSemaphorePermit,
    whose: String,
    taken: Arc<Mutex<HashMap<String, usize>>>,
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut taken = crate::lock(&self.taken);
        if let Some(count) = taken.get_mut(&self.whose) {
            *count -= 1;
            if *count == 0 {
                taken.remove(&self.whose);
            }
        }
    }
}

impl Listening {
    pub(crate) fn new(router: Router, proxies: &[IpAddr], of_one: usize) -> Self {
        Self {
            router,
            proxies: proxies.into(),
            places: Arc::new(Semaphore::new(CONNECTIONS)),
            told: Arc::new(Semaphore::new(TOLD)),
            of_one,
            taken: Arc::default(),
        }
    }

    /// A place for one more of that address.
    fn place(&self, peer: &Peer) -> Option<Place> {
        let most = match peer.is_of_this_computer() || peer.is_proxy {
            true => OF_ONE_NEAR,
            false => self.of_one,
        };
        let whose = network(peer.ip);
        let place = self.places.clone().try_acquire_owned().ok()?;
        let mut taken = crate::lock(&self.taken);
        let count = taken.entry(whose.clone()).or_insert(0);
        if *count >= most {
            return None;
        }
        *count += 1;
        drop(taken);
        Some(Place {
            _place: place,
            whose,
            taken: self.taken.clone(),
        })
    }

    /// Says to one who is too many to come again, where there is room for that.
    fn refuse(&self, stream: TcpStream) {
        let Ok(told) = self.told.clone().try_acquire_owned() else {
            return;
        };
        tokio::spawn(async move {
            let router = Router::new().fallback(async || {
                let message = "too many connections from this address: close some, or wait";
                ApiError::too_many(message, Duration::from_secs(5)).into_response()
            });
            let served = timeout(TELLING, serve(stream, router, false));
            let _ = served.await;
            drop(told);
        });
    }

    /// Takes connections as they come, for ever.
    pub(crate) async fn accept(self, listener: TcpListener, tls: Option<TlsAcceptor>) {
        loop {
            let (stream, from) = match listener.accept().await {
                Ok(taken) => taken,
                // Too many files, or one who went before: the next one may do better.
                Err(_) => {
                    tokio::time::sleep(Duration::from_millis(50)).await;
                    continue;
                }
            };
            let Ok(at) = stream.local_addr() else {
                continue;
            };
            let peer = Peer::new(from, at, tls.is_some(), &self.proxies);
            // Without TLS what comes from other machines comes by a proxy that was named.
            let is_private = peer.by_tls || peer.is_of_this_computer() || peer.is_proxy;
            if !is_private {
                continue;
            }
            let Some(place) = self.place(&peer) else {
                // By TLS that would take as long as serving it.
                if !peer.by_tls {
                    self.refuse(stream);
                }
                continue;
            };
            let _ = stream.set_nodelay(true);
            let router = self.router.clone().layer(axum::Extension(peer));
            let tls = tls.clone();
            tokio::spawn(async move {
                match tls {
                    None => serve(stream, router, true).await,
                    Some(tls) => by_tls(&tls, stream, router).await,
                }
                drop(place);
            });
        }
    }
}

async fn by_tls(tls: &TlsAcceptor, mut stream: TcpStream, router: Router) {
    let mut first = [0];
    match timeout(HEAD, stream.peek(&mut first)).await {
        Ok(Ok(1)) if first == [HANDSHAKE] => {}
        Ok(Ok(1)) => {
            // Whoever does not read it is gone.
            let _ = timeout(HEAD, stream.write_all(BY_TLS.as_bytes())).await;
            let _ = stream.shutdown().await;
            return;
        }
        _ => return,
    }
    // Who speaks something else, or takes for ever, is gone.
    if let Ok(Ok(stream)) = timeout(HEAD, tls.accept(stream)).await {
        serve(stream, router, true).await;
    }
}

async fn serve(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    router: Router,
    goes_on: bool,
) {
    let served = http1::Builder::new()
        .keep_alive(goes_on)
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router))
        .with_upgrades();
    // Whoever hangs up in the middle is gone.
    let _ = served.await;
}

/// The address by which other machines reach this one, as far as the system says: no packet is sent for that.
pub(crate) fn outward() -> io::Result<IpAddr> {
    let socket = UdpSocket::bind("0.0.0.0:0")?;
    // An address of documentation (RFC 5737).
    socket.connect(SocketAddr::from(([192, 0, 2, 1], 9)))?;
    Ok(socket.local_addr()?.ip())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_address_has_so_many_connections_and_leaves_the_others_theirs() {
        let listening = Listening::new(Router::new(), &["10.0.0.2".parse().unwrap()], 3);
        let peer = |from: &str| {
            let from = SocketAddr::new(from.parse().unwrap(), 50_000);
            Peer::new(
                from,
                "10.0.0.5:7070".parse().unwrap(),
                true,
                &listening.proxies,
            )
        };
        let taken = |from: &str, most: usize| {
            let all = (0..most).map_while(|_| listening.place(&peer(from)));
            all.collect::<Vec<_>>()
        };
        let mut one = taken("10.0.0.7", 10);
        assert_eq!(one.len(), 3);
        // Of IPv6 a network has as many as an address of the other kind.
        let mut network = taken("2001:db8::1", 2);
        network.extend(taken("2001:db8::2", 2));
        assert_eq!(network.len(), 3);
        // Somebody else has theirs; this computer and a proxy have more, and not all.
        assert_eq!(taken("10.0.0.8", 10).len(), 3);
        assert_eq!(taken("127.0.0.1", 300).len(), OF_ONE_NEAR);
        assert_eq!(taken("10.0.0.2", 300).len(), OF_ONE_NEAR);
        // Who goes makes room.
        one.pop();
        assert_eq!(taken("10.0.0.7", 10).len(), 1);
        drop((one, network));
        assert!(crate::lock(&listening.taken).is_empty());
        assert_eq!(listening.places.available_permits(), CONNECTIONS);
    }
}
