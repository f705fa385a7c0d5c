//! The driver: the codec over a session, with what the stage is doing.

use crate::gcs2::codec::{self, AxisName, CodecError, Command};
use crate::gcs2::settings::{AxisPlan, Gcs2Nosepiece, Gcs2Settings};
use crate::link::Transport;
use crate::session::{Exchange, Session, StopBytes, bad_setting, device, lock, refused};
use crate::turret::{Part, Turns, Turret};
use scopeservo_scope::{Axis, AxisInfo, Length, Motion, ScopeError, Stage, StageInfo, StagePose};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// How often the axes are asked whether they stand still after a stop.
const STOP_POLL: Duration = Duration::from_millis(2);

/// A controller that was told to stop reports this.
const STOPPED_BY_COMMAND: i32 = 10;

/// So does one whose axes do not know where they are.
const NOT_REFERENCED: i32 = 5;

/// What it reports of a command that it could read and will not carry out: a place out of reach, a velocity, a pivot, a number out of
/// range.
const REFUSALS: [i32; 4] = [7, 8, 9, 17];

/// What the driver has asked of the stage.
#[derive(Debug, Clone, PartialEq)]
enum Doing {
    Nothing,
    /// On the way to a goal, and since when the axes stand still without being on target.
    Moving {
        part: Part,
        goal: Vec<Goal>,
        still_since: Option<Instant>,
    },
    /// On a reference move.
    Homing(Part),
    /// Stopped on the way.
    Stopped,
}

/// Where an axis goes, in the controller's units, and how near it counts as there.
#[derive(Debug, Clone, PartialEq)]
struct Goal {
    name: AxisName,
    to: f64,
    tolerance: f64,
}

/// A nosepiece on an axis of the controller.
struct Nosepiece {
    name: AxisName,
    settings: Gcs2Nosepiece,
}

/// A stage on a GCS 2 controller, and a nosepiece on another of its axes.
pub struct Gcs2Stage {
    session: Session,
    info: StageInfo,
    plans: Vec<AxisPlan>,
    names: Vec<AxisName>,
    nosepiece: Option<Nosepiece>,
    coupled: bool,
    stop_timeout: Duration,
    settle_timeout: Duration,
    doing: Mutex<Doing>,
    /// Whether the controller has said that it knows where its axes are.
    homed: Mutex<bool>,
}

impl Gcs2Stage {
    /// Takes a controller over: reads who it is, that it has the axes of the settings, and their travel. Nothing moves.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`] for settings that make no sense or name an axis that the controller lacks;
    /// [`ScopeError::Timeout`] or [`ScopeError::Device`] when it does not answer, or not as a GCS 2 controller.
    pub fn connect(
        transport: Box<dyn Transport>,
        settings: &Gcs2Settings,
    ) -> Result<Self, ScopeError> {
        let plans = settings.plans()?;
        let names: Vec<AxisName> = plans.iter().map(|p| p.name.clone()).collect();
        let session = Session::new(
            transport,
            StopBytes {
                bytes: &[codec::STOP_ALL],
                answered: false,
            },
            codec::MAX_LINE_BYTES,
            settings.reply_timeout(),
        );
        let mut ex = session.exchange()?;
        let who = ask(&mut ex, &Command::Identify)?;
        let name = read(&ex, codec::one_line("*IDN?", &who))?
            .trim()
            .to_string();
        let lines = ask(&mut ex, &Command::Axes)?;
        let there = read(&ex, codec::decode_axes(&lines))?;
        let nosepiece = match &settings.nosepiece {
            Some(nosepiece) => {
                Some(AxisName::new(&nosepiece.name).map_err(|e| bad_setting(e.to_string()))?)
            }
            None => None,
        };
        let mut all = names.iter().chain(&nosepiece);
        if let Some(missing) = all.find(|n| !there.contains(n)) {
            let there: Vec<_> = there.iter().map(AxisName::as_str).collect();
            return Err(bad_setting(format!(
                "the controller has no axis {missing}; it has {}",
                there.join(", ")
            )));
        }
        // What was wrong before is not about us.
        error_number(&mut ex)?;
        let low = values(&mut ex, &Command::LowerEnds(&names), &names)?;
        let high = values(&mut ex, &Command::UpperEnds(&names), &names)?;
        let mut axes = Vec::new();
        for ((plan, low), high) in plans.iter().zip(low).zip(high) {
            if low > high {
                return Err(device(format!(
                    "axis {} has a travel from {low} to {high}",
                    plan.name
                )));
            }
            axes.push(AxisInfo {
                axis: plan.axis,
                min: plan.si(low),
                max: plan.si(high),
                repeatability: plan.repeatability_si,
                arrival_tolerance: Some(plan.tolerance_si),
            });
        }
        let nosepiece = match (nosepiece, settings.nosepiece.clone()) {
            (Some(name), Some(settings)) => Some(turning(&mut ex, name, settings)?),
            _ => None,
        };
        drop(ex);
        Ok(Self {
            session,
            nosepiece,
            info: StageInfo {
                name,
                axes,
                kinematics: settings.kinematics,
                positive_z: settings.positive_z,
            },
            plans,
            names,
            coupled: settings.coupled,
            stop_timeout: settings.stop_timeout(),
            settle_timeout: settings.settle_timeout(),
            doing: Mutex::new(Doing::Nothing),
            homed: Mutex::new(false),
        })
    }

