//! Starting or finding a driver, and what it speaks for.

use crate::child;
use crate::hello::Hello;
use crate::link::{CallError, Link};
use crate::message::{Call, Code, PROTOCOL};
use crate::patience::{HELLO, Patience};
use crate::remote::{Remote, RemoteCamera, RemoteLight, RemoteNosepiece, RemoteStage};
use crate::secret::Secret;
use scopeservo_scope::{Camera, Clock, Devices, Light, Nosepiece, Stage};
use std::net::{TcpStream, ToSocketAddrs};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use thiserror::Error;

/// How long one waits for the program before to leave.
const PATIENCE: Duration = Duration::from_secs(2);
const AGAIN: Duration = Duration::from_millis(50);
/// How long a connection may take to be made.
const CONNECT: Duration = Duration::from_secs(5);

/// Why there is no driver.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DriverError {
    /// The program could not be started.
    #[error(
        "the driver '{command}' cannot be started: {source}. Check that it is installed and can be executed"
    )]
    Spawn {
        /// The program.
        command: String,
        /// Why.
        source: std::io::Error,
    },
    /// Nobody answers at the address.
    #[error("no driver answers at {address}: {source}. Check that it runs, and the address")]
    Connect {
        /// Where.
        address: String,
        /// Why.
        source: std::io::Error,
    },
    /// It did not say hello as the protocol asks.
    #[error("the driver '{driver}' did not say hello: {detail}")]
    Hello {
        /// Which.
        driver: String,
        /// What it did instead.
        detail: String,
    },
    /// Another program is connected to it.
    #[error(
        "the driver at {driver} serves another program, and only one at a time; end that first"
    )]
    Taken {
        /// Which.
        driver: String,
    },
    /// It wants a secret.
    #[error("the driver at {driver} asks for a secret: name the file that holds it")]
    NeedsSecret {
        /// Which.
        driver: String,
    },
    /// What it says of itself makes no sense.
    #[error("the driver '{driver}' says something impossible of its {device}: {detail}")]
    Nonsense {
        /// Which.
        driver: String,
        /// Which device.
        device: &'static str,
        /// What.
        detail: String,
    },
}

/// A driver that has said hello.
pub struct Driver {
    link: Link,
    hello: Hello,
    shown: String,
    patience: Patience,
}

impl Driver {
    /// Starts a program and says hello. What it writes to standard error goes to ours.
    ///
    /// # Errors
    /// [`DriverError`].
    pub fn spawn(program: &str, arguments: &[String]) -> Result<Self, DriverError> {
        let failed = |source| DriverError::Spawn {
            command: program.into(),
            source,
        };
        let mut command = Command::new(program);
        command
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        let child = child::start(&mut command).map_err(failed)?;
        Self::greet(Link::child(child).map_err(failed)?, program.into(), None)
    }

    /// Connects to a driver that runs already, and says hello.
    ///
    /// # Errors
    /// [`DriverError`].
    pub fn connect(address: &str, secret: Option<&Secret>) -> Result<Self, DriverError> {
        let failed = |source| DriverError::Connect {
            address: address.into(),
            source,
        };
        // The program before us may still be leaving. Counted from when that was first said, however long it took to be told.
        let mut first_told = None;
        loop {
            let answer = Self::connect_once(address, secret, &failed);
            let taken = matches!(answer, Err(DriverError::Taken { .. }));
            if !taken || first_told.get_or_insert_with(Instant::now).elapsed() >= PATIENCE {
                return answer;
            }
            std::thread::sleep(AGAIN);
        }
    }

    fn connect_once(
        address: &str,
        secret: Option<&Secret>,
        failed: &dyn Fn(std::io::Error) -> DriverError,
    ) -> Result<Self, DriverError> {
        let mut last = std::io::ErrorKind::AddrNotAvailable.into();
        for socket in address.to_socket_addrs().map_err(&failed)? {
            match TcpStream::connect_timeout(&socket, CONNECT) {
                Ok(stream) => {
                    let link = Link::tcp(stream).map_err(&failed)?;
                    return Self::greet(link, address.into(), secret);
                }
                Err(error) => last = error,
            }
        }
        Err(failed(last))
    }

