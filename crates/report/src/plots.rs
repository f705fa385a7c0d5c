//! Error, velocity, convergence and path at one magnification.

use crate::model::{Report, view_name};
use crate::promises;
use crate::svg::{Canvas, Key, Mark, Panel, Scale, WIDTH, equal_panel};
use crate::text::{deg, fixed, um};
use crate::told::Magnification;

const XY: [Key; 2] = [
    Key {
        class: "x",
        mark: Some(Mark::Dot),
        line: true,
        label: "x",
    },
    Key {
        class: "y",
        mark: Some(Mark::Square),
        line: true,
        label: "y",
    },
];
const THETA: [Key; 1] = [Key {
    class: "theta",
    mark: Some(Mark::Triangle),
    line: true,
    label: "θ",
}];

/// The second where the truth is known.
const IDEAL_AND_TRUTH: [Key; 2] = [
    Key {
        class: "ideal",
        mark: None,
        line: true,
        label: "expected",
    },
    Key {
        class: "truth",
        mark: Some(Mark::Ring),
        line: false,
        label: "truth",
    },
];
/// The last where the truth is known.
const WAY: [Key; 4] = [
    Key {
        class: "start",
        mark: Some(Mark::Ring),
        line: false,
        label: "start",
    },
    Key {
        class: "stop",
        mark: Some(Mark::Square),
        line: false,
        label: "end",
    },
    Key {
        class: "goal",
        mark: Some(Mark::Plus),
        line: false,
        label: "saved",
    },
    Key {
        class: "truth",
        mark: None,
        line: true,
        label: "truth",
    },
];

pub(crate) fn section(r: &Report<'_>, m: &Magnification<'_>) -> String {
    if m.iterations.is_empty() {
        return "<p class=\"none\">The saved view was never recognised here, so there is no error to plot.</p>\n".into();
    }
    let lambda = lambda(m);
    let mut figures = vec![
        (
            motion(m, "Error", "", |i| (i.error.t_m, i.error.theta_rad)),
            "How far off the view stands, along the camera's axes (the error <b>e</b>)."
                .to_string(),
        ),
        (
            motion(m, "Velocity", " / iteration", |i| {
                (i.velocity.t_m, i.velocity.theta_rad)
            }),
            "What the next move takes away of it (the velocity <b>v</b><sub>c</sub>).".to_string(),
        ),
        (convergence(r, m, lambda), convergence_caption(r, lambda)),
    ];
    figures.extend(path(r, m));
    let body: String = figures
        .into_iter()
        .map(|(svg, caption)| format!("<figure>{svg}<figcaption>{caption}</figcaption></figure>\n"))
        .collect();
    let moves = promises::figure(m).map(|(svg, caption)| {
        format!("<figure class=\"beside\">{svg}<figcaption>{caption}</figcaption></figure>\n")
    });
    format!(
        "<div class=\"plots\">\n{body}</div>\n{}",
        moves.unwrap_or_default()
    )
}

/// The share of the error that an iteration takes away: the median of |v| / |e|.
fn lambda(m: &Magnification<'_>) -> Option<f64> {
    let mut shares: Vec<f64> = m
        .iterations
        .iter()
        .map(|i| i.velocity.distance_um() / i.error.distance_um())
        .filter(|s| s.is_finite() && *s > 0.0)
        .collect();
    shares.sort_by(f64::total_cmp);
    shares.get(shares.len() / 2).copied()
}

fn iterations(m: &Magnification<'_>) -> Scale {
    let last = m.frames().last().map_or(1, |f| f.0).max(1) as f64;
    Scale::exact(-0.02 * last, 1.02 * last)
}

