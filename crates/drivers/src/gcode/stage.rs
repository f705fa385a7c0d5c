//! The driver: the codec over a session, with what the stage is doing.

use crate::gcode::codec::{self, Command, Line, Report};
use crate::gcode::settings::{GcodeSettings, Motor};
use crate::link::Transport;
use crate::session::{Exchange, Session, StopBytes, bad_setting, device, lock, refused};
use crate::turret::{Part, Turns, Turret};
use scopeservo_scope::{
    Axis, Kinematics, Motion, PositiveZ, ScopeError, Stage, StageInfo, StagePose,
};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// How often a damaged line is sent again.
const SENDINGS: usize = 4;
/// How long a look at whether homing has ended may take.
const GLANCE: Duration = Duration::from_millis(2);
/// What the board's two decimals of a millimetre hide.
const PLAN_TOLERANCE_MM: f64 = 0.011;
/// How long after its start a board says nothing more.
const QUIET: Duration = Duration::from_millis(100);

/// What the driver has asked of the stage.
#[derive(Debug, Clone, PartialEq)]
enum Doing {
    Nothing,
    /// On the way to a goal, in steps; where it was last seen, and since when it has stood there.
    Moving {
        goal: Vec<Option<i64>>,
        seen: Vec<i64>,
        since: Instant,
    },
    /// Homing: what, for a nosepiece where all stood before, the line's number, answers to earlier stops that come first, the stops before it, and
    /// when to give up.
    Homing {
        part: Part,
        before: Vec<i64>,
        number: Option<u32>,
        owed: u32,
        stops: u64,
        give_up: Instant,
    },
    /// Stopped on the way.
    Stopped,
}

/// A stage on a G-code board, or a nosepiece, or both.
///
/// A stop ends the step pulses at once. Fast and heavy axes can run on by some steps that the board does not count; where
/// that can be, home again after a stop.
pub struct GcodeStage {
    session: Session,
    talk: Talk,
    info: StageInfo,
    motors: Vec<Motor>,
    feed_mm_per_min: f64,
    homing_timeout: Duration,
    stop_timeout: Duration,
    stall_timeout: Duration,
    /// Steppers that have not moved for so long stand still.
    still_window: Duration,
    settings: GcodeSettings,
    homed: Mutex<Homed>,
    doing: Mutex<Doing>,
}

/// What was homed over this connection.
#[derive(Debug, Clone, Copy, Default)]
struct Homed {
    stage: bool,
    nosepiece: bool,
}

impl Homed {
    fn of(&mut self, part: Part) -> &mut bool {
        match part {
            Part::Stage => &mut self.stage,
            Part::Nosepiece => &mut self.nosepiece,
        }
    }
}

/// What a board said before its "ok".
#[derive(Debug, Default)]
struct Answer {
    report: Option<Report>,
    emergency_parser: bool,
    firmware: Option<String>,
}

/// Sends commands with numbers and reads what comes until they are done.
struct Talk {
    /// The number of the last line sent; `None` without checksums.
    last: Mutex<Option<u32>>,
    busy_timeout: Duration,
}

impl Talk {
    fn next(&self) -> Option<u32> {
        let mut last = lock(&self.last);
        if let Some(number) = &mut *last {
            *number += 1;
        }
        *last
    }

    /// The board has not taken the last line.
    fn take_back(&self) {
        if let Some(number) = &mut *lock(&self.last) {
            *number = number.saturating_sub(1);
        }
    }

    /// One command, sent again while it arrives damaged; a move is not sent when a stop came after `stops`.
    fn ask(
        &self,
        ex: &mut Exchange<'_>,
        command: &Command<'_>,
        stops: Option<u64>,
    ) -> Result<Answer, ScopeError> {
        let number = match command {
            // This is the one that sets the numbers.
            Command::StartNumbers => *lock(&self.last),
            _ => self.next(),
        };
        let bytes = match command.encode(number) {
            Ok(bytes) => bytes,
            Err(e) => {
                self.take_back();
                return Err(bad_setting(e.to_string()));
            }
        };
        for _ in 0..SENDINGS {
            let sent = match stops {
                Some(stops) => ex.send_unless_stopped(&bytes, stops),
                None => ex.send(&bytes),
            };
            if let Err(e) = sent {
                self.take_back();
                return Err(e);
            }
            let owed = ex.take_owed();
            let no = |why| of_command(command, why);
            if let Some(answer) = self.answer(ex, owed, number, &no)? {
                return Ok(answer);
            }
        }
        Err(ex.nonsense(format!("a line arrived damaged {SENDINGS} times")))
    }