    fn greet(link: Link, shown: String, secret: Option<&Secret>) -> Result<Self, DriverError> {
        let hello = |proof: Option<String>| {
            let call = Call::Hello {
                protocol: PROTOCOL,
                client: concat!("scopeservo ", env!("CARGO_PKG_VERSION")).into(),
                proof,
            };
            link.ask(call, HELLO)
        };
        let bad = |detail: String| DriverError::Hello {
            driver: shown.clone(),
            detail,
        };
        let answer = match hello(None) {
            Err(CallError::Said {
                code: Code::Secret,
                nonce,
                ..
            }) => {
                let secret = secret.ok_or(DriverError::NeedsSecret {
                    driver: shown.clone(),
                })?;
                let nonce =
                    nonce.ok_or_else(|| bad("it wants a secret and gives no nonce".into()))?;
                hello(Some(secret.proof(&nonce)))
            }
            answer => answer,
        };
        let reply = answer.map_err(|error| match error {
            CallError::Said {
                code: Code::Busy, ..
            } => DriverError::Taken {
                driver: shown.clone(),
            },
            CallError::Said { message, .. } => bad(message),
            CallError::Lost(reason) => bad(reason),
        })?;
        let hello: Hello = serde_json::from_value(serde_json::Value::Object(reply.object))
            .map_err(|error| bad(format!("its reply is not one: {error}")))?;
        if hello.protocol != PROTOCOL {
            return Err(bad(format!(
                "it speaks version {} of the protocol, and this program {PROTOCOL}",
                hello.protocol
            )));
        }
        Ok(Self {
            link,
            hello,
            shown,
            patience: Patience::default(),
        })
    }

    /// The same with other times for frames; those of stops and of motion stay.
    pub fn patient(self, patience: Patience) -> Self {
        Self { patience, ..self }
    }

    /// What it says of itself.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Ends the connection without a word, as a pulled plug does: to see that the driver then stops what moves.
    pub fn cut(&self) {
        self.link.cut();
    }

    /// The devices that it speaks for. Each keeps the connection; the last one that is dropped ends it. Time stamps of frames are on `clock`.
    ///
    /// # Errors
    /// [`DriverError::Nonsense`].
    pub fn devices(&self, clock: &Arc<dyn Clock>) -> Result<Devices, DriverError> {
        let nonsense = |device| {
            move |detail| DriverError::Nonsense {
                driver: self.shown.clone(),
                device,
                detail,
            }
        };
        let remote = |device| Remote::new(self.link.clone(), device);
        let hello = &self.hello;
        let on_stage = hello.stage.as_ref().map(|_| remote("stage"));
        let stage = match hello.stage.as_ref().zip(on_stage.clone()) {
            Some((stage, remote)) => {
                let info = stage.info().map_err(nonsense("stage"))?;
                let stage = RemoteStage::new(remote, info, stage.homed, stage.speeds);
                Some(Box::new(stage) as Box<dyn Stage>)
            }
            None => None,
        };
        let camera = match &hello.camera {
            Some(camera) => Some(Box::new(RemoteCamera {
                remote: remote("camera"),
                info: camera.info().map_err(nonsense("camera"))?,
                clock: clock.clone(),
                stage: on_stage,
                patience: self.patience,
                last: Mutex::default(),
            }) as Box<dyn Camera>),
            None => None,
        };
        let nosepiece = match &hello.nosepiece {
            Some(nosepiece) => Some(Box::new(RemoteNosepiece {
                remote: remote("nosepiece"),
                objectives: nosepiece.objectives().map_err(nonsense("nosepiece"))?,
                known_by: nosepiece.known_by,
            }) as Box<dyn Nosepiece>),
            None => None,
        };
        Ok(Devices {
            stage,
            camera,
            nosepiece,
            light: hello
                .light
                .as_ref()
                .map(|_| Box::new(RemoteLight(remote("light"))) as Box<dyn Light>),
            clock: clock.clone(),
        })
    }
}
