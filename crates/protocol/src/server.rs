//! Speaking for devices of ours.

use crate::hello::{CameraHello, Hello, LightHello, NosepieceHello, StageHello};
use crate::message::{Call, Code, Go, PROTOCOL, Place, Request};
use crate::secret::{Secret, nonce};
use crate::wire::{self, Object, WireError};
use scopeservo_scope::{
    Camera, Devices, ErrorKind, ObjectiveId, Samples, ScopeError, Stage, StagePose,
};
use serde_json::{Value, json};
use std::io::{BufRead, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

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
        let stage = |s: &dyn Stage| {
            Ok::<_, ScopeError>(StageHello::of(s.info(), s.is_homed()?, s.knows_speeds()))
        };
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
            Call::Hello { protocol, .. } if *protocol != PROTOCOL => return Err(other_version()),
            Call::Hello { .. } => json!(self.hello()?),
            Call::Position => json!(Place::from(&stage()?.position()?)),
            Call::Move(Go { to, speed_um_per_s }) => {
                let (stage, to) = (stage()?, StagePose::from(*to));
                match speed_um_per_s {
                    Some(speed) => stage.start_move_at(&to, speed * 1e-6)?,
                    None => stage.start_move(&to)?,
                }
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

/// Speaks for `offer` until the input ends or says `bye`, then stops what moves. Nothing is done before `hello`, nor, with a secret, before
/// that is proved.
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
    converse(offer, secret, input, output, &only, &|| Ok(()))
}

/// As [`serve`], for a client that takes a seat once it has said hello; `admitted` is told then.
pub(crate) fn converse<W: Write + Send>(
    offer: &Offer,
    secret: Option<&Secret>,
    input: &mut impl BufRead,
    output: W,
    seats: &Seats,
    admitted: &dyn Fn() -> std::io::Result<()>,
) -> Result<(), WireError> {
    let out = Out(Mutex::new(output));
    std::thread::scope(|scope| -> Result<(), WireError> {
        let mut door = Door::new(secret);
        // Whatever ends the conversation: before a frame that is still being exposed is waited for. Who was not let in stops nothing.
        let mut inside: Option<AtEnd<'_>> = None;
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
            if inside.is_none() {
                match door.knock(&call, seats)? {
                    Knock::In(seat) => {
                        inside = Some(AtEnd(offer, seat));
                        admitted()?;
                    }
                    Knock::Prove(nonce) => {
                        let message =
                            object_with(Code::Secret, "prove that you know the secret", id, &nonce);
                        wire::write(&mut *out.lock(), &message, &[])?;
                        continue;
                    }
                    Knock::Again(no) => {
                        out.reply(id, Err(no))?;
                        continue;
                    }
                    Knock::Out(no) => {
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

/// Where a client waits until it has said hello.
struct Door<'a> {
    secret: Option<&'a Secret>,
    /// What its proof is asked of.
    challenge: Option<String>,
}

/// What becomes of a call of somebody who was not let in yet.
enum Knock<'a> {
    In(Seat<'a>),
    Prove(String),
    /// It may try again.
    Again(Refusal),
    Out(Refusal),
}

impl<'a> Door<'a> {
    fn new(secret: Option<&'a Secret>) -> Self {
        Self {
            secret,
            challenge: None,
        }
    }

    fn knock<'s>(&mut self, call: &Call, seats: &'s Seats) -> std::io::Result<Knock<'s>> {
        let refused = |why: &str| Refusal(Code::Refused, why.into());
        let Call::Hello {
            protocol, proof, ..
        } = call
        else {
            return Ok(Knock::Again(match self.secret {
                Some(_) => refused("prove with hello that you know the secret"),
                None => Refusal(Code::BadRequest, "say hello first".into()),
            }));
        };
        if *protocol != PROTOCOL {
            return Ok(Knock::Again(other_version()));
        }
        if let Some(secret) = self.secret {
            match (proof, self.challenge.take()) {
                (None, None) => {
                    let nonce = nonce()?;
                    self.challenge = Some(nonce.clone());
                    return Ok(Knock::Prove(nonce));
                }
                (Some(proof), Some(nonce)) if secret.proves(&nonce, proof) => {}
                _ => return Ok(Knock::Out(refused("that is not the secret"))),
            }
        }
        let taken = || {
            let why = "another program is connected; one at a time";
            Refusal(Code::Busy, why.into())
        };
        Ok(seats.take().map_or_else(|| Knock::Out(taken()), Knock::In))
    }
}

fn other_version() -> Refusal {
    let message = format!("this driver speaks version {PROTOCOL} of the protocol");
    Refusal(Code::Unsupported, message)
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
pub(crate) struct Seats {
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
pub(crate) struct Seat<'a>(&'a Seats);

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
