//! `scopeservo stage go`: the stage to a place, through the gate like everything else.

use crate::answer::Answer;
use crate::args::{PlaceArgs, StageGoArgs};
use crate::bar;
use crate::error::CliError;
use crate::open_instrument::OpenInstrument;
use scopeservo_protocol::Place;
use scopeservo_scope::{Axis, StagePose};
use serde_json::json;
use std::sync::mpsc;
use std::time::Duration;

/// How often a stage that moves is asked where it is, to be shown.
const SHOW: Duration = Duration::from_millis(200);

impl PlaceArgs {
    pub(crate) fn pose(&self) -> StagePose {
        StagePose::from(Place {
            x_um: self.x_um,
            y_um: self.y_um,
            z_um: self.z_um,
            rx_deg: self.rx_deg,
            ry_deg: self.ry_deg,
            rz_deg: self.rz_deg,
        })
    }
}

pub(crate) fn go(args: &StageGoArgs, answer: &Answer) -> Result<bool, CliError> {
    let to = args.to.pose();
    let given = |axis: &Axis| to.si(*axis).is_some_and(|si| !si.is_finite());
    if let Some(axis) = Axis::ALL.iter().find(|axis| given(axis)) {
        return Err(CliError::Usage(format!(
            "the goal of {axis} must be a number"
        )));
    }
    let opened = OpenInstrument::open(&args.instrument, answer)?;
    opened.tell_what_waits(answer);
    let gate = opened.scope.gate();
    let from = gate.position()?;
    let bar = bar::spinner(format!("on the way to {to}"));
    let at = std::thread::scope(|s| {
        let (done, ended) = mpsc::channel::<()>();
        let bar = &bar;
        s.spawn(move || {
            while let Err(mpsc::RecvTimeoutError::Timeout) = ended.recv_timeout(SHOW) {
                // What is wrong is said by whoever moves.
                if let Ok(at) = gate.position() {
                    bar.set_message(format!("on the way, at {at}"));
                }
            }
        });
        let at = opened.scope.move_to(&to);
        drop(done);
        at
    });
    bar.finish_and_clear();
    let at = at?;
    answer.put(json!({
        "from": Place::from(&from),
        "at": Place::from(&at),
    }));
    say!(answer, "the stage stands at {at}");
    Ok(true)
}
