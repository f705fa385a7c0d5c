//! `scopeservo doctor`: what is there, and whether it would work. Nothing moves unless the user allows it.

use crate::answer::Answer;
use crate::args::DoctorArgs;
use crate::desk::Desk;
use crate::error::{CliError, Code};
use crate::trial;
use scopeservo_library::{Calibrations as _, Targets as _};
use scopeservo_scope::conformance::{self, Check};
use scopeservo_scope::{ChangeRule, Frame, Instrument, Motion, Samples, ScopeError};
use scopeservo_servo::sharpness;
use scopeservo_sift::{GrayImage, Options, Sift};
use serde::Serialize;
use serde_json::json;
use std::time::Instant;

/// With fewer features a view cannot be calibrated on.
const ENOUGH_FEATURES: usize = 100;

/// One thing that was looked at.
#[derive(Debug, Serialize)]
pub(crate) struct Finding {
    /// What.
    pub(crate) name: String,
    /// Whether all is well.
    pub(crate) ok: bool,
    /// What was found.
    pub(crate) said: String,
}

impl From<Check> for Finding {
    fn from(check: Check) -> Self {
        Finding {
            name: check.name.into(),
            ok: check.outcome.is_ok(),
            said: check.outcome.err().unwrap_or_default(),
        }
    }
}

/// Tells findings as they come.
pub(crate) struct Findings<'a> {
    answer: &'a Answer,
    all: usize,
    wrong: usize,
}

impl<'a> Findings<'a> {
    pub(crate) fn new(answer: &'a Answer) -> Self {
        Self {
            answer,
            all: 0,
            wrong: 0,
        }
    }

    pub(crate) fn add(&mut self, finding: Finding) {
        let mark = if finding.ok { "ok " } else { "NO " };
        match finding.said.is_empty() {
            true => say!(self.answer, "{mark} {}", finding.name),
            false => say!(self.answer, "{mark} {}: {}", finding.name, finding.said),
        }
        self.all += 1;
        self.wrong += usize::from(!finding.ok);
        self.answer.push("findings", json!(finding));
    }

    fn look(&mut self, name: &str, found: Result<String, String>) {
        let ok = found.is_ok();
        let said = found.unwrap_or_else(|said| said);
        self.add(Finding {
            name: name.into(),
            ok,
            said,
        });
    }

    /// The end: whether all is well.
    pub(crate) fn conclude(self, what: &str) -> Result<bool, CliError> {
        let (all, wrong) = (self.all, self.wrong);
        match wrong {
            0 => say!(self.answer, "{what}: all {all} checks hold"),
            _ => say!(self.answer, "{what}: {wrong} of {all} checks do not hold"),
        }
        self.answer.put(json!({"ok": wrong == 0}));
        Ok(wrong == 0)
    }
}

fn told(error: ScopeError) -> String {
    CliError::from(error).words()
}

pub(crate) fn run(args: &DoctorArgs, answer: &Answer) -> Result<bool, CliError> {
    let mut findings = Findings::new(answer);
    let desk = match Desk::open(&args.instrument, answer) {
        Ok(desk) => desk,
        Err(error) => match error.code() {
            Code::NoDriver | Code::Refused | Code::InUse | Code::Fault => {
                findings.look("the instrument can be opened", Err(error.words()));
                return findings.conclude("doctor");
            }
            // A file that cannot be understood is bad input, not a finding, and neither is a stop.
            _ => return Err(error),
        },
    };
    desk.tell_what_waits(answer);
    for (driver, name) in &desk.drivers {
        findings.look(&format!("driver {driver}"), Ok(name.clone()));
    }
    stage(&desk.scope, &mut findings);
    nosepiece(&desk.scope, &mut findings);
    camera(&desk.scope, &mut findings);
    kept(&desk, &mut findings);
    if args.allow_motion {
        // The smallest steps first.
        let (seen, goes_on) = trial::of_pictures(&desk.scope);
        seen.into_iter().for_each(|finding| findings.add(finding));
        desk.scope.check_cancel()?;
        if !goes_on {
            return findings.conclude(&desk.config.name);
        }
        for check in conformance::check_instrument(&desk.scope) {
            findings.add(check.into());
        }
        if desk.scope.gate().objective_is_reported() {
            say!(
                answer,
                "    which objective is in was taken from you: `focus` and `calibrate` look at the picture"
            );
        }
    } else {
        say!(
            answer,
            "    motion was not tried: `scopeservo doctor --allow-motion`, over a specimen that does not matter, in focus"
        );
    }
    desk.scope.check_cancel()?;
    findings.conclude(&desk.config.name)
}

fn stage(scope: &Instrument, findings: &mut Findings<'_>) {
    let gate = scope.gate();
    let axes: Vec<String> = gate
        .ranges()
        .iter()
        .map(|r| {
            format!(
                "{} {:.0} to {:.0} {}",
                r.axis,
                r.axis.to_display(r.min),
                r.axis.to_display(r.max),
                r.axis.display_unit()
            )
        })
        .collect();
    let name = &gate.info().name;
    findings.look("stage", Ok(format!("{name}; allowed: {}", axes.join(", "))));
    let position = gate.position().map_err(told);
    let shown = position.as_ref().map(|at| {
        let each = gate.ranges().iter().filter_map(|r| {
            let shown = r.axis.to_display(at.si(r.axis)?);
            Some(format!("{} {shown:.2} {}", r.axis, r.axis.display_unit()))
        });
        each.collect::<Vec<_>>().join(", ")
    });
    findings.look("the stage says where it is", shown.map_err(Clone::clone));
    if let Ok(at) = &position {
        let inside = gate.check(at).map_err(told);
        findings.look(
            "it stands where it may",
            inside.map(|()| "inside all limits".into()),
        );
    }
    let still = gate.poll().map_err(told).and_then(|motion| match motion {
        Motion::Moving => Err("it moves although nobody asked it to".into()),
        still => Ok(format!("{still:?}").to_lowercase()),
    });
    findings.look("it stands still", still);
}