    /// Reads until the board is done with `owed` stops and the line with `number`. `None`: the line arrived damaged.
    /// `no` is what it means that the board will not carry it out.
    fn answer(
        &self,
        ex: &mut Exchange<'_>,
        mut owed: u32,
        number: Option<u32>,
        no: &dyn Fn(String) -> ScopeError,
    ) -> Result<Option<Answer>, ScopeError> {
        let give_up = Instant::now() + self.busy_timeout;
        let mut deadline = ex.deadline();
        let mut answer = Answer::default();
        let (mut damaged, mut refused) = (false, None);
        loop {
            let line = ex.line(deadline.min(give_up))?;
            match codec::decode(&line) {
                Line::Ok if owed > 0 => owed -= 1,
                Line::Ok => {
                    return match refused {
                        _ if damaged => Ok(None),
                        None => Ok(Some(answer)),
                        Some(why) => Err(no(why)),
                    };
                }
                Line::Busy => deadline = ex.deadline(),
                Line::Resend(wanted) => damaged = self.wanted(ex, wanted, number)?,
                Line::Refused(why) => refused = Some(why),
                Line::Position(report) => answer.report = Some(report),
                Line::Firmware(name) => answer.firmware = Some(name),
                Line::Capability(name, can) => {
                    answer.emergency_parser |= can && name == "EMERGENCY_PARSER";
                }
                Line::Start => return Err(restarted(ex)),
                Line::Error(why) => return Err(ex.nonsense(format!("the board says: {why}"))),
                Line::Damaged(_) | Line::Other(_) => {}
            }
        }
    }

    /// Whether the line wanted again is the one that was sent; another one nobody has any more.
    fn wanted(
        &self,
        ex: &Exchange<'_>,
        wanted: u32,
        number: Option<u32>,
    ) -> Result<bool, ScopeError> {
        // Line 0 starts the numbers: until it arrives the board goes on from those of the driver before.
        if Some(wanted) == number || number == Some(0) {
            return Ok(true);
        }
        Err(ex.nonsense(format!("the board wants line {wanted} again")))
    }
}

/// What a board says of a line that it read and will not carry out: of a move it is a refusal, of anything else a board that cannot do
/// what it must.
fn of_command(command: &Command<'_>, why: String) -> ScopeError {
    match command {
        Command::Move { .. } if codec::wants_homing(&why) => {
            ScopeError::NotHomed { device: "stage" }
        }
        Command::Move { .. } => refused(why),
        _ => device(why),
    }
}

fn restarted(ex: &Exchange<'_>) -> ScopeError {
    ex.nonsense("the board started anew and no longer knows where the stage is")
}

