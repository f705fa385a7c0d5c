//! Speaking for devices of ours.

use crate::hello::{CameraHello, Hello, LightHello, NosepieceHello, StageHello};
use crate::message::{Call, Code, PROTOCOL, Place, Request};
use crate::secret::{Secret, nonce};
use crate::wire::{self, Object, WireError};
use scopeservo_scope::{
    Camera, Devices, ErrorKind, ObjectiveId, Samples, ScopeError, Stage, StagePose,
};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How long a stranger may take to say hello.
const PATIENCE: Duration = Duration::from_secs(15);

/// The devices that are offered.
pub struct Offer {
    /// For people.
    pub name: String,
    /// Those there are.
    pub devices: Devices,
}

/// A refusal on its way.
struct Refusal(Code, String);

impl From<ScopeError> for Refusal {
    fn from(error: ScopeError) -> Self {
        let code = match &error {
            ScopeError::OutsideLimits { .. }
            | ScopeError::NotFinite { .. }
            | ScopeError::BadSetting { .. } => Code::OutsideLimits,
            ScopeError::NoSuchAxis { .. } => Code::NoSuchAxis,
            ScopeError::NoSuchObjective { .. } => Code::NoSuchObjective,
            ScopeError::Busy { .. } => Code::Busy,
            ScopeError::NotHomed { .. } => Code::NotHomed,
            // By the page: what a stop has overtaken does not begin.
            ScopeError::Interrupted { .. } => Code::Refused,
            other => match other.kind() {
                ErrorKind::Refused => Code::Refused,
                _ => Code::Fault,
            },
        };
        Refusal(code, error.to_string())
    }
}

/// Where replies go, one at a time.
struct Out<W>(Mutex<W>);

impl<W: Write> Out<W> {
    fn lock(&self) -> MutexGuard<'_, W> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn reply(&self, id: u64, answer: Result<(Object, Vec<u8>), Refusal>) -> std::io::Result<()> {
        let (mut message, bytes) = match answer {
            Ok((mut object, bytes)) => {
                object.insert("ok".into(), Value::Bool(true));
                (object, bytes)
            }
            Err(Refusal(code, message)) => (
                object(json!({"error": code, "message": message})),
                Vec::new(),
            ),
        };
        message.insert("id".into(), id.into());
        wire::write(&mut *self.lock(), &message, &bytes)
    }
}

fn object(value: Value) -> Object {
    match value {
        Value::Object(object) => object,
        _ => Object::new(),
    }
}

impl Offer {
    fn hello(&self) -> Result<Hello, ScopeError> {
        let stage = |s: &dyn Stage| Ok::<_, ScopeError>(StageHello::of(s.info(), s.is_homed()?));
        let devices = &self.devices;
        Ok(Hello {
            protocol: PROTOCOL,
            name: self.name.clone(),
            stage: devices.stage.as_deref().map(stage).transpose()?,
            camera: devices.camera.as_ref().map(|c| CameraHello::of(c.info())),
            nosepiece: devices
                .nosepiece
                .as_ref()
                .map(|n| NosepieceHello::of(&self.name, &**n)),
            light: devices.light.as_ref().map(|_| LightHello {
                name: self.name.clone(),
            }),
        })
    }

    fn stop(&self) -> Result<(), ScopeError> {
        // Both are told, whatever the one says.
        let stage = self.devices.stage.as_ref();
        let stage = stage.map_or(Ok(()), |s| s.stop());
        let nosepiece = self.devices.nosepiece.as_ref();
        let nosepiece = nosepiece.map_or(Ok(()), |n| n.stop());
        stage.and(nosepiece)
    }

