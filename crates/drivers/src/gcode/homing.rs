//! Homing, of the stage or of a nosepiece, and what is known of places by it.

use crate::gcode::codec::{self, Command, Line};
use crate::gcode::settings::Motor;
use crate::gcode::stage::{Doing, GLANCE, GcodeStage};
use crate::gcode::talk::restarted;
use crate::session::{Exchange, bad_setting, device, lock};
use crate::turret::Part;
use scopeservo_scope::{Motion, ScopeError};
use std::time::{Duration, Instant};

impl GcodeStage {
    pub(super) fn home_part(&self, part: Part) -> Result<(), ScopeError> {
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
    pub(super) fn is_part_homed(&self, part: Part) -> Result<bool, ScopeError> {
        let mut ex = self.session.exchange()?;
        self.homing_ended(&mut ex, GLANCE)?;
        Ok(self.knows_place(part))
    }

    /// Looks for the end of homing, if it homes. Returns whether it does not home any more.
    pub(super) fn homing_ended(
        &self,
        ex: &mut Exchange<'_>,
        wait: Duration,
    ) -> Result<bool, ScopeError> {
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
                Line::Ok(_) if owed > 0 => {
                    owed -= 1;
                    if let Doing::Homing { owed: kept, .. } = &mut *lock(&self.doing) {
                        *kept = owed;
                    }
                }
                Line::Ok(_) => {
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

    pub(super) fn check_homed(&self) -> Result<(), ScopeError> {
        if !self.knows_place(Part::Stage) {
            return Err(ScopeError::NotHomed { device: "stage" });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emulator::gcode::{EmulatedBoard, GcodeEmulator};
    use crate::link::Tcp;
    use scopeservo_scope::Stage;

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