impl GcodeStage {
    /// Takes a board over: waits for its start, reads what it is, tries its stop, sets millimetres and absolute
    /// positions, and compares its steppers with its own count. Nothing moves.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`] for settings that make no sense or do not fit the board; [`ScopeError::Device`] for a
    /// board that cannot stop at any time; [`ScopeError::Timeout`] or [`ScopeError::Device`] when it does not answer, or
    /// not as such a board.
    pub fn connect(
        transport: Box<dyn Transport>,
        settings: &GcodeSettings,
    ) -> Result<Self, ScopeError> {
        let axes = settings.checked()?;
        let ms = Duration::from_millis;
        let stop = StopBytes {
            bytes: codec::QUICK_STOP,
            answered: true,
        };
        let session = Session::new(
            transport,
            stop,
            codec::MAX_LINE_BYTES,
            ms(settings.reply_timeout_ms),
        );
        let talk = Talk {
            last: Mutex::new(settings.checksums.then_some(0)),
            busy_timeout: ms(settings.busy_timeout_ms),
        };
        let mut ex = session.exchange()?;
        wait_for_start(&mut ex, ms(settings.boot_ms))?;
        if settings.checksums {
            talk.ask(&mut ex, &Command::StartNumbers, None)?;
        }
        let firmware = talk.ask(&mut ex, &Command::Firmware, None)?;
        let name = firmware
            .firmware
            .ok_or_else(|| device("it does not say what firmware it has (M115)"))?;
        if !firmware.emergency_parser && !settings.allow_queued_stop {
            return Err(device(format!(
                "{name} does not report EMERGENCY_PARSER, so a stop would wait behind other commands; \
                 build the firmware with it, or set allow_queued_stop"
            )));
        }
        drop(ex);
        // A board that does not know the stop must not be driven.
        session.send_stop()?;
        let mut ex = session.exchange()?;
        settle_owed(&talk, &mut ex)?;
        talk.ask(&mut ex, &Command::Millimetres, None)?;
        talk.ask(&mut ex, &Command::Absolute, None)?;
        let report = position(&talk, &mut ex)?;
        let motors = settings.motors();
        for motor in &motors {
            let steps = steps_of(&ex, &report, motor)?;
            let planned = report.planned_mm_of(motor.letter).unwrap_or(f64::NAN);
            let counted = motor.units(steps);
            let slack = PLAN_TOLERANCE_MM + 2.0 / motor.steps_per_unit;
            if (planned - counted).abs() <= slack {
                continue;
            }
            let (what, unit) = match motor.axis {
                Some(axis) => (axis.to_string(), "mm"),
                None => ("the nosepiece".into(), "deg"),
            };
            return Err(bad_setting(format!(
                "{what}: the board says {planned} {unit} but its steppers are at {steps} steps, {counted:.3} {unit} with the \
                 steps_per_{unit} of the settings; compare these with M92, and switch off levelling"
            )));
        }
        drop(ex);
        let least = motors.iter().map(|m| match m.axis {
            Some(_) => m.steps_per_unit * settings.speed_um_per_s * 1e-3,
            None => {
                let nosepiece = settings.nosepiece.as_ref();
                m.steps_per_unit * nosepiece.map_or(0.0, |n| n.speed_deg_per_s)
            }
        });
        let steps_per_s = least.fold(f64::INFINITY, f64::min);
        Ok(Self {
            session,
            talk,
            info: StageInfo {
                name,
                axes,
                // Of no meaning without axes.
                kinematics: settings.kinematics.unwrap_or(Kinematics::SpecimenXyOnTop),
                positive_z: settings.positive_z.unwrap_or(PositiveZ::Closer),
            },
            motors,
            feed_mm_per_min: settings.speed_um_per_s * 60e-3,
            homing_timeout: ms(settings.homing_timeout_ms),
            stop_timeout: ms(settings.stop_timeout_ms),
            stall_timeout: ms(settings.stall_timeout_ms),
            still_window: Duration::from_secs_f64((8.0 / steps_per_s).clamp(0.005, 0.5)),
            settings: settings.clone(),
            homed: Mutex::default(),
            doing: Mutex::new(Doing::Nothing),
        })
    }

    /// The nosepiece that the settings describe, if they do.
    pub fn nosepiece(self: &Arc<Self>) -> Option<Turret> {
        let nosepiece = self.settings.nosepiece.as_ref()?;
        Some(Turret::new(
            self.clone(),
            &nosepiece.objectives,
            nosepiece.arrival_tolerance_deg,
            !nosepiece.needs_homing,
        ))
    }

