//! The views of a joint calibration: where they lie, how far they are from where the stage says, and a few of them with their matches.

use crate::matches::drawing;
use crate::model::{Report, view_name};
use crate::svg::{Attr, Canvas, Key, Mark, Panel, Scale, WIDTH, equal_panel, nice_step};
use crate::text::{count, escape, fixed, short, um};
use crate::told::{Calibrating, Ended, Look};
use scopeservo_servo::joint::Role;
use scopeservo_servo::{ChainPair, ChainPlace};
use std::fmt::Write as _;

/// The longest arrow, in the figure's units.
const ARROW: f64 = 26.0;
/// Angles of turned views are drawn so many times as large.
const TURN_FACTOR: f64 = 5.0;
/// Half the length of the bar of a turned view, in the figure's units.
const BAR: f64 = 11.0;

/// Where the number of a view stands beside it, in the figure's units.
const AROUND: [[f64; 2]; 6] = [
    [6.0, -6.0],
    [6.0, 15.0],
    [-18.0, -6.0],
    [-18.0, 15.0],
    [6.0, -17.0],
    [6.0, 26.0],
];

/// What a view was for.
fn role_word(role: Role) -> &'static str {
    match role {
        Role::Reference => "reference",
        Role::Corner { .. } => "first steps",
        Role::Return => "return from the other side",
        Role::Arm { .. } => "cross",
        Role::Widen { .. } => "turned wider",
        Role::Sweep { .. } => "turned back and forth",
        Role::Home => "home",
    }
}

fn um_of(m: [f64; 2]) -> [f64; 2] {
    m.map(|v| v * 1e6)
}

/// The views of the chain as a figure; nothing where it was no chain.
pub(crate) fn figure(c: &Calibrating<'_>) -> String {
    let Some(ended) = c.ended.filter(|e| !e.places.is_empty()) else {
        return String::new();
    };
    let longest_um = ended
        .places
        .iter()
        .filter_map(|p| p.off_m)
        .map(|[x, y]| 1e6 * f64::hypot(x, y))
        .fold(0.0, f64::max);
    let all = |k: usize| ended.places.iter().map(move |p| 1e6 * p.at_m[k]);
    let height = 236.0;
    let p = equal_panel(
        Scale::linear(all(0)),
        Scale::linear(all(1)),
        WIDTH - 52.0,
        height,
    );
    let p = Panel { top: 42.0, ..p };
    let mut canvas = Canvas::new(
        height + 78.0,
        &format!("Places of the calibration views of {}", c.objective),
    );
    p.axes(&mut canvas, "x, µm from the first view", "y, µm");
    links(&mut canvas, &p, &ended);
    let way: Vec<_> = ended.places.iter().map(|p| um_of(p.at_m)).collect();
    p.line(&mut canvas, "way", &way);
    let um_per_unit = (p.x.max - p.x.min) / p.width;
    let factor = magnification(longest_um, um_per_unit);
    for look in &c.looks {
        if let Some(place) = ended.places.get(look.index) {
            view(&mut canvas, &p, look, place);
        }
    }
    for place in ended.places {
        arrow(&mut canvas, &p, place, factor);
    }
    numbers(&mut canvas, &p, c, &ended);
    legend(&mut canvas);
    format!(
        "<figure class=\"chain\">{}<figcaption>{}</figcaption></figure>\n",
        canvas.finish(),
        caption(c, &ended, longest_um, factor)
    )
}

/// By how much arrows are longer than what they show: 1, 2 or 5 times a power of ten.
fn magnification(longest_um: f64, um_per_unit: f64) -> f64 {
    if longest_um <= 0.0 {
        return 1.0;
    }
    let most = ARROW * um_per_unit / longest_um;
    // The round number below, not above.
    let next = nice_step(most);
    if next <= most * 1.001 {
        return next;
    }
    [0.5, 0.4]
        .map(|f| nice_step(f * next * 0.999))
        .into_iter()
        .find(|f| *f <= most)
        .unwrap_or(most)
}

/// Which views were registered to which.
fn links(canvas: &mut Canvas, p: &Panel, ended: &Ended<'_>) {
    for (k, [a, b]) in ended.pairs.iter().enumerate() {
        let (Some(a), Some(b)) = (ended.places.get(*a), ended.places.get(*b)) else {
            continue;
        };
        let class = match ended.left_out.contains(&k) {
            true => "left-out",
            false => "link",
        };
        p.line(canvas, class, &[um_of(a.at_m), um_of(b.at_m)]);
    }
}