/// x and y above, theta below.
fn motion(
    m: &Magnification<'_>,
    name: &str,
    per: &str,
    of: impl Fn(&crate::told::Iteration<'_>) -> ([f64; 2], f64),
) -> String {
    let curve = |f: &dyn Fn(([f64; 2], f64)) -> f64| -> Vec<[f64; 2]> {
        let point = |i| {
            let i: &crate::told::Iteration<'_> = i;
            [i.iteration as f64, f(of(i))]
        };
        m.iterations.iter().map(point).collect()
    };
    let x = curve(&|e| e.0[0] * 1e6);
    let y = curve(&|e| e.0[1] * 1e6);
    let theta = curve(&|e| e.1.to_degrees());
    let with_zero = |v: &[[f64; 2]]| v.iter().map(|p| p[1]).chain([0.0]).collect::<Vec<_>>();
    let mut c = Canvas::new(
        272.0,
        &format!(
            "{name} in x, y and theta against iteration at {}",
            m.objective
        ),
    );
    let upper = Panel::wide(
        24.0,
        108.0,
        iterations(m),
        Scale::linear(with_zero(&x).into_iter().chain(with_zero(&y))),
    );
    upper.axes(&mut c, "", &format!("µm{per}"));
    c.legend(WIDTH - 80.0, 17.0, &XY);
    upper.series(&mut c, "x", Mark::Dot, &x);
    upper.series(&mut c, "y", Mark::Square, &y);
    let lower = Panel::wide(162.0, 72.0, iterations(m), Scale::linear(with_zero(&theta)));
    lower.axes(&mut c, "iteration", &format!("degrees{per}"));
    c.legend(WIDTH - 44.0, 155.0, &THETA);
    lower.series(&mut c, "theta", Mark::Triangle, &theta);
    c.finish()
}

/// |e| in a logarithmic scale, where the law is a straight line.
fn convergence(r: &Report<'_>, m: &Magnification<'_>, lambda: Option<f64>) -> String {
    let distance: Vec<_> = m
        .iterations
        .iter()
        .map(|i| [i.iteration as f64, i.error.distance_um()])
        .collect();
    let angle: Vec<_> = m
        .iterations
        .iter()
        .map(|i| [i.iteration as f64, i.error.angle_deg().abs()])
        .collect();
    let truths: Vec<_> = m
        .iterations
        .iter()
        .filter_map(|i| Some((i.iteration as f64, r.true_at(i.sequence)?)))
        .collect();
    let true_um: Vec<_> = truths.iter().map(|t| [t.0, t.1.error_um]).collect();
    let true_deg: Vec<_> = truths.iter().map(|t| [t.0, t.1.error_deg.abs()]).collect();
    let limits = limits(r, m);
    let mut c = Canvas::new(
        272.0,
        &format!(
            "Size of the error against iteration at {}, logarithmic",
            m.objective
        ),
    );
    let parts = [
        (
            24.0,
            108.0,
            &distance,
            &true_um,
            limits.map(|l| l[0]),
            "ink",
            "µm",
        ),
        (
            162.0,
            72.0,
            &angle,
            &true_deg,
            limits.map(|l| l[1]),
            "theta",
            "degrees",
        ),
    ];
    for (top, height, points, truth, limit, class, unit) in parts {
        let values = points.iter().chain(truth).map(|p| p[1]).chain(limit);
        let y = readable_log(values);
        let p = Panel::wide(top, height, iterations(m), y);
        if let Some(limit) = limit {
            p.band(&mut c, "band", y.min, limit);
        }
        let x_name = if unit == "µm" { "" } else { "iteration" };
        p.axes(&mut c, x_name, unit);
        ideal(&mut c, &p, lambda, points);
        let mark = if class == "ink" {
            Mark::Dot
        } else {
            Mark::Triangle
        };
        p.series(&mut c, class, mark, points);
        p.marks(&mut c, "truth", Mark::Ring, truth);
    }
    let keys = match truths.is_empty() {
        true => &IDEAL_AND_TRUTH[..1],
        false => &IDEAL_AND_TRUTH,
    };
    c.legend(WIDTH - 82.0 * keys.len() as f64 + 20.0, 17.0, keys);
    c.finish()
}

/// What the law should leave of the first error.
fn ideal(c: &mut Canvas, p: &Panel, lambda: Option<f64>, points: &[[f64; 2]]) {
    if let (Some(l), Some(first)) = (lambda.filter(|l| *l < 1.0), points.first()) {
        let ideal: Vec<_> = points
            .iter()
            .map(|q| [q[0], first[1] * (1.0 - l).powf(q[0] - first[0])])
            .take_while(|q| q[1] >= p.y.min)
            .collect();
        p.line(c, "ideal", &ideal);
    }
}

/// Zeros and stray tiny values must not stretch the scale over empty decades.
fn readable_log(values: impl Iterator<Item = f64>) -> Scale {
    let mut v: Vec<f64> = values.filter(|v| v.is_finite() && *v > 0.0).collect();
    v.sort_by(f64::total_cmp);
    let typical = v.get(v.len() / 4).copied().unwrap_or(1.0);
    Scale::log(v.into_iter().filter(|v| *v > typical / 300.0))
}

/// The convergence test in um and degrees at this magnification.
fn limits(r: &Report<'_>, m: &Magnification<'_>) -> Option<[f64; 2]> {
    let test = r.context.convergence?;
    let pixel = m.calibration?.um_per_px();
    let coarseness = (pixel / r.timeline.target_calibration()?.um_per_px()).max(1.0);
    let limits = [test.position_px * pixel, test.angle_deg * coarseness];
    limits
        .iter()
        .all(|l| l.is_finite() && *l > 0.0)
        .then_some(limits)
}

fn convergence_caption(r: &Report<'_>, lambda: Option<f64>) -> String {
    let mut out = String::from("How far off it stands in all, logarithmic.");
    if let Some(l) = lambda {
        out.push_str(&format!(" Dashed: what λ = {} should leave.", fixed(l, 2)));
    }
    if r.context.convergence.is_some() {
        out.push_str(" Shaded: arrived.");
    }
    out
}

/// The way of the view's centre over the specimen.
fn path(r: &Report<'_>, m: &Magnification<'_>) -> Option<(String, String)> {
    let target = r.target_size()?;
    let size = m
        .calibration
        .map(|c| c.image_size_px.map(|v| v as f64))
        .or_else(|| {
            let (w, h) = r.gallery.size(&view_name(m.iterations.first()?.sequence))?;
            Some([w, h])
        })?;
    let way: Vec<[f64; 2]> = m
        .iterations
        .iter()
        .filter_map(|i| r.timeline.offset_um(i, size, target))
        .collect();
    let (first, last) = (*way.first()?, *way.last()?);
    let truth: Vec<[f64; 2]> = m
        .iterations
        .iter()
        .filter_map(|i| r.true_at(i.sequence).map(|t| [t.x_um, t.y_um]))
        .collect();
    let of = |k: usize| way.iter().chain(&truth).map(move |p| p[k]).chain([0.0]);
    let (x, y) = (Scale::linear(of(0)), Scale::linear(of(1)));
    let (width, height) = (WIDTH - 52.0, 188.0);
    let mut p = equal_panel(x, y, width, height);
    p.y_down = true;
    let mut c = Canvas::new(
        272.0,
        &format!(
            "Path of the view's centre over the specimen at {}, from {} to {} from the saved view",
            m.objective,
            um(first[0].hypot(first[1])),
            um(last[0].hypot(last[1]))
        ),
    );
    p.axes(&mut c, "µm, to the right in the saved view", "");
    c.text("name", 0.0, 37.0, "µm, down");
    if !truth.is_empty() {
        p.line(&mut c, "truth", &truth);
    }
    p.line(&mut c, "ink", &way);
    let inner = &way[1..way.len().max(2) - 1];
    p.marks(&mut c, "ink", Mark::Dot, inner);
    let [ox, oy] = p.at(0.0, 0.0);
    c.mark("goal", Mark::Plus, ox, oy);
    p.marks(&mut c, "start", Mark::Ring, &[first]);
    p.marks(&mut c, "stop", Mark::Square, &[last]);
    let keys = match truth.is_empty() {
        true => &WAY[..3],
        false => &WAY,
    };
    c.legend(0.0, 17.0, keys);
    let caption = format!(
        "Path of the view's centre on the specimen, {} long as the crow flies; {} turned at the start.",
        um((first[0] - last[0]).hypot(first[1] - last[1])),
        deg(m.iterations.first()?.error.angle_deg().abs())
    );
    Some((c.finish(), caption))
}