    fn home_part(&self, part: Part) -> Result<(), ScopeError> {
        let stops = self.session.stops();
        let mut ex = self.session.exchange()?;
        if self.poll_in(&mut ex)? == Motion::Moving {
            return Err(ScopeError::Busy { device: "stage" });
        }
        let all = self.motors.iter();
        let letters: Vec<char> = all.filter(|m| m.part() == part).map(|m| m.letter).collect();
        let command = match (part, &letters[..]) {
            (Part::Nosepiece, [letter]) => Command::HomeInPlace(*letter),
            (_, []) => {
                return Err(bad_setting(
                    "the settings of this board name no axis to home",
                ));
            }
            (_, letters) => Command::Home(letters),
        };
        let before = match part {
            Part::Stage => Vec::new(),
            Part::Nosepiece => self.steps(&mut ex)?,
        };
        let number = self.talk.next();
        let bytes = command.encode(number).map_err(|e| ex.nonsense(e))?;
        if let Err(e) = ex.send_unless_stopped(&bytes, stops) {
            self.talk.take_back();
            return Err(e);
        }
        *lock(&self.homed).of(part) = false;
        *lock(&self.doing) = Doing::Homing {
            part,
            before,
            number,
            owed: ex.take_owed(),
            stops,
            give_up: Instant::now() + self.homing_timeout,
        };
        Ok(())
    }

    /// Whether the stage was homed over this connection, whether or not it has to be.
    ///
    /// # Errors
    /// [`ScopeError::Timeout`] or [`ScopeError::Device`] when the board does not answer as it should.
    pub fn was_homed(&self) -> Result<bool, ScopeError> {
        let mut ex = self.session.exchange()?;
        self.homing_ended(&mut ex, GLANCE)?;
        Ok(*lock(&self.homed).of(Part::Stage))
    }

    /// Whether a part knows where it is. A board does not say whether it was homed before this connection.
    fn is_part_homed(&self, part: Part) -> Result<bool, ScopeError> {
        let mut ex = self.session.exchange()?;
        self.homing_ended(&mut ex, GLANCE)?;
        Ok(self.knows_place(part))
    }

    /// Looks for the end of homing, if it homes. Returns whether it does not home any more.
    fn homing_ended(&self, ex: &mut Exchange<'_>, wait: Duration) -> Result<bool, ScopeError> {
        let Doing::Homing {
            part,
            before,
            number,
            mut owed,
            stops,
            give_up,
        } = lock(&self.doing).clone()
        else {
            return Ok(true);
        };
        let deadline = Instant::now() + wait;
        while let Some(line) = ex.line_if_any(deadline)? {
            match codec::decode(&line) {
                Line::Ok if owed > 0 => {
                    owed -= 1;
                    if let Doing::Homing { owed: kept, .. } = &mut *lock(&self.doing) {
                        *kept = owed;
                    }
                }
                Line::Ok => {
                    let stopped = self.session.stops() != stops;
                    *lock(&self.homed).of(part) = !stopped;
                    *lock(&self.doing) = if stopped {
                        Doing::Stopped
                    } else {
                        Doing::Nothing
                    };
                    if part == Part::Nosepiece {
                        self.check_stage_stayed(ex, &before)?;
                    }
                    return Ok(true);
                }
                Line::Resend(wanted) => {
                    self.talk.wanted(ex, wanted, number)?;
                    // It did not begin. The "ok" that follows belongs to this.
                    self.talk.answer(ex, owed, None, &device)?;
                    self.talk.take_back();
                    *lock(&self.doing) = Doing::Stopped;
                    return Err(device("the command to home arrived damaged; nothing moved"));
                }
                Line::Refused(why) => {
                    self.talk.answer(ex, owed, None, &device)?;
                    *lock(&self.doing) = Doing::Stopped;
                    return Err(device(why));
                }
                Line::Start => return Err(restarted(ex)),
                Line::Error(why) => return Err(ex.nonsense(format!("the board says: {why}"))),
                _ => {}
            }
        }
        if Instant::now() > give_up {
            return Err(ex.overdue());
        }
        Ok(false)
    }

    /// Firmware may lift an axis before it homes another, or home all when it does not know the letter.
    fn check_stage_stayed(&self, ex: &mut Exchange<'_>, before: &[i64]) -> Result<(), ScopeError> {
        let now = self.steps(ex)?;
        let moved = self.motors.iter().zip(before.iter().zip(now));
        let stayed = |(motor, (before, now)): (&Motor, (&i64, i64))| {
            motor.part() == Part::Nosepiece || (before - now).abs() <= 1
        };
        if moved.into_iter().all(stayed) {
            return Ok(());
        }
        let mut homed = lock(&self.homed);
        (homed.stage, homed.nosepiece) = (false, false);
        *lock(&self.doing) = Doing::Stopped;
        Err(device(
            "the stage moved while the nosepiece looked for its switch: set the firmware so that homing that axis lifts nothing \
             (Z_CLEARANCE_FOR_HOMING), look where the stage is, and home it again",
        ))
    }