fn view(canvas: &mut Canvas, p: &Panel, look: &Look<'_>, place: &ChainPlace) {
    let [x, y] = um_of(place.at_m);
    let [x, y] = p.at(x, y);
    if !look.found {
        let (left, top) = (Attr(x - 4.0), Attr(y - 4.0));
        canvas.raw(&format!(
            "<path class=\"line missed\" d=\"M{left} {top}l8 8m-8 0l8 -8\"/>"
        ));
        return;
    }
    match look.chain.role {
        Role::Reference => canvas.mark("goal", Mark::Plus, x, y),
        Role::Home => canvas.mark("stop", Mark::Ring, x, y),
        Role::Corner { .. } => canvas.mark("y", Mark::Triangle, x, y),
        Role::Return => canvas.mark("y", Mark::Ring, x, y),
        Role::Arm { .. } => canvas.mark("x", Mark::Dot, x, y),
        Role::Widen { .. } | Role::Sweep { .. } => {
            // To the stage's y the figure's is upside down.
            let (s, c) = (TURN_FACTOR * look.chain.asked.theta_rad).sin_cos();
            let (dx, dy) = (BAR * c, -BAR * s);
            canvas.raw(&format!(
                "<path class=\"line theta\" d=\"M{} {}L{} {}\"/>",
                Attr(x - dx),
                Attr(y - dy),
                Attr(x + dx),
                Attr(y + dy)
            ));
        }
    }
}

/// From where the view should be to where it was seen.
fn arrow(canvas: &mut Canvas, p: &Panel, place: &ChainPlace, factor: f64) {
    let Some(off) = place.off_m else { return };
    let ([x, y], [dx, dy]) = (um_of(place.at_m), um_of(off));
    let from = p.at(x, y);
    let to = p.at(x + factor * dx, y + factor * dy);
    let (u, v) = (to[0] - from[0], to[1] - from[1]);
    let length = f64::hypot(u, v);
    if length < 1.0 {
        return;
    }
    let head = (0.4 * length).min(4.5) / length;
    let side = |s: f64| {
        [
            to[0] - head * (u - 0.6 * s * v),
            to[1] - head * (v + 0.6 * s * u),
        ]
    };
    let way = [from, to, side(1.0), to, side(-1.0)];
    let mut d = String::new();
    for (k, [x, y]) in way.into_iter().enumerate() {
        let letter = if k == 0 { 'M' } else { 'L' };
        let _ = write!(d, "{letter}{} {}", Attr(x), Attr(y));
    }
    canvas.raw(&format!("<path class=\"line off\" d=\"{d}\"/>"));
}

/// The number of the view where a new part of the path begins.
fn numbers(canvas: &mut Canvas, p: &Panel, c: &Calibrating<'_>, ended: &Ended<'_>) {
    let mut taken: Vec<[f64; 2]> = Vec::new();
    let mut part = None;
    for look in &c.looks {
        let now = (
            role_word(look.chain.role),
            match look.chain.role {
                Role::Arm { direction } => direction,
                _ => 0,
            },
        );
        let begins = part.replace(now) != Some(now);
        let Some(place) = ended.places.get(look.index).filter(|_| begins) else {
            continue;
        };
        let [x, y] = um_of(place.at_m);
        let [x, y] = p.at(x, y);
        // Several begin at one place: their numbers stand around it.
        let free = |at: &[f64; 2]| {
            let near = |t: &[f64; 2]| (t[0] - at[0]).abs() < 13.0 && (t[1] - at[1]).abs() < 10.0;
            !taken.iter().any(near)
        };
        let around = AROUND.map(|[dx, dy]| [x + dx, y + dy]);
        let at = around.into_iter().find(free).unwrap_or(around[0]);
        taken.push(at);
        canvas.text("order lift", at[0], at[1], &(look.index + 1).to_string());
    }
}

fn legend(canvas: &mut Canvas) {
    let key = |class, mark, line, label| Key {
        class,
        mark,
        line,
        label,
    };
    canvas.legend(
        0.0,
        12.0,
        &[
            key("goal", Some(Mark::Plus), false, "first"),
            key("y", Some(Mark::Triangle), false, "steps"),
            key("x", Some(Mark::Dot), false, "cross"),
            key("theta", None, true, "turned"),
        ],
    );
}