fn nosepiece(scope: &Instrument, findings: &mut Findings<'_>) {
    let gate = scope.gate();
    let all: Vec<String> = gate
        .objectives()
        .iter()
        .map(|o| {
            format!(
                "{} ({}x, {} um/px)",
                o.id, o.magnification, o.nominal_um_per_px
            )
        })
        .collect();
    findings.look("objectives", Ok(all.join(", ")));
    let current = gate.current_objective().map_err(told);
    let current = current.map(|id| {
        id.map_or("unknown: the first change will tell".into(), |id| {
            format!("{id} is in the beam")
        })
    });
    findings.look("the nosepiece says where it is", current);
    let rule = match gate.rules().change {
        ChangeRule::Anywhere if gate.objectives().len() < 2 => "there is one objective".into(),
        ChangeRule::Anywhere => "at any height, as the file says".into(),
        ChangeRule::Retracted { z, .. } => format!("from z = {:.0} um on", z * 1e6),
    };
    findings.look("objectives change", Ok(rule));
}

/// Whether the nosepiece would turn where the stage stands, by a rule that names a height.
fn retracted(scope: &Instrument) -> bool {
    let gate = scope.gate();
    matches!(gate.rules().change, ChangeRule::Retracted { .. })
        && gate.at_work().is_ok_and(|work| work.is_none())
}

/// Shares of samples at full scale and above a twentieth of it, and the mean of all, 0 to 1.
fn levels(frame: &Frame) -> [f64; 3] {
    let full = f64::from((1u32 << frame.bit_depth) - 1);
    let (mut saturated, mut lit, mut sum, mut count) = (0u64, 0u64, 0.0, 0u64);
    let mut take = |v: f64| {
        saturated += u64::from(v >= full);
        lit += u64::from(v >= full / 20.0);
        sum += v / full;
        count += 1;
    };
    match &frame.samples {
        Samples::U8(s) => s.iter().for_each(|&v| take(f64::from(v))),
        Samples::U16(s) => s.iter().for_each(|&v| take(f64::from(v))),
    }
    let count = count.max(1) as f64;
    [saturated as f64 / count, lit as f64 / count, sum / count]
}

fn camera(scope: &Instrument, findings: &mut Findings<'_>) {
    let info = scope.camera().info();
    let bits = info.bit_depth;
    let shape = format!(
        "{}; {} x {} px, {bits} bits",
        info.name, info.width, info.height
    );
    findings.look("camera", Ok(shape));
    let exposure = scope.camera().exposure().map_err(told);
    let exposure = exposure.map(|e| format!("{:.2} ms", e.as_secs_f64() * 1e3));
    findings.look("the camera says its exposure", exposure);
    for check in conformance::check_frames(scope) {
        findings.add(check.into());
    }
    let start = Instant::now();
    let frame = match scope.grab() {
        Ok(frame) => frame,
        Err(error) => return findings.look("a picture", Err(told(error))),
    };
    let ms = start.elapsed().as_secs_f64() * 1e3;
    let [saturated, lit, mean] = levels(&frame);
    let light = format!(
        "mean {:.0} % of full scale, {:.1} % saturated, in {ms:.0} ms",
        100.0 * mean,
        100.0 * saturated
    );
    findings.look(
        "the picture's light",
        // Fluorescence is dark but for a few places.
        match (saturated > 0.2, lit < 1e-3) {
            (true, _) => Err(format!(
                "{light}: too bright; shorten the exposure or dim the light"
            )),
            (_, true) => Err(format!(
                "{light}: dark; is the light on and the objective in place?"
            )),
            _ => Ok(light),
        },
    );
    let features = GrayImage::new(frame.width, frame.height, frame.luminance()).and_then(|image| {
        Ok(Sift::new(Options::default())?
            .detect_and_describe(&image)
            .len())
    });
    let seen = features.map_err(|e| e.to_string()).and_then(|n| {
        let seen = format!("{n} features, sharpness {:.4}", sharpness(&frame));
        match n >= ENOUGH_FEATURES {
            // What is in focus is not far away: then the sign or the height is wrong, and the nosepiece would turn here.
            true if retracted(scope) => Err(format!(
                "{seen}; yet z counts as retracted, so that the nosepiece would turn at this height: check the sign of retract_z_um"
            )),
            true => Ok(seen),
            false => Err(format!(
                "{seen}: too little to calibrate or to come back to; focus, or go to a place with structure"
            )),
        }
    });
    findings.look("there is something to see", seen);
}

fn kept(desk: &Desk, findings: &mut Findings<'_>) {
    let objectives = desk.scope.gate().objectives();
    let room = desk.library.try_calibrations(objectives);
    let room = room.and_then(|()| desk.library.try_targets());
    findings.look(
        "calibrations and targets can be kept",
        room.map(|()| desk.library.path().display().to_string())
            .map_err(|e| e.to_string()),
    );
    for objective in objectives {
        let found = match desk.library.calibration(objective) {
            Ok(Some(kept)) => Ok(format!(
                "{:.4} um per pixel, made {}",
                kept.calibration.um_per_px(),
                kept.made
            )),
            Ok(None) => Ok("none yet: made on the way, or by `scopeservo calibrate`".into()),
            Err(error) => Err(error.to_string()),
        };
        findings.look(&format!("calibration of {}", objective.id), found);
    }
    let targets = desk.library.target_names().map_err(|e| e.to_string());
    findings.look(
        "targets",
        targets.map(|names| format!("{} saved", names.len())),
    );
}
