//! What a doctor finds, in words.

use super::Finding;
use crate::error::advice;
use scopeservo_scope::{Axis, AxisRange, ChangeRule, Motion, Objective, StagePose};
use scopeservo_servo::Remedy;
use scopeservo_station::jobs::{self as found, Check, Trouble};

impl From<&found::Finding> for Finding {
    fn from(finding: &found::Finding) -> Self {
        let seen = seen(&finding.check);
        Self {
            name: name(&finding.check).into(),
            ok: finding.is_ok(),
            said: match &finding.trouble {
                None => seen,
                Some(Trouble::Error { message, remedy }) => {
                    let remedy = remedy.clone().map(Remedy::Scope);
                    format!("{message}{}", remedy.as_ref().map_or(String::new(), advice))
                }
                Some(Trouble::MovesUnasked) => "it moves although nobody asked it to".into(),
                Some(Trouble::TooBright) => {
                    format!("{seen}: too bright; shorten the exposure or dim the light")
                }
                Some(Trouble::Dark) => {
                    format!("{seen}: dark; is the light on and the objective in place?")
                }
                Some(Trouble::TooLittle) => format!(
                    "{seen}: too little to calibrate or to come back to; focus, or go to a place with structure"
                ),
                Some(Trouble::RetractedInFocus) => format!(
                    "{seen}; yet z counts as retracted, so that the nosepiece would turn at this height: check the sign of retract_z_um"
                ),
                Some(Trouble::Drifts) => format!(
                    "{seen} while the stage stands: wait until the instrument is warm, and see that the slide and the focus drive hold"
                ),
                Some(Trouble::ScaleDoesNotFit) => format!(
                    "{seen}, which does not fit: look at the unit of the stage, at um_per_px of the objective, and at which objective is in"
                ),
            },
        }
    }
}

fn name(check: &Check) -> &str {
    match check {
        Check::Stage { .. } => "stage",
        Check::Position { .. } => "the stage says where it is",
        Check::Inside => "it stands where it may",
        Check::Still { .. } => "it stands still",
        Check::Objectives { .. } => "objectives",
        Check::InBeam { .. } => "the nosepiece says where it is",
        Check::Change { .. } => "objectives change",
        Check::Camera { .. } => "camera",
        Check::Exposure { .. } => "the camera says its exposure",
        Check::Picture => "an image",
        Check::Light { .. } => "the image's light",
        Check::Structure { .. } => "there is something to see",
        Check::Drift { .. } => "the view stands",
        Check::Scale { .. } => "the image moves as far as the stage says",
        Check::Contract { what } => what,
    }
}

/// What was seen, good or bad; nothing where there is no more to it than that it was.
fn seen(check: &Check) -> String {
    match check {
        Check::Stage { name, ranges } => format!("{name}; allowed: {}", allowed(ranges)),
        Check::Position { at } => at.as_ref().map_or(String::new(), place),
        Check::Inside => "inside all limits".into(),
        Check::Still { motion } => motion.map_or("", still).into(),
        Check::Objectives { all } => all.iter().map(engraved).collect::<Vec<_>>().join(", "),
        Check::InBeam { objective } => match objective {
            Some(id) => format!("{id} is active"),
            None => "unknown: the first change will tell".into(),
        },
        Check::Change { rule, objectives } => match rule {
            ChangeRule::Anywhere if *objectives < 2 => "there is one objective".into(),
            ChangeRule::Anywhere => "at any height, as the file says".into(),
            ChangeRule::Retracted { z, .. } => format!("from z = {:.0} um on", z * 1e6),
        },
        Check::Camera { info } => format!(
            "{}; {} x {} px, {} bits",
            info.name, info.width, info.height, info.bit_depth
        ),
        Check::Exposure { exposure_s } => {
            exposure_s.map_or(String::new(), |s| format!("{:.2} ms", s * 1e3))
        }
        Check::Light {
            mean,
            saturated,
            taken_s,
        } => format!(
            "mean {:.0} % of full scale, {:.1} % saturated, in {:.0} ms",
            100.0 * mean,
            100.0 * saturated,
            taken_s * 1e3
        ),
        Check::Structure {
            features,
            sharpness,
        } => features.map_or(String::new(), |n| {
            format!("{n} features, sharpness {sharpness:.4}")
        }),
        Check::Drift { px_per_s } => px_per_s.map_or(String::new(), |px| {
            format!("it moves by {px:.2} pixels a second")
        }),
        Check::Scale {
            objective: Some(objective),
            um_per_px: Some(um),
        } => format!("{um:.3} um per pixel with {objective}"),
        Check::Scale { .. } | Check::Picture | Check::Contract { .. } => String::new(),
    }
}

fn allowed(ranges: &[AxisRange]) -> String {
    let each = ranges.iter().map(|r| {
        let [min, max] = [r.min, r.max].map(|si| r.axis.to_display(si));
        format!("{} {min:.0} to {max:.0} {}", r.axis, r.axis.display_unit())
    });
    each.collect::<Vec<_>>().join(", ")
}

/// The axes that there are.
fn place(at: &StagePose) -> String {
    let each = Axis::ALL.into_iter().filter_map(|axis| {
        let shown = axis.to_display(at.si(axis)?);
        Some(format!("{axis} {shown:.2} {}", axis.display_unit()))
    });
    each.collect::<Vec<_>>().join(", ")
}

fn still(motion: Motion) -> &'static str {
    match motion {
        Motion::Moving => "moving",
        Motion::Settled => "settled",
        Motion::Stopped => "stopped",
    }
}

fn engraved(o: &Objective) -> String {
    format!(
        "{} ({}x, {} um/px)",
        o.id, o.magnification, o.nominal_um_per_px
    )
}