    /// The nosepiece that the settings describe, if they do.
    pub fn nosepiece(self: &Arc<Self>) -> Option<Turret> {
        let Gcs2Nosepiece {
            objectives,
            arrival_tolerance_deg,
            ..
        } = &self.nosepiece.as_ref()?.settings;
        let axis = self.clone();
        Some(Turret::new(axis, objectives, *arrival_tolerance_deg, false))
    }

    fn names_of(&self, part: Part) -> &[AxisName] {
        match (part, &self.nosepiece) {
            (Part::Nosepiece, Some(nosepiece)) => std::slice::from_ref(&nosepiece.name),
            (Part::Nosepiece, None) => &[],
            (Part::Stage, _) => &self.names,
        }
    }

    fn home_part(&self, part: Part) -> Result<(), ScopeError> {
        let stops = self.session.stops();
        let mut ex = self.session.exchange()?;
        if self.poll_in(&mut ex)? == Motion::Moving {
            return Err(ScopeError::Busy { device: "stage" });
        }
        let bytes = read(&ex, Command::Reference(self.names_of(part)).encode())?;
        ex.send_unless_stopped(&bytes, stops)?;
        if part == Part::Stage {
            *lock(&self.homed) = false;
        }
        *lock(&self.doing) = Doing::Homing(part);
        // A controller on a reference move may take no lines; how it began is asked when it does.
        if ready(&mut ex)? {
            let number = error_number(&mut ex)?;
            if number != 0 {
                *lock(&self.doing) = Doing::Stopped;
                return Err(refusal(number));
            }
        }
        Ok(())
    }

    /// Whether every axis of a part knows where it is. `false` while a reference move runs.
    fn is_part_homed(&self, part: Part) -> Result<bool, ScopeError> {
        let mut ex = self.session.exchange()?;
        if self.is_homing() && self.poll_in(&mut ex)? == Motion::Moving {
            return Ok(false);
        }
        self.referenced(&mut ex, part)
    }

    /// The point that the platform turns about.
    ///
    /// # Errors
    /// [`ScopeError::Timeout`] or [`ScopeError::Device`] when the controller does not answer as it should, and while a reference move
    /// runs [`ScopeError::Busy`].
    pub fn pivot(&self) -> Result<[Length; 3], ScopeError> {
        let mut ex = self.exchange_unless_homing()?;
        let names = ["X", "Y", "Z"].map(AxisName::new);
        let names: Result<Vec<_>, _> = names.into_iter().collect();
        let names = read(&ex, names)?;
        let mm = values(&mut ex, &Command::Pivot, &names)?;
        Ok([0, 1, 2].map(|i| Length::from_um(mm[i] * 1e3)))
    }

    /// Sets the point that the platform turns about. The controller allows it only while all rotations are zero.
    ///
    /// # Errors
    /// [`ScopeError::Device`] with the controller's reason, and as [`Gcs2Stage::pivot`].
    pub fn set_pivot(&self, point: [Length; 3]) -> Result<(), ScopeError> {
        self.set(&Command::SetPivot(point.map(|p| p.um() * 1e-3)))
    }

