//! What was calibrated, how well, and against the truth where it is known.

use crate::model::Report;
use crate::model::TrueCalibration;
use crate::svg::{Canvas, Mark, Panel, Scale, WIDTH};
use crate::text::{count, escape, fixed, group, short, um};
use crate::told::Calibrating;
use scopeservo_servo::{Calibration, EXAMPLE_MOVE};
use std::fmt::Write as _;

/// How a number is read off a calibration.
type Reader = fn(&Calibration) -> Option<f64>;

/// One number of a calibration in the unit that people read.
struct Quantity {
    name: &'static str,
    unit: &'static str,
    value: f64,
    sigma: Option<f64>,
    truth: Option<f64>,
}

pub(crate) fn section(r: &Report<'_>) -> String {
    if r.timeline.calibrations.is_empty() && r.timeline.used().next().is_none() {
        return "<p class=\"none\">The run did not come to a calibration.</p>\n".into();
    }
    let mut out = String::from(
        "<p class=\"lead\">How a pixel of each objective relates to the stage, measured by moving the stage and watching the specimen. \
         <i>k</i> and φ read the map as in the paper's Eq. (1) and (3); η is where the stage's axis of rotation lies from the \
         image's middle. After ± one standard deviation.</p>\n<div class=\"cards\">\n",
    );
    for c in &r.timeline.calibrations {
        let objective = escape(&c.objective.0);
        let _ = writeln!(
            out,
            "<article class=\"card\"><h3>{objective}</h3>\n{}{}</article>",
            card(r, c),
            shifts(c)
        );
    }
    for stored in r.timeline.used() {
        let of = &stored.calibration;
        let _ = writeln!(
            out,
            "<article class=\"card\"><h3>{}</h3>\n<p>As it was known{}, from <code>{}</code>.</p>\n{}</article>",
            escape(&of.objective.0),
            escape(&stored.of_when()),
            escape(&stored.file),
            numbers(r, of)
        );
    }
    out.push_str("</div>\n");
    out
}

/// The numbers of one calibration, and what they make of a move.
fn numbers(r: &Report<'_>, c: &Calibration) -> String {
    let truths = r.truth.map_or(&[][..], |t| &t.calibrations);
    let truth = truths.iter().find(|t| t.objective == c.objective.0);
    let mut out = table(&quantities(c, truth));
    if c.reading().is_none() {
        out.push_str(
            "<p>The camera is mirrored against the stage, or the stage has the other handedness: <i>k</i> and φ do not \
             describe this map, and the program uses the map itself.</p>\n",
        );
    }
    out.push_str(&arrivals(c));
    if let Some(b) = c.backlash {
        let um = |v: f64, sigma: f64| {
            format!(
                "{} <small>± {}</small> µm",
                fixed(1e6 * v, 2),
                fixed(1e6 * sigma, 2)
            )
        };
        let _ = writeln!(
            out,
            "<p>Backlash: <i>x</i> {}, <i>y</i> {}.</p>",
            um(b.x_m, b.sigma[0]),
            um(b.y_m, b.sigma[1])
        );
    }
    out
}

/// A calibration in a sentence or two.
pub(crate) fn in_words(c: &Calibration) -> String {
    let um_per_px = c.um_per_px();
    let known = c.sigma_of(|c| Some(c.um_per_px()));
    let known = known.map_or(String::new(), |s| {
        format!(", known to {} %", short(100.0 * s / um_per_px))
    });
    let move_off = c.expected_error_um().map_or(String::new(), |off_um| {
        let turns = c.rotation_centre_m.map_or("", |_| " and 1°");
        format!(
            "; one move of {} µm{turns} is expected to end {} off",
            fixed(EXAMPLE_MOVE.0 * 1e6, 0),
            um(off_um)
        )
    });
    format!(
        "{}: a pixel is {} µm on the specimen{known}{move_off}.",
        c.objective,
        fixed(um_per_px, 4)
    )
}

/// The direction of the image's x in the stage's axes, degrees.
pub(crate) fn image_x_deg(c: &Calibration) -> f64 {
    let [[a, _], [b, _]] = c.stage_from_pixel.0;
    b.atan2(a).to_degrees()
}

/// How far the image's axes are from a right angle in the stage's, degrees.
fn skew_deg(c: &Calibration) -> f64 {
    let [[a, b], [d, e]] = c.stage_from_pixel.0;
    let cosine = (a * b + d * e) / (f64::hypot(a, d) * f64::hypot(b, e));
    cosine.clamp(-1.0, 1.0).asin().to_degrees()
}