fn caption(c: &Calibrating<'_>, ended: &Ended<'_>, longest_um: f64, factor: f64) -> String {
    let mut out = String::from(
        "Where the stage was sent, in its own axes, turns about the view's middle taken off; numbers are the order. ",
    );
    let lost = c.looks.iter().filter(|l| !l.found).count();
    let _ = write!(
        out,
        "Thin lines join the {} of views that were recognised in each other",
        count(ended.pairs.len(), "pair")
    );
    if !ended.left_out.is_empty() {
        let _ = write!(
            out,
            "; {} that the others contradict are dashed and count for nothing",
            ended.left_out.len()
        );
    }
    out.push_str(". ");
    if longest_um > 0.0 {
        let _ = write!(
            out,
            "Arrows, {} times too long, go from where the stage says to where the view is: {} at most. ",
            short(factor),
            um(longest_um)
        );
    }
    if c.looks.iter().any(|l| l.chain.asked.theta_rad != 0.0) {
        let _ = write!(
            out,
            "Bars stand for turned views, the angle {} times as large. ",
            fixed(TURN_FACTOR, 0)
        );
    }
    if lost > 0 {
        let _ = write!(
            out,
            "Crosses: {} that {} not recognised. ",
            count(lost, "view"),
            if lost == 1 { "was" } else { "were" }
        );
    }
    out
}

/// Every view in a line.
pub(crate) fn table(c: &Calibrating<'_>) -> String {
    if c.looks.is_empty() {
        return String::new();
    }
    let places = c.ended.map_or(&[][..], |e| e.places);
    let mut out = String::from(
        "<details><summary>The views, one by one</summary><div class=\"scroll\"><table>\n<thead><tr><th scope=\"col\">view</th>\
         <th scope=\"col\">for</th><th scope=\"col\">x, µm</th><th scope=\"col\">y, µm</th><th scope=\"col\">turned, °</th>\
         <th scope=\"col\">agreeing of matches, in view</th><th scope=\"col\">off, µm</th></tr></thead>\n<tbody>\n",
    );
    for look in &c.looks {
        let place = places.get(look.index);
        let [x, y] = place.map_or([f64::NAN; 2], |p| um_of(p.at_m));
        let off = place.and_then(|p| p.off_m);
        let _ = writeln!(
            out,
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            look.index + 1,
            role_word(look.chain.role),
            fixed(x, 1),
            fixed(y, 1),
            fixed(look.chain.asked.theta_rad.to_degrees(), 3),
            compared(&look.chain.compared),
            off.map_or("–".into(), |[x, y]| fixed(1e6 * f64::hypot(x, y), 3))
        );
    }
    out.push_str("</tbody></table></div></details>\n");
    out
}

fn compared(pairs: &[ChainPair]) -> String {
    let one = |p: &ChainPair| match p.reason {
        None => format!("{} of {} in {}", p.inliers, p.matches, p.with + 1),
        Some(_) => format!("0 of {} in {}", p.matches, p.with + 1),
    };
    match pairs {
        [] => "–".into(),
        pairs => pairs.iter().map(one).collect::<Vec<_>>().join("; "),
    }
}

/// Two views that are shown beside each other: indices into the looks.
pub(crate) struct Telling {
    view: usize,
    with: Option<usize>,
    words: &'static str,
}

/// The pairs that say most: the first step, the farthest place, the widest turn, the end; of a calibration that failed its last view.
pub(crate) fn telling(c: &Calibrating<'_>) -> Vec<Telling> {
    let mut out: Vec<Telling> = Vec::new();
    let mut add = |at: Option<usize>, words| {
        let Some(view) = at.filter(|k| out.iter().all(|t| t.view != *k)) else {
            return;
        };
        let with = c.looks[view].chain.compared.first().map(|p| p.with);
        let with = with.and_then(|index| c.looks.iter().position(|l| l.index == index));
        out.push(Telling { view, with, words });
    };
    let found =
        |wanted: &dyn Fn(&Look<'_>) -> bool| c.looks.iter().rposition(|l| l.found && wanted(l));
    if c.made.is_none() {
        let last = c.looks.len().checked_sub(1);
        add(last, "The last view");
        // What was still recognised before it.
        add(
            found(&|l| Some(l.index) != last),
            "The last view that was recognised",
        );
    }
    let places = c.ended.map_or(&[][..], |e| e.places);
    let reach = |l: &Look<'_>| {
        let arm = matches!(l.chain.role, Role::Arm { .. });
        let at = places.get(l.index).filter(|_| arm && l.found);
        at.map_or(-1.0, |p| f64::hypot(p.at_m[0], p.at_m[1]))
    };
    let turn = |l: &Look<'_>| match l.found {
        true => l.chain.asked.theta_rad.abs(),
        false => 0.0,
    };
    add(
        found(&|l| matches!(l.chain.role, Role::Corner { index: 0, .. })),
        "The first step",
    );
    if c.made.is_some() {
        add(greatest(&c.looks, &reach), "The farthest view of the cross");
        add(greatest(&c.looks, &turn), "The view that was turned most");
        add(found(&|l| l.chain.role == Role::Home), "Home again");
    }
    out
}

