//! `scopeservo doctor`: what is there, and whether it would work. Nothing moves unless the user allows it.

mod words;

use crate::answer::Answer;
use crate::args::DoctorArgs;
use crate::colour::{self, Hope};
use crate::error::{CliError, Code, shell};
use crate::open_instrument::OpenInstrument;
use scopeservo_library::{Calibrations as _, Targets as _};
use scopeservo_scope::conformance;
use scopeservo_station::jobs::{self as found, Check, DoctorInput, DoctorJob};
use scopeservo_station::{News, StationEvent};
use scopeservo_workbench::Told;
use serde::Serialize;
use serde_json::json;

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

impl From<conformance::Check> for Finding {
    fn from(check: conformance::Check) -> Self {
        (&found::Finding::from(check)).into()
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
        let mark = match finding.ok {
            true => "ok ".into(),
            false => colour::verdict("NO ", Hope::Failed),
        };
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

pub(crate) fn run(args: &DoctorArgs, answer: &Answer) -> Result<bool, CliError> {
    let mut findings = Findings::new(answer);
    let opened = match OpenInstrument::open(&args.instrument, answer) {
        Ok(opened) => opened,
        Err(error) => match error.code() {
            Code::NoDriver | Code::Refused | Code::InUse | Code::Fault => {
                findings.look("the instrument can be opened", Err(error.words()));
                return findings.conclude("doctor");
            }
            // A file that cannot be understood is bad input, not a finding, and neither is a stop.
            _ => return Err(error),
        },
    };
    opened.tell_what_waits(answer);
    for (driver, name) in &opened.drivers {
        findings.look(&format!("driver {driver}"), Ok(name.clone()));
    }
    let job = DoctorJob::new(DoctorInput {
        allow_motion: args.allow_motion,
    });
    // What is kept is looked at before the instrument is tried.
    let mut is_kept_told = false;
    let ended = opened.console.follow(job, |told| {
        if let Told::Event(record) = told
            && let News::Station(StationEvent::Found { finding }) = &record.news
        {
            if finding.of_trial && !is_kept_told {
                kept(&opened, &mut findings);
                is_kept_told = true;
            }
            findings.add(finding.as_ref().into());
        }
    })?;
    if !is_kept_told {
        kept(&opened, &mut findings);
    }
    let found = ended?.findings;
    let is_tried = |f: &found::Finding| f.of_trial && matches!(f.check, Check::Contract { .. });
    if !args.allow_motion {
        say!(
            answer,
            "    motion was not tried: `scopeservo doctor --allow-motion`, over a specimen that does not matter, in focus"
        );
    } else if found.iter().any(is_tried) && opened.scope.gate().objective_is_reported() {
        say!(
            answer,
            "    which objective is in was taken from you: `focus` and `calibrate` look at the image"
        );
    }
    opened.scope.check_cancel()?;
    findings.conclude(&opened.config.name)
}

fn kept(opened: &OpenInstrument, findings: &mut Findings<'_>) {
    let objectives = opened.scope.gate().objectives();
    let room = opened.library.try_calibrations(objectives);
    let room = room.and_then(|()| opened.library.try_targets());
    findings.look(
        "calibrations and targets can be kept",
        room.map(|()| opened.library.path().display().to_string())
            .map_err(|e| e.to_string()),
    );
    for objective in objectives {
        let found = match opened.calibration_of(objective) {
            Ok(Some(kept)) => Ok(format!(
                "{:.4} um per pixel, made {}",
                kept.calibration.um_per_px(),
                kept.made
            )),
            Ok(None) => Ok("none yet: made on the way, or by `scopeservo calibrate`".into()),
            Err(error) => Err(CliError::from(error).words()),
        };
        findings.look(&format!("calibration of {}", objective.id), found);
    }
    let names = match opened.library.target_names() {
        Ok(names) => names,
        Err(error) => return findings.look("targets", Err(error.to_string())),
    };
    let mut damaged = Vec::new();
    for name in &names {
        if let Err(error) = opened.library.target(name) {
            damaged.push((name, error));
        }
    }
    findings.look(
        "targets",
        Ok(format!("{} saved", names.len() - damaged.len())),
    );
    for (name, error) in damaged {
        let cure = format!(
            "{error}; `scopeservo target remove {}` puts it into the bin",
            shell(name)
        );
        findings.look(&format!("target {name}"), Err(cure));
    }
}