/// The numbers of a calibration, or that there are none.
pub(crate) fn card(r: &Report<'_>, c: &Calibrating<'_>) -> String {
    let mut out = String::from("<div class=\"numbers-of\">\n");
    match c.made {
        None => {
            let found = c.shifts_px.iter().flatten().count();
            let _ = writeln!(
                out,
                "<p class=\"none\">This calibration did not succeed: {found} of {} recognised.</p>",
                count(c.shifts_px.len(), "view")
            );
        }
        Some((calibration, residual_px, views)) => {
            let residual = if residual_px.is_finite() {
                format!(
                    ", {} px from where the stage says that it was (root mean square)",
                    fixed(residual_px, 3)
                )
            } else {
                String::new()
            };
            let _ = writeln!(out, "<p>From {}{residual}.</p>", count(views, "view"));
            out.push_str(&numbers(r, calibration));
        }
    }
    out.push_str("</div>\n");
    out
}

/// How the stage arrives, and what that makes of a move.
fn arrivals(c: &Calibration) -> String {
    let mut out = String::new();
    if let Some([x, y, turn]) = c.scatter {
        let _ = write!(
            out,
            "<p>Arrivals scatter (σ): <i>x</i> {} µm, <i>y</i> {} µm",
            fixed(1e6 * x, 3),
            fixed(1e6 * y, 3)
        );
        if turn > 0.0 {
            let _ = write!(out, ", rotation {}°", fixed(turn.to_degrees(), 5));
        }
        out.push_str(".</p>\n");
    }
    if let Some(off_um) = c.expected_error_um() {
        let turns = c.rotation_centre_m.map_or("", |_| " and 1°");
        let _ = writeln!(
            out,
            "<p>Predicted arrival error of one move of {} µm{turns}: <b>{}</b>.</p>",
            fixed(EXAMPLE_MOVE.0 * 1e6, 0),
            um(off_um)
        );
    }
    out
}

