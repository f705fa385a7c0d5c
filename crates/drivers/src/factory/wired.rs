//! Devices on a line.

use super::contract::{ConnectError, Place};
use crate::link::{Tcp, Transport};
use serde::Deserialize;
use std::time::Duration;

/// How long a connection may take to be made.
const CONNECT: Duration = Duration::from_secs(5);

/// A device on a line: where it is, exactly one of `tcp` and `serial`, and how it is set up.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wired<T> {
    /// Address and port.
    pub tcp: Option<String>,
    /// A serial port.
    pub serial: Option<String>,
    /// Its speed, bits per second.
    #[serde(default = "baud")]
    pub baud: u32,
    /// How the device is set up.
    pub settings: T,
}

fn baud() -> u32 {
    115_200
}

impl<T> Wired<T> {
    pub(crate) fn has_one_place(&self) -> Result<(), String> {
        match self.tcp.is_some() != self.serial.is_some() {
            true => Ok(()),
            false => Err("it must say where the device is: exactly one of tcp and serial".into()),
        }
    }

    pub(crate) fn at(&self) -> Option<Place<'_>> {
        let tcp = self.tcp.as_deref().map(Place::Tcp);
        tcp.or(self.serial.as_deref().map(Place::Serial))
    }

    pub(crate) fn open(&self) -> Result<Box<dyn Transport>, ConnectError> {
        match self.at() {
            Some(Place::Tcp(address)) => match Tcp::connect(address, CONNECT) {
                Ok(tcp) => Ok(Box::new(tcp)),
                Err(error) => Err(ConnectError::Description(format!(
                    "no device answers at {address}: {error}"
                ))),
            },
            Some(Place::Serial(port)) => serial(port, self.baud),
            None => Err(ConnectError::Description(
                "a driver has neither tcp nor serial".into(),
            )),
        }
    }
}

#[cfg(feature = "serial")]
fn serial(port: &str, baud: u32) -> Result<Box<dyn Transport>, ConnectError> {
    match crate::link::Serial::open(port, baud) {
        Ok(serial) => Ok(Box::new(serial)),
        Err(error) => Err(ConnectError::Description(format!(
            "the port {port} cannot be opened: {error}"
        ))),
    }
}

#[cfg(not(feature = "serial"))]
fn serial(port: &str, _: u32) -> Result<Box<dyn Transport>, ConnectError> {
    Err(ConnectError::Description(format!(
        "the port {port} needs a build with serial ports: cargo build --release --features serial"
    )))
}