    fn answer(&self, call: &Call) -> Result<(Object, Vec<u8>), Refusal> {
        let devices = &self.devices;
        let stage = || devices.stage.as_deref().ok_or_else(|| no_such("stage"));
        let camera = || devices.camera.as_deref().ok_or_else(|| no_such("camera"));
        let nosepiece = devices.nosepiece.as_deref();
        let nosepiece = || nosepiece.ok_or_else(|| no_such("nosepiece"));
        let reply = match call {
            Call::Hello { protocol, .. } if *protocol != PROTOCOL => {
                let message = format!("this driver speaks version {PROTOCOL} of the protocol");
                return Err(Refusal(Code::Unsupported, message));
            }
            Call::Hello { .. } => json!(self.hello()?),
            Call::Position => json!(Place::from(&stage()?.position()?)),
            Call::Move(place) => {
                stage()?.start_move(&StagePose::from(*place))?;
                json!({})
            }
            Call::Motion => json!({"motion": stage()?.poll()?}),
            Call::Home => {
                stage()?.start_homing()?;
                json!({})
            }
            Call::Stop => {
                self.stop()?;
                json!({})
            }
            Call::Objective => {
                let nosepiece = nosepiece()?;
                json!({"objective": nosepiece.current()?, "motion": nosepiece.poll()?})
            }
            Call::Change { objective } => {
                nosepiece()?.start_change(&ObjectiveId(objective.clone()))?;
                json!({})
            }
            Call::Exposure { exposure_ms } => {
                let camera = camera()?;
                let set = match exposure_ms {
                    None => camera.exposure()?,
                    Some(ms) => {
                        let wanted = Duration::try_from_secs_f64(ms * 1e-3).map_err(|_| {
                            Refusal(Code::OutsideLimits, format!("{ms} ms is no exposure"))
                        })?;
                        camera.set_exposure(wanted)?
                    }
                };
                json!({"exposure_ms": set.as_secs_f64() * 1e3})
            }
            Call::Grab => return self.frame(camera()?),
            Call::Light { level } => {
                let light = devices.light.as_deref().ok_or_else(|| no_such("light"))?;
                json!({"level": match level {
                    None => light.level()?,
                    Some(level) => light.set_level(*level)?,
                }})
            }
            Call::Bye => {
                self.stop()?;
                json!({})
            }
        };
        Ok((object(reply), Vec::new()))
    }

    fn frame(&self, camera: &dyn Camera) -> Result<(Object, Vec<u8>), Refusal> {
        let frame = camera.grab()?;
        let bytes = match frame.samples {
            Samples::U8(samples) => samples,
            Samples::U16(samples) => samples.iter().flat_map(|s| s.to_le_bytes()).collect(),
        };
        let clock = &self.devices.clock;
        let age = clock.in_life(clock.now().since(frame.exposure_start));
        let head = json!({
            "width_px": frame.width,
            "height_px": frame.height,
            "channels": frame.channels.count(),
            "bits": frame.bit_depth,
            "exposure_ms": frame.exposure.as_secs_f64() * 1e3,
            "sequence": frame.sequence,
            "age_ms": age.as_secs_f64() * 1e3,
            "bytes": bytes.len(),
        });
        Ok((object(head), bytes))
    }
}

fn no_such(device: &str) -> Refusal {
    Refusal(Code::Unsupported, format!("there is no {device} here"))
}

/// Speaks for `offer` until the input ends or says `bye`, then stops what moves. With a secret, nothing is done before it is proved.
///
/// # Errors
/// [`WireError`] when what comes in is no message; what moves is stopped then, too.
pub fn serve<W: Write + Send>(
    offer: &Offer,
    secret: Option<&Secret>,
    input: &mut impl BufRead,
    output: W,
) -> Result<(), WireError> {
    let only = Seats::default();
    converse(offer, secret, input, output, Seat(&only), &|| Ok(()))
}

/// As [`serve`], for the client in `seat`; `admitted` is told once the secret was proved.
fn converse<W: Write + Send>(
    offer: &Offer,
    secret: Option<&Secret>,
    input: &mut impl BufRead,
    output: W,
    seat: Seat<'_>,
    admitted: &dyn Fn() -> std::io::Result<()>,
) -> Result<(), WireError> {
    let out = Out(Mutex::new(output));
    let seats = seat.0;
    std::thread::scope(|scope| -> Result<(), WireError> {
        // Whatever ends the conversation: before a frame that is still being exposed is waited for.
        let _end = AtEnd(offer, seat);
        let mut known = secret.is_none();
        let mut challenge: Option<String> = None;
        let exposing = Arc::new(AtomicBool::new(false));
        while let Some(object) = wire::read_line(input)? {
            let Some(id) = object.get("id").and_then(Value::as_u64) else {
                return Err(WireError::NotAnObject("a request has no id".into()));
            };
            let call = match request(object) {
                Ok(call) => call,
                Err(no) => {
                    out.reply(id, Err(no))?;
                    continue;
                }
            };
            if let (false, Some(secret)) = (known, secret) {
                let proof = match &call {
                    Call::Hello { proof, .. } => proof.as_deref(),
                    _ => Some(""),
                };
                match (proof, challenge.take()) {
                    (None, None) => {
                        let nonce = nonce()?;
                        let message =
                            object_with(Code::Secret, "prove that you know the secret", id, &nonce);
                        wire::write(&mut *out.lock(), &message, &[])?;
                        challenge = Some(nonce);
                        continue;
                    }
                    (Some(proof), Some(nonce)) if secret.proves(&nonce, proof) => {
                        known = true;
                        admitted()?;
                    }
                    _ => {
                        let no = Refusal(Code::Refused, "that is not the secret".into());
                        out.reply(id, Err(no))?;
                        return Ok(());
                    }
                }
            }
            match call {
                Call::Grab if exposing.swap(true, Ordering::SeqCst) => {
                    let no = Refusal(Code::Busy, "a frame is being exposed".into());
                    out.reply(id, Err(no))?;
                }
                Call::Grab => {
                    // Beside the reading, so that a stop need not wait for it.
                    let (out, exposing) = (&out, exposing.clone());
                    scope.spawn(move || {
                        let answer = seats.one_frame(|| offer.answer(&Call::Grab));
                        exposing.store(false, Ordering::SeqCst);
                        // Nobody may be left to read it: the next line says so.
                        let _ = out.reply(id, answer);
                    });
                }
                Call::Bye => {
                    out.reply(id, offer.answer(&call))?;
                    return Ok(());
                }
                call => out.reply(id, offer.answer(&call))?,
            }
        }
        Ok(())
    })
}