fn table(quantities: &[Quantity]) -> String {
    let truth = quantities.iter().any(|q| q.truth.is_some());
    let mut out = String::from(
        "<div class=\"scroll\"><table>\n<thead><tr><th scope=\"col\"></th><th scope=\"col\">measured</th>",
    );
    if truth {
        out.push_str("<th scope=\"col\">truth</th><th scope=\"col\">off by</th>");
    }
    out.push_str("</tr></thead>\n<tbody>\n");
    for q in quantities {
        let decimals = decimals(q);
        let sigma = q.sigma.map_or(String::new(), |s| {
            format!(" <small>± {}</small>", group(s, decimals))
        });
        let _ = write!(
            out,
            "<tr><th scope=\"row\">{} <small>{}</small></th><td>{}{sigma}</td>",
            q.name,
            q.unit,
            group(q.value, decimals)
        );
        if truth {
            match q.truth {
                Some(t) => {
                    let off = match q.sigma {
                        Some(s) if s > 0.0 => format!("{} σ", fixed(((q.value - t) / s).abs(), 1)),
                        _ if t != 0.0 => {
                            format!("{} %", fixed(100.0 * ((q.value - t) / t).abs(), 2))
                        }
                        _ => group((q.value - t).abs(), decimals),
                    };
                    let _ = write!(out, "<td>{}</td><td>{off}</td>", group(t, decimals));
                }
                None => out.push_str("<td></td><td></td>"),
            }
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
    out
}

/// Two significant digits of the standard deviation, or five of the value.
fn decimals(q: &Quantity) -> usize {
    let (size, digits) = match q.sigma {
        Some(s) if s > 0.0 => (s, 1.0),
        _ => (q.value.abs().max(1e-9), 4.0),
    };
    (digits - size.log10().floor()).clamp(0.0, 6.0) as usize
}

fn quantities(c: &Calibration, truth: Option<&TrueCalibration>) -> Vec<Quantity> {
    let mut out = vec![Quantity {
        name: "pixel",
        unit: "µm",
        value: c.um_per_px(),
        sigma: c.sigma_of(|c| Some(c.um_per_px())),
        truth: truth.map(|t| 1e6 / (t.kx_px_per_m * t.ky_px_per_m).abs().sqrt()),
    }];
    if let Some(reading) = c.reading() {
        let phi_deg = reading.phi_rad.to_degrees();
        // (kx, ky, phi) and (-kx, -ky, phi + 180 deg) are the same map: the truth is read as the measurement is.
        let truth = truth.map(|t| {
            let half_turns = ((phi_deg - t.phi_deg) / 180.0).round();
            let sign = if half_turns % 2.0 == 0.0 { 1.0 } else { -1.0 };
            [
                sign * t.kx_px_per_m,
                sign * t.ky_px_per_m,
                t.phi_deg + 180.0 * half_turns,
            ]
        });
        let parts: [(&str, &str, Reader); 3] = [
            ("<i>k</i><sub>x</sub>", "px/mm", |c| {
                Some(c.reading()?.kx_px_per_m * 1e-3)
            }),
            ("<i>k</i><sub>y</sub>", "px/mm", |c| {
                Some(c.reading()?.ky_px_per_m * 1e-3)
            }),
            ("φ", "°", |c| Some(c.reading()?.phi_rad.to_degrees())),
        ];
        for (k, (name, unit, of)) in parts.into_iter().enumerate() {
            let scale = if k < 2 { 1e-3 } else { 1.0 };
            if let Some(value) = of(c) {
                out.push(Quantity {
                    name,
                    unit,
                    value,
                    sigma: c.sigma_of(of),
                    truth: truth.map(|t| t[k] * scale),
                });
            }
        }
    }
    let axes: [(&str, Reader); 2] = [
        ("image <i>x</i> against stage <i>x</i>", |c| {
            Some(image_x_deg(c))
        }),
        ("skew", |c| Some(skew_deg(c))),
    ];
    // Where phi is told it says the same.
    for (name, of) in axes.into_iter().skip(usize::from(c.reading().is_some())) {
        out.extend(of(c).map(|value| Quantity {
            name,
            unit: "°",
            value,
            sigma: c.sigma_of(of),
            truth: None,
        }));
    }
    if let Some(eta) = c.rotation_centre_m {
        for (k, name) in ["η<sub>x</sub>", "η<sub>y</sub>"].into_iter().enumerate() {
            let variance = c.covariance.map(|v| v[4 + k][4 + k]);
            out.push(Quantity {
                name,
                unit: "mm",
                value: eta[k] * 1e3,
                sigma: variance.filter(|v| *v > 0.0).map(|v| v.sqrt() * 1e3),
                truth: truth.map(|t| t.eta_mm[k]),
            });
        }
    }
    out.retain(|q| q.value.is_finite());
    out
}

/// Where the reference image's middle was seen in each view.
fn shifts(c: &Calibrating<'_>) -> String {
    let points: Vec<[f64; 2]> = c.shifts_px.iter().flatten().copied().collect();
    if points.is_empty() {
        return String::new();
    }
    let lost = c.shifts_px.len() - points.len();
    let reach = points
        .iter()
        .flatten()
        .filter(|v| v.is_finite())
        .fold(1.0f64, |m, v| m.max(v.abs()))
        * 1.12;
    let height = 150.0;
    let width = WIDTH - 52.0;
    let mut p = Panel::wide(
        24.0,
        height,
        Scale::exact(-reach * width / height, reach * width / height),
        Scale::exact(-reach, reach),
    );
    p.y_down = true;
    let mut canvas = Canvas::new(
        216.0,
        &format!(
            "Displacements of the image in the calibration views of {}",
            c.objective
        ),
    );
    p.axes(&mut canvas, "px", "px");
    for point in &points {
        p.line(&mut canvas, "faint", &[[0.0, 0.0], *point]);
    }
    p.marks(&mut canvas, "calibrate", Mark::Dot, &points);
    let [x, y] = p.at(0.0, 0.0);
    canvas.mark("ink", Mark::Plus, x, y);
    let caption = if lost == 0 {
        "Displacements seen in the calibration views.".to_string()
    } else {
        format!(
            "Displacements seen in the calibration views; {} not recognised.",
            count(lost, "view")
        )
    };
    format!(
        "<figure>{}<figcaption>{caption}</figcaption></figure>\n",
        canvas.finish()
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::Mat2;
    use scopeservo_scope::ObjectiveId;
    use scopeservo_servo::CALIBRATION_SCHEMA;

    #[test]
    fn a_relative_spread_of_the_map_is_the_same_spread_of_k() {
        let (kx, ky) = (-1_953_155.0, -1_981_235.0);
        let map = Mat2([[0.0, -1.0 / ky], [-1.0 / kx, 0.0]]);
        let mut covariance = [[0.0; 6]; 6];
        covariance[1][1] = (1e-3 / ky).powi(2);
        covariance[2][2] = (1e-3 / kx).powi(2);
        let c = Calibration {
            schema: CALIBRATION_SCHEMA,
            objective: ObjectiveId("400x".into()),
            image_size_px: [640, 480],
            stage_from_pixel: map,
            rotation_centre_m: None,
            covariance: Some(covariance),
            backlash: None,
            scatter: None,
        };
        let s = c.sigma_of(|c| Some(c.reading()?.kx_px_per_m)).unwrap();
        assert!((s / (1e-3 * kx.abs()) - 1.0).abs() < 1e-3, "{s}");
        let s = c.sigma_of(|c| Some(c.um_per_px())).unwrap();
        let expected = 1e-3 * c.um_per_px() / 2f64.sqrt();
        assert!((s / expected - 1.0).abs() < 1e-3, "{s}");
    }
}
