//! The driver: the codec over a session, with what the stage is doing.

use crate::board::Board;
use crate::link::Transport;
use crate::sangaboard::codec::{self, CodecError, Command};
use crate::sangaboard::settings::{SangaAxis, SangaSettings};
use crate::session::{Exchange, Session, bad_setting, device, lock, refused};
use scopeservo_scope::{Axis, Motion, ScopeError, Stage, StageInfo, StagePose, check_speed};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// How often the motors are asked whether they stand still after a stop.
const STOP_POLL: Duration = Duration::from_millis(2);

/// The longest step time that the board is told, us.
const SLOWEST_US: f64 = 1e6;

/// What the driver has asked of the stage.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Doing {
    Nothing,
    /// On the way to these steps.
    Moving([i64; 3]),
    /// Stopped on the way.
    Stopped,
}

/// A stage on a Sangaboard.
///
/// The board counts steps and has no reference: its zero is where it was set, and it trusts that nobody turned the motors
/// while it was off.
pub struct SangaStage {
    session: Session,
    info: StageInfo,
    motors: [(Axis, Option<SangaAxis>); 3],
    stop_timeout: Duration,
    doing: Mutex<Doing>,
}

impl SangaStage {
    /// Takes a board over: waits for its start, reads its version, tries its stop, and sees that it hears while it moves,
    /// which the board keeps as its setting. Nothing moves.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`] for settings that make no sense; [`ScopeError::Device`] for firmware that cannot stop;
    /// [`ScopeError::Timeout`] or [`ScopeError::Device`] when it does not answer, or not as a Sangaboard.
    pub fn connect(
        transport: Box<dyn Transport>,
        settings: &SangaSettings,
    ) -> Result<Self, ScopeError> {
        let axes = settings.checked()?;
        let board = Board {
            stop: codec::STOP,
            max_line_bytes: codec::MAX_LINE_BYTES,
            reply_timeout_ms: settings.reply_timeout_ms,
            boot_ms: settings.boot_ms,
            quiet: Duration::ZERO,
        };
        let session = board.open(transport, |line| codec::decode_version(line).is_ok())?;
        let mut ex = session.exchange()?;
        let line = ask(&mut ex, Command::Version)?;
        let name = read(&ex, codec::decode_version(&line))?;
        let line = ask(&mut ex, Command::IsBlocking)?;
        let blocking = codec::decode_blocking(&line).ok_or_else(|| {
            device(format!(
                "{name} hears nothing while it moves, not even a stop; install firmware that knows blocking_moves"
            ))
        })?;
        drop(ex);
        session.send_stop()?;
        let mut ex = session.exchange()?;
        settle_owed(&mut ex)?;
        if blocking {
            done(&mut ex, Command::DoNotBlock)?;
        }
        steps(&mut ex)?;
        drop(ex);
        Ok(Self {
            session,
            info: StageInfo {
                name,
                axes,
                kinematics: settings.kinematics,
                positive_z: settings.positive_z,
            },
            motors: settings.motors(),
            stop_timeout: Duration::from_millis(settings.stop_timeout_ms),
            doing: Mutex::new(Doing::Nothing),
        })
    }

    /// Takes the current off the motors, which stay warm and shake the image otherwise. They may jump by some steps.
    ///
    /// # Errors
    /// [`ScopeError::Busy`] while it moves, and as [`SangaStage::connect`].
    pub fn release(&self) -> Result<(), ScopeError> {
        let mut ex = self.session.exchange()?;
        if self.poll_in(&mut ex)? == Motion::Moving {
            return Err(ScopeError::Busy { device: "stage" });
        }
        done(&mut ex, Command::Release)
    }