    /// The velocity of a hexapod's platform.
    ///
    /// # Errors
    /// As [`Gcs2Stage::pivot`].
    pub fn platform_velocity_um_per_s(&self) -> Result<f64, ScopeError> {
        let mut ex = self.exchange_unless_homing()?;
        let lines = ask(&mut ex, &Command::PlatformVelocity)?;
        Ok(1e3 * read(&ex, codec::decode_number("VLS?", &lines))?)
    }

    /// Sets the velocity of a hexapod's platform.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`] unless it is positive, [`ScopeError::Device`] with the controller's reason, and as
    /// [`Gcs2Stage::pivot`].
    pub fn set_platform_velocity_um_per_s(&self, velocity: f64) -> Result<(), ScopeError> {
        positive(velocity)?;
        self.set(&Command::SetPlatformVelocity(velocity * 1e-3))
    }

    /// The velocity of one axis of its own, m/s or rad/s.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchAxis`], and as [`Gcs2Stage::pivot`].
    pub fn velocity_si(&self, axis: Axis) -> Result<f64, ScopeError> {
        let plan = self.plan(axis)?;
        let mut ex = self.exchange_unless_homing()?;
        let names = [plan.name.clone()];
        let answer = values(&mut ex, &Command::Velocities(&names), &names)?;
        Ok(plan.si(answer[0]))
    }

    /// Sets the velocity of one axis of its own, m/s or rad/s.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchAxis`]; [`ScopeError::BadSetting`] unless the velocity is positive; [`ScopeError::Device`]
    /// with the controller's reason; and as [`Gcs2Stage::pivot`].
    pub fn set_velocity_si(&self, axis: Axis, velocity: f64) -> Result<(), ScopeError> {
        let plan = self.plan(axis)?;
        positive(velocity)?;
        self.set(&Command::SetVelocities(&[(
            plan.name.clone(),
            plan.wire(velocity),
        )]))
    }

    /// Ends the motion smoothly, where [`Stage::stop`] ends it abruptly. Returns when the command was taken.
    ///
    /// # Errors
    /// As [`Gcs2Stage::pivot`]; a reference move can only be stopped.
    pub fn halt(&self) -> Result<(), ScopeError> {
        let mut ex = self.exchange_unless_homing()?;
        let bytes = read(&ex, Command::Halt(&self.names).encode())?;
        ex.send(&bytes)?;
        match error_number(&mut ex)? {
            0 | STOPPED_BY_COMMAND => {
                self.mark_stopped();
                Ok(())
            }
            number => Err(refusal(number)),
        }
    }

    fn plan(&self, axis: Axis) -> Result<&AxisPlan, ScopeError> {
        self.plans
            .iter()
            .find(|p| p.axis == axis)
            .ok_or(ScopeError::NoSuchAxis { axis })
    }

    fn is_homing(&self) -> bool {
        matches!(*lock(&self.doing), Doing::Homing(_))
    }

