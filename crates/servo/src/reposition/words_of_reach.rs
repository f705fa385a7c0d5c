//! What a stage cannot do, in words: what is missing, and what to do at the specimen.

use crate::{Beyond, LimitedBy, Missing, ServoEnd};
use scopeservo_scope::{Axis, deg_in_words, um_in_words};

/// What is missing to bring a view back.
pub(super) fn cannot_reach(missing: &Missing) -> String {
    let Missing {
        turned_deg,
        turn_back_deg,
        beyond,
        ..
    } = missing;
    let turned = turned_deg.abs();
    let shifts: Vec<&Beyond> = beyond.iter().filter(|b| b.axis != Axis::Rz).collect();
    let nothing = "nothing was moved for it";
    // Up, to a tenth of a degree.
    let back =
        turn_back_deg.map(|deg| format!("turn it back by {:.1} deg", (10.0 * deg).ceil() / 10.0));
    match (missing.of(Axis::Rz), back) {
        (Some(rotation), back) => {
            let stage = format!(
                "the slide is turned {turned:.0} deg, this stage turns {}; {nothing}",
                range_in_words(rotation)
            );
            match back {
                Some(back) => format!("{stage}. By hand, {back} or more, and try again"),
                None => format!(
                    "{stage}. Turn it back by hand, {}, and try again",
                    put(missing, &shifts)
                ),
            }
        }
        (None, Some(back)) => {
            let ways: Vec<String> = shifts.iter().map(|b| past(b)).collect();
            let ways = match (ways.is_empty(), &missing.rule) {
                (true, Some(rule)) => rule.clone(),
                _ => format!("needs {}", ways.join(" and ")),
            };
            format!(
                "the slide is turned {turned:.1} deg, and to turn the view as far about its own middle {ways}; {nothing}. By hand, {back} or \
                 more, and try again"
            )
        }
        (None, None) if shifts.is_empty() => {
            let rule = missing
                .rule
                .as_deref()
                .unwrap_or("a rule of the motion gate is in the way");
            format!("the saved view lies where the stage may not go: {rule}")
        }
        (None, None) => {
            let ways: Vec<String> = shifts.iter().map(|b| past(b)).collect();
            format!(
                "the saved view lies where this stage does not go: it needs {}; {nothing}. {}, and try again",
                ways.join(" and "),
                upper(&put(missing, &shifts))
            )
        }
    }
}

/// How far past an end, and where that is.
fn past(b: &Beyond) -> String {
    let (by, end) = (
        way(b.axis, b.by.abs()),
        if b.by > 0.0 { b.max } else { b.min },
    );
    format!(
        "{by} more of {} than its end at {}",
        b.axis,
        place(b.axis, end)
    )
}

/// Where to put the slide.
fn put(missing: &Missing, shifts: &[&Beyond]) -> String {
    if shifts.is_empty() {
        return "and put it where it lay when the view was saved".into();
    }
    let each = shifts.iter().map(|b| {
        // A stage that carries the specimen need not go so far where that lies farther on; the microscope need not where it lies less far.
        let on = (b.by > 0.0) == missing.carries_specimen;
        let way_to = if on { "rises" } else { "falls" };
        format!(
            "{} in the direction in which the stage goes when {} {way_to}",
            way(b.axis, b.by.abs()),
            b.axis
        )
    });
    let all: Vec<String> = each.collect();
    format!("put the slide {}", all.join(" and "))
}

fn upper(text: &str) -> String {
    let mut letters = text.chars();
    let first = letters.next().map(char::to_uppercase).into_iter().flatten();
    first.chain(letters).collect()
}

/// How far something goes, or is missing.
fn way(axis: Axis, si: f64) -> String {
    match axis.is_rotation() {
        true => deg_in_words(si.to_degrees(), 1),
        false if si.abs() < 1e-5 => um_in_words(si * 1e6, 1),
        false => place(axis, si),
    }
}

/// Where an axis stands.
fn place(axis: Axis, si: f64) -> String {
    match (axis.is_rotation(), si.abs() * 1e6) {
        (true, _) => format!("{:.1} deg", si.to_degrees()),
        (false, um) if um >= 1000.0 => format!("{:.1} mm", si * 1e3),
        (false, um) if um >= 10.0 => format!("{:.0} um", si * 1e6),
        (false, _) => format!("{:.1} um", si * 1e6),
    }
}