    fn steps(&self, ex: &mut Exchange<'_>) -> Result<Vec<i64>, ScopeError> {
        let report = position(&self.talk, ex)?;
        let all = self.motors.iter();
        all.map(|motor| steps_of(ex, &report, motor)).collect()
    }

    fn poll_in(&self, ex: &mut Exchange<'_>) -> Result<Motion, ScopeError> {
        if !self.homing_ended(ex, GLANCE)? {
            return Ok(Motion::Moving);
        }
        let doing = lock(&self.doing).clone();
        let (goal, seen, since) = match doing {
            Doing::Stopped => return Ok(Motion::Stopped),
            Doing::Moving { goal, seen, since } => (goal, seen, since),
            _ => return Ok(Motion::Settled),
        };
        let now = self.steps(ex)?;
        let at = |(goal, now): (&Option<i64>, &i64)| goal.is_none_or(|g| (g - now).abs() <= 1);
        if goal.iter().zip(&now).all(at) {
            self.talk.ask(ex, &Command::Finish, None)?;
            *lock(&self.doing) = Doing::Nothing;
            return Ok(Motion::Settled);
        }
        if now == seen && since.elapsed() > self.stall_timeout {
            *lock(&self.doing) = Doing::Stopped;
            return Ok(Motion::Stopped);
        }
        let since = if now == seen { since } else { Instant::now() };
        *lock(&self.doing) = Doing::Moving {
            goal,
            seen: now,
            since,
        };
        Ok(Motion::Moving)
    }

    /// The motors asked for and their places in the board's units, inside the travel.
    fn targets(&self, to: &StagePose) -> Result<Vec<(usize, f64)>, ScopeError> {
        self.info.check_goal(to)?;
        let mut targets = Vec::new();
        for axis in Axis::ALL {
            let Some(asked) = to.si(axis) else { continue };
            let set = self.motors.iter().position(|m| m.axis == Some(axis));
            let set = set.ok_or(ScopeError::NoSuchAxis { axis })?;
            targets.push((set, asked * 1e3));
        }
        Ok(targets)
    }

    fn needs_homing(&self, part: Part) -> bool {
        match part {
            Part::Stage => self.settings.needs_homing,
            Part::Nosepiece => {
                let nosepiece = self.settings.nosepiece.as_ref();
                nosepiece.is_some_and(|n| n.needs_homing)
            }
        }
    }

    fn knows_place(&self, part: Part) -> bool {
        !self.needs_homing(part) || *lock(&self.homed).of(part)
    }

    fn check_homed(&self) -> Result<(), ScopeError> {
        if !self.knows_place(Part::Stage) {
            return Err(ScopeError::NotHomed { device: "stage" });
        }
        Ok(())
    }

