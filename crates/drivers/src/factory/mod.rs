//! How a driver is found in a description of an instrument: each maker has a [`Factory`], and [`FACTORIES`] lists them. Whoever opens an
//! instrument asks the list and knows no maker.

mod contract;
mod registry;
mod web;
mod wired;

pub use contract::{Around, ConnectError, Connected, Described, Factory, Place, Table};
pub use registry::FACTORIES;
pub use web::{OnTheWeb, read_secret};
pub use wired::Wired;