fn range_in_words(b: &Beyond) -> String {
    let [min, max] = [b.min, b.max].map(|rad| rad.to_degrees());
    match (max + min).abs() < 0.05 {
        true => format!("+-{max:.0} deg"),
        false => format!("from {min:.0} to {max:.0} deg"),
    }
}

/// As near as it gets is not as near as was asked for.
pub(super) fn outside_tolerance(end: &ServoEnd) -> String {
    let ServoEnd::OutsideTolerance {
        last,
        asked_um,
        asked_deg,
        stage_um,
        stage_deg,
    } = end
    else {
        return String::new();
    };
    let asked_um = asked_um.map(|um| format!("{um} um"));
    let asked: Vec<String> = asked_um
        .into_iter()
        .chain(asked_deg.map(|deg| format!("{deg} deg")))
        .collect();
    let why = match last.limited_by {
        Some(LimitedBy::Measurement) => format!(
            "these images tell no better than to {} and {} (two standard deviations): ask for less, or save a view with more texture",
            um_in_words(2.0 * last.sigma_um, 2),
            deg_in_words(2.0 * last.sigma_deg, 4)
        ),
        _ => format!(
            "this stage comes back to within {} and {} (two standard deviations): {}look for play and vibration",
            um_in_words(*stage_um, 2),
            deg_in_words(*stage_deg, 4),
            if asked.is_empty() {
                ""
            } else {
                "ask for less, or "
            }
        ),
    };
    let wanted = match asked.is_empty() {
        true => "moves came no nearer".into(),
        false => format!("{} was asked for, which did not come", asked.join(" and ")),
    };
    format!(
        "the place is back, {} and {} off, and {wanted} in {} iterations: {why}",
        um_in_words(last.error.distance_um(), 2),
        deg_in_words(last.error.angle_deg().abs(), 4),
        last.iterations
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn beyond(axis: Axis, by: f64, end: f64) -> Beyond {
        Beyond {
            axis,
            by,
            min: -end,
            max: end,
        }
    }

    #[test]
    fn what_is_missing_is_named_with_what_to_do_and_no_limit_is_to_be_widened() {
        let hexapod = Missing {
            beyond: vec![
                beyond(Axis::Rz, 159f64.to_radians(), 21f64.to_radians()),
                beyond(Axis::X, -0.233, 0.017),
            ],
            turned_deg: -180.0,
            turn_back_deg: Some(172.81),
            carries_specimen: false,
            rule: None,
        };
        let said = cannot_reach(&hexapod);
        assert!(
            said.contains("the slide is turned 180 deg, this stage turns +-21 deg")
                && said.contains("turn it back by 172.9 deg or more"),
            "{said}"
        );
        let swept = Missing {
            beyond: vec![beyond(Axis::Y, 4.5e-3, 2e-3)],
            turned_deg: 3.0,
            turn_back_deg: Some(2.1),
            ..hexapod.clone()
        };
        let said = cannot_reach(&swept);
        assert!(
            said.contains("4.5 mm more of y than its end at 2.0 mm")
                && said.contains("turn it back by 2.1 deg"),
            "{said}"
        );
        let far = |by: f64, carries_specimen| Missing {
            beyond: vec![beyond(Axis::X, by, 5e-3)],
            turned_deg: 0.0,
            turn_back_deg: None,
            carries_specimen,
            rule: None,
        };
        for (by, carries, goes) in [
            (3.2e-3, true, "rises"),
            (-3.2e-3, true, "falls"),
            (3.2e-3, false, "falls"),
            (-3.2e-3, false, "rises"),
        ] {
            let said = cannot_reach(&far(by, carries));
            let put = format!(
                "Put the slide 3.2 mm in the direction in which the stage goes when x {goes}"
            );
            assert!(said.contains(&put), "{said}");
        }
        for missing in [hexapod, swept, far(1e-4, true)] {
            let said = cannot_reach(&missing);
            assert!(
                !said.contains("widen") && said.contains("nothing was moved"),
                "{said}"
            );
        }
    }
}