    fn poll_in(&self, ex: &mut Exchange<'_>) -> Result<Motion, ScopeError> {
        if moving(ex)? {
            return Ok(Motion::Moving);
        }
        let doing = *lock(&self.doing);
        let next = match doing {
            Doing::Moving(goal) if steps(ex)? == goal => Doing::Nothing,
            Doing::Moving(_) => Doing::Stopped,
            other => other,
        };
        *lock(&self.doing) = next;
        Ok(match next {
            Doing::Stopped => Motion::Stopped,
            _ => Motion::Settled,
        })
    }

    fn start(&self, to: &StagePose, m_per_s: Option<f64>) -> Result<(), ScopeError> {
        let stops = self.session.stops();
        let targets = self.targets(to)?;
        let mut ex = self.session.exchange()?;
        if self.poll_in(&mut ex)? == Motion::Moving {
            return Err(ScopeError::Busy { device: "stage" });
        }
        if targets == [None; 3] {
            return Ok(());
        }
        let at = steps(&mut ex)?;
        let goal = [0, 1, 2].map(|i| targets[i].unwrap_or(at[i]));
        let command = Command::MoveBy([0, 1, 2].map(|i| goal[i] - at[i]));
        let bytes = command.encode().map_err(|e| bad_setting(e.to_string()))?;
        let usual = match m_per_s {
            Some(m_per_s) => self.slow_down(&mut ex, &targets, m_per_s)?,
            None => None,
        };
        let begun = self.begin(&mut ex, command, &bytes, goal, stops);
        // A move keeps the step time that it began with, and the board keeps what it is told beyond its next start: the usual one is back at once.
        let put_back = usual.map_or(Ok(()), |us| {
            done(&mut ex, Command::SetStepTime(us))?;
            ex.at_close(&[]);
            Ok(())
        });
        begun.and(put_back)
    }

    fn begin(
        &self,
        ex: &mut Exchange<'_>,
        command: Command,
        bytes: &[u8],
        goal: [i64; 3],
        stops: u64,
    ) -> Result<(), ScopeError> {
        ex.send_unless_stopped(bytes, stops)?;
        // Moving from here on, should the answer not come.
        *lock(&self.doing) = Doing::Moving(goal);
        let line = answer(ex)?;
        read(ex, codec::decode_done(command, &line))
    }

    /// Sets the step time for a move of one motor, where that is slower than the usual one, and says what that is then, us.
    fn slow_down(
        &self,
        ex: &mut Exchange<'_>,
        targets: &[Option<i64>; 3],
        m_per_s: f64,
    ) -> Result<Option<i64>, ScopeError> {
        let moved = self.motors.iter().zip(targets);
        let mut moved = moved.filter_map(|((_, motor), to)| to.and(motor.as_ref()));
        let (Some(motor), None) = (moved.next(), moved.next()) else {
            return Err(refused(
                "its speed can be chosen for moves of one axis; nothing moved",
            ));
        };
        let line = ask(ex, Command::StepTime)?;
        let usual = codec::decode_step_time(&line).ok_or_else(|| {
            refused("the firmware does not tell its step time (dt?), so that no speed is set; nothing moved")
        })?;
        // Rounded up, so that it goes no faster than asked.
        let wanted = (1e6 * motor.si(1).abs() / m_per_s).ceil();
        if wanted > SLOWEST_US {
            return Err(refused(format!(
                "a step would take {wanted} us, more than {SLOWEST_US}; nothing moved"
            )));
        }
        let wanted = wanted as i64;
        if wanted <= usual {
            return Ok(None);
        }
        ex.at_close(&read(ex, Command::SetStepTime(usual).encode())?);
        done(ex, Command::SetStepTime(wanted))?;
        Ok(Some(usual))
    }

    /// The steps to be at, or `None` for a motor that is to stay.
    fn targets(&self, to: &StagePose) -> Result<[Option<i64>; 3], ScopeError> {
        self.info.check_goal(to)?;
        let mut targets = [None; 3];
        for axis in Axis::ALL {
            let Some(asked) = to.si(axis) else { continue };
            let motor = self.motors.iter().position(|(a, _)| *a == axis);
            let motor = motor.and_then(|at| Some((at, self.motors[at].1.as_ref()?)));
            let (at, motor) = motor.ok_or(ScopeError::NoSuchAxis { axis })?;
            targets[at] = Some(motor.steps(asked));
        }
        Ok(targets)
    }
}