    fn exchange_unless_homing(&self) -> Result<Exchange<'_>, ScopeError> {
        let mut ex = self.session.exchange()?;
        if self.is_homing() && self.poll_in(&mut ex)? == Motion::Moving {
            return Err(ScopeError::Busy { device: "stage" });
        }
        Ok(ex)
    }

    /// A command without an answer, and how it went.
    fn set(&self, command: &Command<'_>) -> Result<(), ScopeError> {
        let bytes = command.encode().map_err(|e| bad_setting(e.to_string()))?;
        let mut ex = self.exchange_unless_homing()?;
        ex.send(&bytes)?;
        match error_number(&mut ex)? {
            0 => Ok(()),
            number => Err(refusal(number)),
        }
    }

    fn referenced(&self, ex: &mut Exchange<'_>, part: Part) -> Result<bool, ScopeError> {
        let names = self.names_of(part);
        let homed = all_set(ex, &Command::Referenced(names), names)?;
        if part == Part::Stage {
            *lock(&self.homed) = homed;
        }
        Ok(homed)
    }

    fn mark_stopped(&self) {
        let mut doing = lock(&self.doing);
        if *doing != Doing::Nothing {
            *doing = Doing::Stopped;
        }
    }

    fn poses_in(&self, ex: &mut Exchange<'_>) -> Result<StagePose, ScopeError> {
        let at = values(ex, &Command::Positions(&self.names), &self.names)?;
        let set =
            |pose: StagePose, (plan, v): (&AxisPlan, f64)| pose.with_si(plan.axis, plan.si(v));
        Ok(self.plans.iter().zip(at).fold(StagePose::default(), set))
    }

    fn poll_in(&self, ex: &mut Exchange<'_>) -> Result<Motion, ScopeError> {
        let doing = lock(&self.doing).clone();
        if let Doing::Homing(_) = doing {
            if !ready(ex)? {
                return Ok(Motion::Moving);
            }
            let number = error_number(ex)?;
            if number != 0 {
                *lock(&self.doing) = Doing::Stopped;
                return match number {
                    STOPPED_BY_COMMAND => Ok(Motion::Stopped),
                    other => Err(device(codec::error_in_words(other))),
                };
            }
        }
        if moving(ex)? {
            if let Doing::Moving { still_since, .. } = &mut *lock(&self.doing) {
                *still_since = None;
            }
            return Ok(Motion::Moving);
        }
        let (ended, outcome) = match doing {
            Doing::Nothing => return Ok(Motion::Settled),
            Doing::Stopped => return Ok(Motion::Stopped),
            Doing::Homing(part) => (true, self.referenced(ex, part)?),
            Doing::Moving {
                part,
                goal,
                still_since,
            } => {
                let names = self.names_of(part);
                let on_target = all_set(ex, &Command::OnTarget(names), names)?;
                let since = still_since.unwrap_or_else(Instant::now);
                if let Doing::Moving { still_since, .. } = &mut *lock(&self.doing) {
                    *still_since = Some(since);
                }
                let late = since.elapsed() > self.settle_timeout;
                // Others can stop the controller too, and it then counts as on target where it stands.
                (on_target || late, on_target && at(ex, &goal)?)
            }
        };
        if !ended {
            return Ok(Motion::Moving);
        }
        let (next, motion) = if outcome {
            (Doing::Nothing, Motion::Settled)
        } else {
            (Doing::Stopped, Motion::Stopped)
        };
        *lock(&self.doing) = next;
        Ok(motion)
    }

    /// The request in the controller's names and units, inside the travel.
    fn targets(&self, to: &StagePose) -> Result<Vec<Goal>, ScopeError> {
        self.info.check_goal(to)?;
        let mut targets = Vec::new();
        for axis in Axis::ALL {
            let Some(asked) = to.si(axis) else { continue };
            let plan = self.plan(axis)?;
            targets.push(Goal {
                name: plan.name.clone(),
                to: plan.wire(asked),
                tolerance: plan.wire(plan.tolerance_si),
            });
        }
        Ok(targets)
    }

    /// Starts a move of axes of one part.
    fn start(&self, part: Part, goal: Vec<Goal>) -> Result<(), ScopeError> {
        let stops = self.session.stops();
        let mut ex = self.session.exchange()?;
        if self.poll_in(&mut ex)? == Motion::Moving {
            return Err(ScopeError::Busy { device: "stage" });
        }
        if !self.referenced(&mut ex, part)? {
            return Err(not_homed());
        }
        if goal.is_empty() {
            return Ok(());
        }
        let targets: Vec<_> = goal.iter().map(|g| (g.name.clone(), g.to)).collect();
        if self.coupled && part == Part::Stage {
            let lines = ask(&mut ex, &Command::CanReach(&targets))?;
            if !read(&ex, codec::decode_reachable(&lines))? {
                return Err(refused(
                    "the pose cannot be reached: what one axis can do depends on the others; nothing moved. \
                     Move nearer to the middle of the travel",
                ));
            }
        }
        let bytes = read(&ex, Command::Move(&targets).encode())?;
        ex.send_unless_stopped(&bytes, stops)?;
        // Moving from here on, should the next answer not come.
        *lock(&self.doing) = Doing::Moving {
            part,
            goal,
            still_since: None,
        };
        let number = error_number(&mut ex)?;
        if number == STOPPED_BY_COMMAND {
            // It may speak of a stop before the move.
            *lock(&self.doing) = Doing::Stopped;
            self.session.send_stop()?;
        } else if number != 0 {
            *lock(&self.doing) = Doing::Nothing;
        }
        match number {
            0 => Ok(()),
            number => Err(refusal(number)),
        }
    }

    /// Waits until the axes stand still, and says whether they do.
    fn wait_still(&self, ex: &mut Exchange<'_>) -> Result<bool, ScopeError> {
        let homing = self.is_homing();
        let give_up = Instant::now() + self.stop_timeout;
        loop {
            if !moving(ex)? && (!homing || ready(ex)?) {
                return Ok(true);
            }
            if Instant::now() >= give_up {
                return Ok(false);
            }
            std::thread::sleep(STOP_POLL);
        }
    }
}