/// Where something is greatest, if it is above zero anywhere.
fn greatest(looks: &[Look<'_>], of: &dyn Fn(&Look<'_>) -> f64) -> Option<usize> {
    let best = (0..looks.len()).max_by(|a, b| of(&looks[*a]).total_cmp(&of(&looks[*b])))?;
    (of(&looks[best]) > 0.0).then_some(best)
}

/// The frames that [`pictures`] shows.
pub(crate) fn shown(c: &Calibrating<'_>) -> Vec<u64> {
    let sequence = |k: usize| c.looks[k].chain.sequence;
    let all = telling(c).into_iter();
    all.flat_map(|t| [Some(t.view), t.with].into_iter().flatten().map(sequence))
        .collect()
}

/// The telling views, each beside the one that it was compared with.
pub(crate) fn pictures(r: &Report<'_>, c: &Calibrating<'_>) -> String {
    let mut out = String::new();
    for t in telling(c) {
        let look = &c.looks[t.view];
        let name = view_name(look.chain.sequence);
        let pair = look.chain.compared.first();
        let with = t.with.map(|k| &c.looks[k]);
        let drawn = with.zip(pair).and_then(|(with, pair)| {
            let right = view_name(with.chain.sequence);
            let words = ["the view", "the earlier one"];
            drawing(&r.gallery, [&name, &right], words, &pair.places)
        });
        let (svg, wide) = match drawn {
            Some((svg, _)) => (svg, true),
            None => match r.gallery.figure(&name, t.words, "") {
                Some(svg) => (svg, false),
                None => continue,
            },
        };
        let _ = writeln!(
            out,
            "<figure class=\"{}\"><div class=\"scroll\">{svg}</div><figcaption><b>{}</b>, number {} ({}): {}{}</figcaption></figure>",
            if wide { "pair-of-views" } else { "one-view" },
            t.words,
            look.index + 1,
            role_word(look.chain.role),
            beside(look, pair, wide),
            r.gallery.brighter(&[&name]),
        );
    }
    match out.is_empty() {
        true => String::new(),
        false => format!("<div class=\"duo\">\n{out}</div>\n"),
    }
}

fn beside(look: &Look<'_>, pair: Option<&ChainPair>, drawn: bool) -> String {
    let Some(pair) = pair else {
        return match look.index {
            0 => "there was no earlier one to compare it with.".into(),
            _ => "no earlier view was expected to overlap it.".into(),
        };
    };
    let sides = if drawn { " (right)" } else { "" };
    let among = count(pair.matches, "place").replace(" place", " alike place");
    match &pair.reason {
        None => format!(
            "{} agree in view {}{sides}, of {among}.",
            count(pair.inliers, "place"),
            pair.with + 1
        ),
        Some(reason) => format!(
            "not recognised in view {}{sides}, which it should overlap: {}. {among} {} drawn.",
            pair.with + 1,
            escape(&reason.to_string()),
            match (pair.matches, pair.places.len()) {
                (0, _) => "could be",
                (m, n) if n < m => "were there; some of them are",
                _ => "are",
            }
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrows_are_as_long_as_a_round_factor_allows() {
        for (longest, per_unit) in [(0.13, 8.0), (2.5, 1.0), (40.0, 8.0), (0.9, 3.7)] {
            let factor = magnification(longest, per_unit);
            let drawn = longest * factor / per_unit;
            assert!(drawn <= ARROW * 1.002, "{drawn}");
            assert!(drawn >= ARROW / 2.51, "{drawn}");
            let digit = factor / 10f64.powf(factor.log10().floor());
            assert!(
                [1.0, 2.0, 5.0, 10.0]
                    .iter()
                    .any(|d| (digit - d).abs() < 1e-6),
                "{factor}"
            );
        }
        assert_eq!(magnification(0.0, 1.0), 1.0);
    }
}
