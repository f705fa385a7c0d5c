//! Where the view's centre ended around the target's.

use crate::model::{Report, view_name};
use crate::svg::{Attr, Canvas, Key, Mark, Panel, Scale, nice_step};
use crate::text::{fixed, short, um};

/// Rings about a centre, `ring` micrometres apart, where one micrometre is `unit` long.
fn rings(c: &mut Canvas, [cx, cy]: [f64; 2], ring: f64, unit: f64, count: usize) {
    for k in 1..=count {
        let radius = k as f64 * ring * unit;
        c.raw(&format!(
            "<circle class=\"grid\" cx=\"{}\" cy=\"{}\" r=\"{}\"/>",
            Attr(cx),
            Attr(cy),
            Attr(radius)
        ));
        let decimals = (-ring.log10().floor()).max(0.0) as usize;
        c.text(
            "tick mid lift",
            cx,
            cy - radius + 4.0,
            &fixed(k as f64 * ring, decimals),
        );
    }
}

/// The square of one pixel of the target, from its centre and half its side.
fn square(c: &mut Canvas, [cx, cy]: [f64; 2], half: f64) {
    c.raw(&format!(
        "<rect class=\"pixel\" x=\"{}\" y=\"{}\" width=\"{2}\" height=\"{2}\"/>",
        Attr(cx - half),
        Attr(cy - half),
        Attr(2.0 * half)
    ));
}

/// Where the view's centre ended around the target's, against one pixel.
pub(crate) fn figure(r: &Report<'_>) -> Option<String> {
    r.timeline.outcome?.estimated_error_um?;
    let step = r.timeline.last_seen()?;
    let target = r.target_size()?;
    let (w, h) = r.gallery.size(&view_name(step.sequence))?;
    let [x, y] = r.timeline.offset_um(step, [w, h], target)?;
    let pixel_um = r.timeline.target_calibration()?.um_per_px();
    let sigma_um = step.sigma_px * pixel_um;
    let truth = r.true_at(step.sequence).map(|t| [t.x_um, t.y_um]);
    let reach = [
        x,
        y,
        truth.map_or(0.0, |t| t[0]),
        truth.map_or(0.0, |t| t[1]),
        pixel_um,
    ]
    .into_iter()
    .filter(|v| v.is_finite())
    .fold(2.0 * sigma_um, |m, v| m.max(v.abs()));
    let ring = nice_step(reach / 3.0);
    let outer = ring * (reach / ring * 1.02).ceil();
    let side = 236.0;
    let p = Panel {
        left: 22.0,
        top: 10.0,
        width: side,
        height: side,
        x: Scale::exact(-outer, outer),
        y: Scale::exact(-outer, outer),
        y_down: true,
    };
    let mut c = Canvas::new(
        side + 34.0,
        &format!(
            "The view's centre ended {} from the saved view's",
            um(x.hypot(y))
        ),
    );
    let unit = side / (2.0 * outer);
    let [cx, cy] = p.at(0.0, 0.0);
    rings(
        &mut c,
        [cx, cy],
        ring,
        unit,
        (outer / ring).round() as usize,
    );
    square(&mut c, [cx, cy], pixel_um * unit / 2.0);
    c.mark("faint", Mark::Plus, cx, cy);
    let [mx, my] = p.at(x, y);
    c.raw(&format!(
        "<circle class=\"sigma\" cx=\"{}\" cy=\"{}\" r=\"{}\"/>",
        Attr(mx),
        Attr(my),
        Attr((sigma_um * unit).max(1.0))
    ));
    c.mark("ink", Mark::Dot, mx, my);
    let mut keys = vec![Key {
        class: "ink",
        mark: Some(Mark::Dot),
        line: false,
        label: "last measurement",
    }];
    if let Some([tx, ty]) = truth {
        let [tx, ty] = p.at(tx, ty);
        c.mark("truth", Mark::Ring, tx, ty);
        keys.push(Key {
            class: "truth",
            mark: Some(Mark::Ring),
            line: false,
            label: "truth",
        });
    }
    c.legend(36.0, side + 30.0, &keys);
    Some(format!(
        "<figure>{}<figcaption>Where the view's centre ended around the saved view's, µm. The square is one pixel of the \
         saved view ({} µm); the disc is one standard deviation.</figcaption></figure>\n",
        c.finish(),
        short(pixel_um)
    ))
}