/// Stops everything when it goes, as nobody is left to say it, and after that gives up the seat.
struct AtEnd<'a>(
    &'a Offer,
    #[expect(dead_code, reason = "left when it goes")] Seat<'a>,
);

impl Drop for AtEnd<'_> {
    fn drop(&mut self) {
        let _ = self.0.stop();
    }
}

/// What there is once, however many come: the seat of a client, and the camera's time. A frame that was left behind is still exposed
/// while the next client is let in already.
#[derive(Default)]
struct Seats {
    taken: AtomicBool,
    frame: Mutex<()>,
}

impl Seats {
    fn take(&self) -> Option<Seat<'_>> {
        (!self.taken.swap(true, Ordering::SeqCst)).then(|| Seat(self))
    }

    /// One frame after the other.
    fn one_frame<T>(&self, expose: impl FnOnce() -> T) -> T {
        // It guards no data.
        let _one = self.frame.lock().unwrap_or_else(PoisonError::into_inner);
        expose()
    }
}

/// The seat of a client, free again when this goes.
struct Seat<'a>(&'a Seats);

impl Drop for Seat<'_> {
    fn drop(&mut self) {
        self.0.taken.store(false, Ordering::SeqCst);
    }
}

fn request(object: Object) -> Result<Call, Refusal> {
    match serde_json::from_value::<Request>(Value::Object(object)) {
        Ok(request) => Ok(request.call),
        Err(error) if error.to_string().contains("unknown variant") => {
            Err(Refusal(Code::Unsupported, error.to_string()))
        }
        Err(error) => Err(Refusal(Code::BadRequest, error.to_string())),
    }
}

fn object_with(code: Code, message: &str, id: u64, nonce: &str) -> Value {
    json!({"id": id, "error": code, "message": message, "nonce": nonce})
}

/// Serves one client after the other on a TCP port, until the listener fails. A second client at the same time is told that the first
/// is there. `told` hears how a conversation ended when it did not end well.
///
/// # Errors
/// [`std::io::ErrorKind::PermissionDenied`] for an address that other machines can reach, without a secret; those of the listener.
pub fn listen(
    listener: &TcpListener,
    offer: &Offer,
    secret: Option<&Secret>,
    told: &(dyn Fn(&str) + Sync),
) -> std::io::Result<()> {
    let address = listener.local_addr()?;
    if !address.ip().is_loopback() && secret.is_none() {
        return Err(std::io::Error::new(
            std::io::ErrorKind::PermissionDenied,
            format!(
                "{address} can be reached from other machines: give a secret, or listen on 127.0.0.1"
            ),
        ));
    }
    let seats = Seats::default();
    std::thread::scope(|scope| {
        for stream in listener.incoming() {
            let stream = stream?;
            let seats = &seats;
            scope.spawn(move || match seats.take() {
                None => drop(turn_away(&stream)),
                Some(seat) => {
                    if let Err(error) = client(&stream, offer, secret, seat) {
                        told(&error.to_string());
                    }
                }
            });
        }
        Ok(())
    })
}

fn client(
    stream: &TcpStream,
    offer: &Offer,
    secret: Option<&Secret>,
    seat: Seat<'_>,
) -> Result<(), WireError> {
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(PATIENCE))?;
    if secret.is_some() {
        // A stranger must not keep the place by saying nothing.
        stream.set_read_timeout(Some(PATIENCE))?;
    }
    let admitted = || stream.set_read_timeout(None);
    let input = &mut BufReader::new(stream);
    converse(offer, secret, input, stream, seat, &admitted)
}

fn turn_away(stream: &TcpStream) -> Result<(), WireError> {
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut input = BufReader::new(stream);
    if let Some(object) = wire::read_line(&mut input)? {
        let id = object.get("id").and_then(Value::as_u64).unwrap_or(0);
        let no = json!({"id": id, "error": Code::Busy, "message": "another program is connected; one at a time"});
        wire::write(&mut &*stream, &no, &[])?;
    }
    Ok(())
}