impl Stage for Gcs2Stage {
    fn info(&self) -> &StageInfo {
        &self.info
    }

    fn position(&self) -> Result<StagePose, ScopeError> {
        let mut ex = self.exchange_unless_homing()?;
        // An axis that does not know where it is reads zero.
        let known = *lock(&self.homed);
        if !known && !self.referenced(&mut ex, Part::Stage)? {
            return Err(not_homed());
        }
        self.poses_in(&mut ex)
    }

    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        self.start(Part::Stage, self.targets(to)?)
    }

    fn poll(&self) -> Result<Motion, ScopeError> {
        let mut ex = self.session.exchange()?;
        self.poll_in(&mut ex)
    }

    fn stop(&self) -> Result<(), ScopeError> {
        self.session.send_stop()?;
        let mut ex = self.session.exchange()?;
        if !self.wait_still(&mut ex)? {
            let line = read(&ex, Command::Stop.encode())?;
            ex.send(&line)?;
            if !self.wait_still(&mut ex)? {
                return Err(device(
                    "it goes on moving after two commands to stop; use the emergency stop",
                ));
            }
        }
        let number = error_number(&mut ex)?;
        self.mark_stopped();
        match number {
            0 | STOPPED_BY_COMMAND => Ok(()),
            other => Err(device(codec::error_in_words(other))),
        }
    }

    fn is_homed(&self) -> Result<bool, ScopeError> {
        self.is_part_homed(Part::Stage)
    }

    fn start_homing(&self) -> Result<(), ScopeError> {
        self.home_part(Part::Stage)
    }
}

impl Turns for Gcs2Stage {
    fn is_homed(&self) -> Result<bool, ScopeError> {
        self.is_part_homed(Part::Nosepiece)
    }

    fn start_homing(&self) -> Result<(), ScopeError> {
        self.home_part(Part::Nosepiece)
    }

    fn place_deg(&self) -> Result<f64, ScopeError> {
        let mut ex = self.exchange_unless_homing()?;
        let names = self.names_of(Part::Nosepiece);
        let at = values(&mut ex, &Command::Positions(names), names)?;
        at.first().copied().ok_or_else(no_nosepiece)
    }

    fn start_turn(&self, to_deg: f64) -> Result<(), ScopeError> {
        let nosepiece = self.nosepiece.as_ref().ok_or_else(no_nosepiece)?;
        let goal = Goal {
            name: nosepiece.name.clone(),
            to: to_deg,
            tolerance: nosepiece.settings.arrival_tolerance_deg,
        };
        self.start(Part::Nosepiece, vec![goal])
    }

    fn poll_turn(&self) -> Result<Motion, ScopeError> {
        self.poll()
    }

    fn stop_turn(&self) -> Result<(), ScopeError> {
        self.stop()
    }

    fn invalidate_position(&self) {
        // It measures where its axes are.
    }
}

fn no_nosepiece() -> ScopeError {
    bad_setting("the settings of this controller name no nosepiece")
}

/// A nosepiece whose places all lie within the travel of its axis.
fn turning(
    ex: &mut Exchange<'_>,
    name: AxisName,
    settings: Gcs2Nosepiece,
) -> Result<Nosepiece, ScopeError> {
    let names = [name.clone()];
    let low = values(ex, &Command::LowerEnds(&names), &names)?;
    let high = values(ex, &Command::UpperEnds(&names), &names)?;
    let within = |deg: f64| (low[0]..=high[0]).contains(&deg);
    match settings.objectives.iter().find(|o| !within(o.at_deg)) {
        Some(outside) => Err(bad_setting(format!(
            "{} stands at {} deg, and the axis {name} goes from {} to {} deg",
            outside.id, outside.at_deg, low[0], high[0]
        ))),
        None => Ok(Nosepiece { name, settings }),
    }
}