    /// Starts a move of motors to places in the board's units.
    fn start(&self, part: Part, targets: &[(usize, f64)], feed: f64) -> Result<(), ScopeError> {
        let stops = self.session.stops();
        let mut ex = self.session.exchange()?;
        if self.poll_in(&mut ex)? == Motion::Moving {
            return Err(ScopeError::Busy { device: "stage" });
        }
        if part == Part::Stage {
            self.check_homed()?;
        }
        if targets.is_empty() {
            return Ok(());
        }
        let mut goal = vec![None; self.motors.len()];
        for (at, place) in targets {
            goal[*at] = Some(self.motors[*at].steps(*place));
        }
        let seen = self.steps(&mut ex)?;
        // Moving from here on, should the answer not come.
        let before = std::mem::replace(
            &mut *lock(&self.doing),
            Doing::Moving {
                goal,
                seen,
                since: Instant::now(),
            },
        );
        let named = targets.iter().map(|(at, v)| (self.motors[*at].letter, *v));
        let named: Vec<(char, f64)> = named.collect();
        let go = Command::Move {
            to_mm: &named,
            feed_mm_per_min: feed,
        };
        if let Err(e) = self.talk.ask(&mut ex, &go, Some(stops)) {
            *lock(&self.doing) = before;
            return Err(e);
        }
        // Firmware clips to its own limits without a word.
        let report = position(&self.talk, &mut ex)?;
        let planned = |(letter, place): &(char, f64)| {
            let there = report.planned_mm_of(*letter).unwrap_or(f64::NAN);
            (there - place).abs() <= PLAN_TOLERANCE_MM
        };
        // A stop meanwhile has changed the plan.
        if self.session.stops() == stops && !named.iter().all(planned) {
            drop(ex);
            self.stop()?;
            return Err(device(
                "the board shortened the move to limits of its own; it was stopped. \
                 Bring the limits in the settings inside those of the firmware",
            ));
        }
        Ok(())
    }

    /// Waits until the steppers stand still, and says whether they do.
    fn wait_still(&self, ex: &mut Exchange<'_>) -> Result<bool, ScopeError> {
        let give_up = Instant::now() + self.stop_timeout;
        let mut seen = self.steps(ex)?;
        loop {
            std::thread::sleep(self.still_window);
            let now = self.steps(ex)?;
            if now == seen {
                return Ok(true);
            }
            if Instant::now() > give_up {
                return Ok(false);
            }
            seen = now;
        }
    }
}

impl Stage for GcodeStage {
    fn info(&self) -> &StageInfo {
        &self.info
    }

    fn position(&self) -> Result<StagePose, ScopeError> {
        let mut ex = self.session.exchange()?;
        if !self.homing_ended(&mut ex, GLANCE)? {
            return Err(ScopeError::Busy { device: "stage" });
        }
        self.check_homed()?;
        let steps = self.steps(&mut ex)?;
        let set = |pose: StagePose, (motor, steps): (&Motor, i64)| match motor.axis {
            Some(axis) => pose.with_si(axis, motor.units(steps) * 1e-3),
            None => pose,
        };
        let all = self.motors.iter().zip(steps);
        Ok(all.fold(StagePose::default(), set))
    }

    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        let targets = self.targets(to)?;
        self.start(Part::Stage, &targets, self.feed_mm_per_min)
    }

    fn poll(&self) -> Result<Motion, ScopeError> {
        let mut ex = self.session.exchange()?;
        self.poll_in(&mut ex)
    }

    fn stop(&self) -> Result<(), ScopeError> {
        self.session.send_stop()?;
        let mut ex = self.session.exchange()?;
        if !self.homing_ended(&mut ex, self.stop_timeout)? {
            return Err(device(
                "it goes on homing and does not take the stop; switch it off if it must stand",
            ));
        }
        settle_owed(&self.talk, &mut ex)?;
        if !self.wait_still(&mut ex)? {
            return Err(device(
                "it goes on moving after the command to stop; use the emergency stop",
            ));
        }
        let mut doing = lock(&self.doing);
        if *doing != Doing::Nothing {
            *doing = Doing::Stopped;
        }
        Ok(())
    }

    fn is_homed(&self) -> Result<bool, ScopeError> {
        self.is_part_homed(Part::Stage)
    }

    fn start_homing(&self) -> Result<(), ScopeError> {
        self.home_part(Part::Stage)
    }
}

impl Motor {
    fn part(&self) -> Part {
        match self.axis {
            Some(_) => Part::Stage,
            None => Part::Nosepiece,
        }
    }
}

impl Turns for GcodeStage {
    fn is_homed(&self) -> Result<bool, ScopeError> {
        self.is_part_homed(Part::Nosepiece)
    }

    fn start_homing(&self) -> Result<(), ScopeError> {
        self.home_part(Part::Nosepiece)
    }

