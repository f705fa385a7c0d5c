//! An instrument at an address: the jobs of the program's commands over REST and WebSocket, and a page to work at (docs/server.md).
//!
//! Data flows one way: a connection (`listening`) comes through the guard (`guard`: which address, which origin, who) to a route with the role
//! that it needs (`routes`), and from there to one of five: the desk, where one job at a time is done (`desk`), the seat of whoever may move
//! the instrument (`seat`), the live view (`live`), how things stand (`standing`), and what is kept (`kept`). Everything moves by a job of
//! the station. No other crate knows that there is a network.

#![warn(clippy::too_many_lines)]

mod app;
mod asked;
mod audit;
mod desk;
mod door;
mod ending;
mod error;
mod grabbing;
mod guard;
mod hand;
mod instrument;
mod jog;
mod kept;
mod limits;
mod listening;
mod live;
mod look;
mod names;
mod need;
mod page;
mod peer;
mod people;
mod pictures;
mod random;
mod routes;
mod seat;
mod serve;
mod socket;
mod standing;
mod starting;
mod tls;

pub use door::DOOR;
pub use limits::Limits;
pub use routes::{OPENAPI, routes};
pub use serve::{Before, ServeError, Server, Settings};
pub use tls::{Certificate, TlsError};

/// What a panic left behind a lock is whole: every value is replaced in one go.
pub(crate) fn lock<T: ?Sized>(mutex: &std::sync::Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
}