/// Whether axes stand where they were sent, within the tolerances.
fn at(ex: &mut Exchange<'_>, goal: &[Goal]) -> Result<bool, ScopeError> {
    let names: Vec<AxisName> = goal.iter().map(|g| g.name.clone()).collect();
    let there = values(ex, &Command::Positions(&names), &names)?;
    let near = |(goal, there): (&Goal, f64)| (goal.to - there).abs() <= goal.tolerance;
    Ok(goal.iter().zip(there).all(near))
}

impl Drop for Gcs2Stage {
    fn drop(&mut self) {
        let moving = matches!(*lock(&self.doing), Doing::Moving { .. } | Doing::Homing(_));
        self.session.abandon(moving);
    }
}

fn not_homed() -> ScopeError {
    ScopeError::NotHomed { device: "stage" }
}

fn positive(velocity: f64) -> Result<(), ScopeError> {
    if velocity.is_finite() && velocity > 0.0 {
        Ok(())
    } else {
        Err(bad_setting("a velocity must be positive"))
    }
}

/// What an error number of the controller in answer to a command means for the caller: the command was refused, was stopped, or was
/// none, which is a fault of ours.
fn refusal(number: i32) -> ScopeError {
    match number {
        STOPPED_BY_COMMAND => ScopeError::Interrupted { at: None },
        NOT_REFERENCED => not_homed(),
        number if REFUSALS.contains(&number) => refused(codec::error_in_words(number)),
        other => device(codec::error_in_words(other)),
    }
}

/// A decoded answer, or the end of the link.
fn read<T>(ex: &Exchange<'_>, decoded: Result<T, CodecError>) -> Result<T, ScopeError> {
    decoded.map_err(|e| ex.nonsense(e))
}

/// Sends a question.
fn put(ex: &mut Exchange<'_>, command: &Command<'_>) -> Result<(), ScopeError> {
    let bytes = read(ex, command.encode())?;
    ex.send(&bytes)
}

/// A question and the lines of its answer.
fn ask(ex: &mut Exchange<'_>, command: &Command<'_>) -> Result<Vec<String>, ScopeError> {
    put(ex, command)?;
    let deadline = ex.deadline();
    let mut lines = Vec::new();
    loop {
        let raw = ex.line(deadline)?;
        let (line, more) = codec::line_and_more(&raw);
        lines.push(line.to_string());
        if !more {
            break;
        }
        if lines.len() >= codec::MAX_LINES {
            return Err(ex.nonsense(format!(
                "more than {} lines to {}",
                codec::MAX_LINES,
                command.name()
            )));
        }
    }
    complete(ex, command)?;
    Ok(lines)
}

fn complete(ex: &Exchange<'_>, command: &Command<'_>) -> Result<(), ScopeError> {
    if ex.has_more() {
        return Err(ex.nonsense(format!("more came than the answer to {}", command.name())));
    }
    Ok(())
}

fn ready(ex: &mut Exchange<'_>) -> Result<bool, ScopeError> {
    put(ex, &Command::Ready)?;
    let line = ex.line_bytes(ex.deadline())?;
    complete(ex, &Command::Ready)?;
    read(ex, codec::decode_ready(&line))
}

fn moving(ex: &mut Exchange<'_>) -> Result<bool, ScopeError> {
    let lines = ask(ex, &Command::MotionStatus)?;
    read(ex, codec::decode_moving(&lines))
}

fn error_number(ex: &mut Exchange<'_>) -> Result<i32, ScopeError> {
    let lines = ask(ex, &Command::Error)?;
    read(ex, codec::decode_error(&lines))
}

fn values(
    ex: &mut Exchange<'_>,
    command: &Command<'_>,
    names: &[AxisName],
) -> Result<Vec<f64>, ScopeError> {
    let lines = ask(ex, command)?;
    read(ex, codec::decode_values(command.name(), names, &lines))
}

fn all_set(
    ex: &mut Exchange<'_>,
    command: &Command<'_>,
    names: &[AxisName],
) -> Result<bool, ScopeError> {
    let lines = ask(ex, command)?;
    let flags = read(ex, codec::decode_flags(command.name(), names, &lines))?;
    Ok(flags.into_iter().all(|set| set))
}