impl Stage for SangaStage {
    fn info(&self) -> &StageInfo {
        &self.info
    }

    fn position(&self) -> Result<StagePose, ScopeError> {
        let mut ex = self.session.exchange()?;
        let at = steps(&mut ex)?;
        let mut pose = StagePose::default();
        for ((axis, motor), steps) in self.motors.iter().zip(at) {
            if let Some(motor) = motor {
                pose = pose.with_si(*axis, motor.si(steps));
            }
        }
        Ok(pose)
    }

    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        self.start(to, None)
    }

    fn start_move_at(&self, to: &StagePose, m_per_s: f64) -> Result<(), ScopeError> {
        check_speed(m_per_s)?;
        self.start(to, Some(m_per_s))
    }

    fn knows_speeds(&self) -> bool {
        true
    }

    fn poll(&self) -> Result<Motion, ScopeError> {
        let mut ex = self.session.exchange()?;
        self.poll_in(&mut ex)
    }

    fn stop(&self) -> Result<(), ScopeError> {
        self.session.send_stop()?;
        let mut ex = self.session.exchange()?;
        settle_owed(&mut ex)?;
        let give_up = Instant::now() + self.stop_timeout;
        while moving(&mut ex)? {
            if Instant::now() > give_up {
                return Err(device(
                    "it goes on moving after the command to stop; use the emergency stop",
                ));
            }
            std::thread::sleep(STOP_POLL);
        }
        let mut doing = lock(&self.doing);
        if *doing != Doing::Nothing {
            *doing = Doing::Stopped;
        }
        Ok(())
    }
}

impl Drop for SangaStage {
    fn drop(&mut self) {
        let moving = matches!(*lock(&self.doing), Doing::Moving(_));
        self.session.abandon(moving);
    }
}

/// A decoded answer, or the end of the link.
fn read<T>(ex: &Exchange<'_>, decoded: Result<T, CodecError>) -> Result<T, ScopeError> {
    decoded.map_err(|e| ex.nonsense(e))
}

/// The answer to what was sent last, after those to the stops before it.
fn answer(ex: &mut Exchange<'_>) -> Result<String, ScopeError> {
    let deadline = ex.deadline();
    for _ in 0..ex.take_owed() {
        let line = ex.line(deadline)?;
        read(ex, codec::decode_stopped(&line))?;
    }
    let line = ex.line(deadline)?;
    if ex.has_stray() {
        return Err(ex.nonsense("more came than was asked for"));
    }
    Ok(line)
}

/// Waits for the answers to stops.
fn settle_owed(ex: &mut Exchange<'_>) -> Result<(), ScopeError> {
    let deadline = ex.deadline();
    for _ in 0..ex.take_owed_now() {
        let line = ex.line(deadline)?;
        read(ex, codec::decode_stopped(&line))?;
    }
    Ok(())
}

fn ask(ex: &mut Exchange<'_>, command: Command) -> Result<String, ScopeError> {
    let bytes = read(ex, command.encode())?;
    ex.send(&bytes)?;
    answer(ex)
}

fn done(ex: &mut Exchange<'_>, command: Command) -> Result<(), ScopeError> {
    let line = ask(ex, command)?;
    read(ex, codec::decode_done(command, &line))
}

fn moving(ex: &mut Exchange<'_>) -> Result<bool, ScopeError> {
    let line = ask(ex, Command::IsMoving)?;
    read(ex, codec::decode_moving(&line))
}

fn steps(ex: &mut Exchange<'_>) -> Result<[i64; 3], ScopeError> {
    let line = ask(ex, Command::Position)?;
    read(ex, codec::decode_position(&line))
}
