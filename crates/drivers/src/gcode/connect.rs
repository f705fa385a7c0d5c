//! Taking a board over.

use crate::board::Board;
use crate::gcode::codec::{self, Command, Line, Report};
use crate::gcode::settings::{GcodeSettings, Motor};
use crate::gcode::stage::{Doing, GcodeStage};
use crate::gcode::talk::{PLAN_TOLERANCE_MM, Talk, steps_of};
use crate::link::Transport;
use crate::session::{Exchange, bad_setting, device};
use scopeservo_scope::{Kinematics, PositiveZ, ScopeError, StageInfo};
use std::sync::Mutex;
use std::time::Duration;

/// How long after its start a board says nothing more.
const QUIET: Duration = Duration::from_millis(100);

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
        let board = Board {
            stop: codec::QUICK_STOP,
            max_line_bytes: codec::MAX_LINE_BYTES,
            reply_timeout_ms: settings.reply_timeout_ms,
            boot_ms: settings.boot_ms,
            quiet: QUIET,
        };
        let session = board.open(transport, |line| codec::decode(line) == Line::Start)?;
        let talk = Talk::new(settings.checksums, ms(settings.busy_timeout_ms));
        let mut ex = session.exchange()?;
        if settings.checksums {
            talk.ask(&mut ex, &Command::StartNumbers, None)?;
        }
        let name = firmware(&talk, &mut ex, settings.allow_queued_stop)?;
        drop(ex);
        // A board that does not know the stop must not be driven.
        session.send_stop()?;
        let mut ex = session.exchange()?;
        talk.settle_owed(&mut ex)?;
        talk.ask(&mut ex, &Command::Millimetres, None)?;
        talk.ask(&mut ex, &Command::Absolute, None)?;
        let report = talk.position(&mut ex)?;
        let motors = settings.motors();
        for motor in &motors {
            check_count(&ex, &report, motor)?;
        }
        drop(ex);
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
            feed_mm_per_min: settings.speed_um_per_s * 60e-3,
            homing_timeout: ms(settings.homing_timeout_ms),
            stop_timeout: ms(settings.stop_timeout_ms),
            stall_timeout: ms(settings.stall_timeout_ms),
            still_window: still_window(settings, &motors),
            motors,
            settings: settings.clone(),
            homed: Mutex::default(),
            doing: Mutex::new(Doing::Nothing),
        })
    }
}

/// The name of the firmware, which must take a stop at any time.
fn firmware(
    talk: &Talk,
    ex: &mut Exchange<'_>,
    allow_queued_stop: bool,
) -> Result<String, ScopeError> {
    let firmware = talk.ask(ex, &Command::Firmware, None)?;
    let name = firmware.firmware.ok_or_else(|| {
        let came = ex.passed_over();
        device(format!("it does not say what firmware it has (M115){came}"))
    })?;
    if !firmware.emergency_parser && !allow_queued_stop {
        return Err(device(format!(
            "{name} does not report EMERGENCY_PARSER, so a stop would wait behind other commands; \
             build the firmware with it, or set allow_queued_stop"
        )));
    }
    Ok(name)
}

/// The place that the board plans from must be where it counts its steppers.
fn check_count(ex: &Exchange<'_>, report: &Report, motor: &Motor) -> Result<(), ScopeError> {
    let steps = steps_of(ex, report, motor)?;
    let planned = report.planned_mm_of(motor.letter).unwrap_or(f64::NAN);
    let counted = motor.units(steps);
    let slack = PLAN_TOLERANCE_MM + 2.0 / motor.steps_per_unit;
    if (planned - counted).abs() <= slack {
        return Ok(());
    }
    let (what, unit) = match motor.axis {
        Some(axis) => (axis.to_string(), "mm"),
        None => ("the nosepiece".into(), "deg"),
    };
    Err(bad_setting(format!(
        "{what}: the board says {planned} {unit} but its steppers are at {steps} steps, {counted:.3} {unit} with the \
         steps_per_{unit} of the settings; compare these with M92, and switch off levelling"
    )))
}

/// How long the slowest stepper takes for some steps.
fn still_window(settings: &GcodeSettings, motors: &[Motor]) -> Duration {
    let least = motors.iter().map(|m| match m.axis {
        Some(_) => m.steps_per_unit * settings.speed_um_per_s * 1e-3,
        None => {
            let nosepiece = settings.nosepiece.as_ref();
            m.steps_per_unit * nosepiece.map_or(0.0, |n| n.speed_deg_per_s)
        }
    });
    let steps_per_s = least.fold(f64::INFINITY, f64::min);
    Duration::from_secs_f64((8.0 / steps_per_s).clamp(0.005, 0.5))
}