    fn place_deg(&self) -> Result<f64, ScopeError> {
        let mut ex = self.session.exchange()?;
        let steps = self.steps(&mut ex)?;
        let mut all = self.motors.iter().zip(steps);
        all.find(|(motor, _)| motor.part() == Part::Nosepiece)
            .map(|(motor, steps)| motor.units(steps))
            .ok_or_else(no_nosepiece)
    }

    fn start_turn(&self, to_deg: f64) -> Result<(), ScopeError> {
        let nosepiece = self.settings.nosepiece.as_ref().ok_or_else(no_nosepiece)?;
        // It stands behind the stage's motors.
        let targets = [(self.motors.len() - 1, to_deg)];
        self.start(Part::Nosepiece, &targets, nosepiece.speed_deg_per_s * 60.0)
    }

    fn poll_turn(&self) -> Result<Motion, ScopeError> {
        self.poll()
    }

    fn stop_turn(&self) -> Result<(), ScopeError> {
        self.stop()
    }

    fn invalidate_position(&self) {
        lock(&self.homed).nosepiece = false;
    }
}

fn no_nosepiece() -> ScopeError {
    bad_setting("the settings of this board name no nosepiece")
}

impl Drop for GcodeStage {
    fn drop(&mut self) {
        let doing = lock(&self.doing).clone();
        self.session
            .abandon(matches!(doing, Doing::Moving { .. } | Doing::Homing { .. }));
    }
}

/// Passes over what a board says while it starts.
fn wait_for_start(ex: &mut Exchange<'_>, boot: Duration) -> Result<(), ScopeError> {
    let give_up = Instant::now() + boot;
    let mut started = false;
    while Instant::now() < give_up {
        let deadline = if started {
            give_up.min(Instant::now() + QUIET)
        } else {
            give_up
        };
        match ex.line_if_any(deadline)? {
            Some(line) => started |= codec::decode(&line) == Line::Start,
            None if started => return Ok(()),
            None => {}
        }
    }
    Ok(())
}

/// Waits for the answers to stops.
fn settle_owed(talk: &Talk, ex: &mut Exchange<'_>) -> Result<(), ScopeError> {
    match ex.take_owed_now() {
        0 => Ok(()),
        owed => talk.answer(ex, owed - 1, None, &device).map(|_| ()),
    }
}

fn position(talk: &Talk, ex: &mut Exchange<'_>) -> Result<Report, ScopeError> {
    let answer = talk.ask(ex, &Command::Position, None)?;
    answer
        .report
        .ok_or_else(|| ex.nonsense("no position came that can be read (M114)"))
}

fn steps_of(ex: &Exchange<'_>, report: &Report, motor: &Motor) -> Result<i64, ScopeError> {
    report
        .steps_of(motor.letter)
        .ok_or_else(|| ex.nonsense(format!("the position (M114) has no {}", motor.letter)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emulator::gcode::{EmulatedBoard, GcodeEmulator};
    use crate::link::Tcp;

    #[test]
    fn the_answer_to_a_stop_before_it_does_not_end_homing() {
        let emulator = GcodeEmulator::serve(EmulatedBoard::new()).unwrap();
        let settings = r#"{
            "kinematics": "specimen_xy_on_top", "positive_z": "apart", "speed_um_per_s": 2000, "needs_homing": true,
            "boot_ms": 0,
            "axes": [{"axis": "x", "letter": "X", "min_um": 0, "max_um": 50000, "steps_per_mm": 400, "repeatability_um": 5}]
        }"#;
        let tcp = Tcp::connect(&emulator.address(), Duration::from_secs(2)).unwrap();
        let settings = serde_json::from_str(settings).unwrap();
        let stage = GcodeStage::connect(Box::new(tcp), &settings).unwrap();
        // A stop whose caller has not come to read the answer yet.
        stage.session.send_stop().unwrap();
        Stage::start_homing(&stage).unwrap();
        let start = Instant::now();
        while start.elapsed() < Duration::from_millis(100) {
            assert_eq!(stage.poll().unwrap(), Motion::Moving);
        }
        while stage.poll().unwrap() == Motion::Moving {
            assert!(start.elapsed() < Duration::from_secs(3));
        }
        assert!(stage.was_homed().unwrap());
    }
}
