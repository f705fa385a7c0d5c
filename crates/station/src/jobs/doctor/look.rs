//! What can be seen of an instrument: by asking its devices, by images, and by small moves.

use super::finding::{Check, Finding, Trouble};
use scopeservo_features::{Engine, FeatureError, GrayImage};
use scopeservo_scope::{ChangeRule, Frame, Instrument, Motion, Samples, conformance};
use scopeservo_servo::{Drift, ServoError, VisionOptions, drift_seen, scale_seen, sharpness};

/// So many features are looked for.
const LOOKED_FOR: usize = 2000;
/// With fewer features a view cannot be calibrated on.
const ENOUGH_FEATURES: usize = 100;
/// A larger share of samples at full scale hides what is there.
const MOST_SATURATED: f64 = 0.2;
/// A smaller share of samples above a twentieth of full scale is a dark image. Fluorescence is dark but for a few places.
const LEAST_LIT: f64 = 1e-3;
/// A view that moves by more than this many of its pixels in a second is nothing to come back to: half of what counts as arrived.
const DRIFTS_PX_PER_S: f64 = 0.4;

pub(super) fn stage(scope: &Instrument) -> Vec<Finding> {
    let gate = scope.gate();
    let mut findings = vec![Finding::well(Check::Stage {
        name: gate.info().name.clone(),
        ranges: gate.ranges().to_vec(),
    })];
    let position = gate.position();
    let at = position.as_ref().ok().copied();
    findings.push(Finding::of(position, |at| Check::Position { at }));
    if let Some(at) = at {
        findings.push(Finding::of(gate.check(&at), |_| Check::Inside));
    }
    let motion = gate.poll();
    let moves = matches!(motion, Ok(Motion::Moving)).then_some(Trouble::MovesUnasked);
    let still = Finding::of(motion, |motion| Check::Still { motion });
    findings.push(Finding {
        trouble: still.trouble.or(moves),
        ..still
    });
    findings
}

pub(super) fn nosepiece(scope: &Instrument) -> Vec<Finding> {
    let gate = scope.gate();
    let all = gate.objectives().to_vec();
    let change = Check::Change {
        rule: gate.rules().change,
        objectives: all.len(),
    };
    vec![
        Finding::well(Check::Objectives { all }),
        Finding::of(gate.current_objective(), |told| Check::InBeam {
            objective: told.flatten(),
        }),
        Finding::well(change),
    ]
}

pub(super) fn camera(scope: &Instrument) -> Vec<Finding> {
    let info = scope.camera().info().clone();
    let exposure = scope.camera().exposure();
    let mut findings = vec![
        Finding::well(Check::Camera { info }),
        Finding::of(exposure, |e| Check::Exposure {
            exposure_s: e.map(|e| e.as_secs_f64()),
        }),
    ];
    findings.extend(
        conformance::check_frames(scope)
            .into_iter()
            .map(Finding::from),
    );
    let asked = scope.clock().now();
    match scope.grab() {
        Ok(frame) => {
            let taken_s = scope.clock().now().since(asked).as_secs_f64();
            findings.push(light(&frame, taken_s));
            findings.push(structure(scope, &frame));
        }
        Err(error) => findings.push(Finding::new(Check::Picture, Some(error.into()))),
    }
    findings
}

fn light(frame: &Frame, taken_s: f64) -> Finding {
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
    let (saturated, lit, mean) = (saturated as f64 / count, lit as f64 / count, sum / count);
    let trouble = match (saturated > MOST_SATURATED, lit < LEAST_LIT) {
        (true, _) => Some(Trouble::TooBright),
        (_, true) => Some(Trouble::Dark),
        _ => None,
    };
    let check = Check::Light {
        mean,
        saturated,
        taken_s,
    };
    Finding::new(check, trouble)
}

fn structure(scope: &Instrument, frame: &Frame) -> Finding {
    let features = features(frame).map_err(Trouble::told);
    let trouble = match features {
        Ok(n) if n < ENOUGH_FEATURES => Some(Trouble::TooLittle),
        // What is in focus is not far away: then the sign or the height is wrong, and the nosepiece would turn here.
        Ok(_) if is_retracted(scope) => Some(Trouble::RetractedInFocus),
        _ => None,
    };
    let found = Finding::of(features, |features| Check::Structure {
        features,
        sharpness: sharpness(frame),
    });
    Finding {
        trouble: found.trouble.or(trouble),
        ..found
    }
}

fn features(frame: &Frame) -> Result<usize, FeatureError> {
    let image = GrayImage::new(frame.width, frame.height, frame.luminance())?;
    let features = Engine::default().features(&image, LOOKED_FOR)?;
    Ok(features.len())
}

/// Whether the nosepiece would turn where the stage stands, by a rule that names a height.
fn is_retracted(scope: &Instrument) -> bool {
    let gate = scope.gate();
    matches!(gate.rules().change, ChangeRule::Retracted { .. })
        && gate.at_work().is_ok_and(|work| work.is_none())
}

/// What only images tell about a stage: whether the view stands, and whether the image moves as far as the stage says. The stage moves
/// a little and comes back. `false` as second when it must not move any farther.
pub fn look_by_small_moves(scope: &Instrument) -> (Vec<Finding>, bool) {
    let vision = VisionOptions::default();
    let drift = stands(drift_seen(scope, &vision)).in_trial();
    let objective = match scope.gate().current_objective() {
        Ok(Some(objective)) => objective,
        // Nobody knows which scale to expect.
        Ok(None) => return (vec![drift], true),
        Err(error) => {
            let unknown = Check::Scale {
                objective: None,
                um_per_px: None,
            };
            let scale = Finding::new(unknown, Some(Trouble::told(error)));
            return (vec![drift, scale.in_trial()], true);
        }
    };
    let seen = scale_seen(scope, &objective, &vision);
    let goes_on = !matches!(seen, Err(ServoError::MovesTooFar { .. }));
    let (um_per_px, trouble) = match seen {
        Ok(seen) if seen.as_told => (Some(seen.um_per_px), None),
        Ok(seen) => (Some(seen.um_per_px), Some(Trouble::ScaleDoesNotFit)),
        Err(error) => (None, Some(Trouble::told(error))),
    };
    let scale = Check::Scale {
        objective: Some(objective),
        um_per_px,
    };
    (
        vec![drift, Finding::new(scale, trouble).in_trial()],
        goes_on,
    )
}

fn stands(seen: Result<Drift, ServoError>) -> Finding {
    let (px_per_s, trouble) = match seen {
        Ok(Drift {
            px_per_s,
            sigma_px_per_s,
        }) => {
            let drifts = px_per_s > DRIFTS_PX_PER_S && px_per_s > 3.0 * sigma_px_per_s;
            (Some(px_per_s), drifts.then_some(Trouble::Drifts))
        }
        Err(error) => (None, Some(Trouble::told(error))),
    };
    Finding::new(Check::Drift { px_per_s }, trouble)
}
