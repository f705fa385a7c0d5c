//! A little plotting: scales with round ticks, linear or logarithmic, lines, points, bands and legends.
//!
//! A figure is 280 units wide and its text 12 units high, so that on a phone, where it is wider than that, nothing is
//! smaller than 12 px. Colours come from classes, so that the page's style and its dark mode decide.

use crate::text::{escape, fixed};
use std::fmt::{self, Write as _};

/// Width of a figure.
pub(crate) const WIDTH: f64 = 280.0;

/// A number as an attribute: finite, two decimals.
pub(crate) struct Attr(pub(crate) f64);

impl fmt::Display for Attr {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let v = if self.0.is_finite() {
            (self.0 * 100.0).round() / 100.0
        } else {
            0.0
        };
        write!(f, "{}", if v == 0.0 { 0.0 } else { v })
    }
}

/// From data to the figure's units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scale {
    pub(crate) min: f64,
    pub(crate) max: f64,
    log: bool,
}

impl Scale {
    /// Spans the finite values and a margin; `[0, 1]` when there are none.
    pub(crate) fn linear(values: impl IntoIterator<Item = f64>) -> Self {
        let (min, max) = extent(values).unwrap_or((0.0, 1.0));
        let span = max - min;
        let margin = if span > 0.0 {
            0.06 * span
        } else if min == 0.0 {
            1.0
        } else {
            0.5 * min.abs()
        };
        Self::exact(min - margin, max + margin)
    }

    /// Spans just this.
    pub(crate) fn exact(min: f64, max: f64) -> Self {
        Self {
            min,
            max: if max > min { max } else { min + 1.0 },
            log: false,
        }
    }

    /// Spans the positive values in a logarithmic scale.
    pub(crate) fn log(values: impl IntoIterator<Item = f64>) -> Self {
        let positive = values.into_iter().filter(|v| *v > 0.0);
        let (min, max) = extent(positive).unwrap_or((0.1, 1.0));
        Self {
            min: min / 1.4,
            max: max * 1.4,
            log: true,
        }
    }

    /// 0 at the lower end, 1 at the upper.
    pub(crate) fn share(&self, value: f64) -> f64 {
        if self.log {
            (value.max(self.min) / self.min).ln() / (self.max / self.min).ln()
        } else {
            (value - self.min) / (self.max - self.min)
        }
    }

    /// About `wanted` round values with their labels.
    pub(crate) fn ticks(&self, wanted: usize) -> Vec<(f64, String)> {
        if self.log {
            return self.log_ticks(wanted);
        }
        // Round steps can be so long that hardly one falls inside.
        let span = self.max - self.min;
        let steps = [1.0, 0.5, 0.25, 0.1].map(|f| nice_step(f * span / wanted.max(1) as f64));
        let inside = |step: f64| {
            let (first, last) = ((self.min / step).ceil(), (self.max / step).floor());
            (first as i64, last as i64)
        };
        let step = steps
            .into_iter()
            .find(|s| inside(*s).1 - inside(*s).0 >= 2)
            .unwrap_or(steps[1]);
        let decimals = (-(step * 1.000_001).log10().floor()).max(0.0) as usize;
        let (first, last) = inside(step);
        (first..=last.min(first + 30))
            .map(|k| {
                let v = k as f64 * step;
                (v, fixed(v, decimals))
            })
            .collect()
    }

    fn log_ticks(&self, wanted: usize) -> Vec<(f64, String)> {
        let (low, high) = (self.min.log10(), self.max.log10());
        let stride = ((high - low) / wanted.max(1) as f64).ceil().max(1.0) as i32;
        let factors: &[f64] = if high - low < 1.6 {
            &[1.0, 2.0, 5.0]
        } else {
            &[1.0]
        };
        let mut ticks = Vec::new();
        for decade in (low.floor() as i32..=high.ceil() as i32).filter(|d| d % stride == 0) {
            for factor in factors {
                let v = factor * 10f64.powi(decade);
                if v >= self.min && v <= self.max {
                    ticks.push((v, fixed(v, (-decade).max(0) as usize)));
                }
            }
        }
        ticks
    }
}

fn extent(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    values
        .into_iter()
        .filter(|v| v.is_finite())
        .fold(None, |e, v| match e {
            None => Some((v, v)),
            Some((a, b)) => Some((a.min(v), b.max(v))),
        })
}

/// The next of 1, 2, 5 times a power of ten.
pub(crate) fn nice_step(at_least: f64) -> f64 {
    let power = 10f64.powf(at_least.max(1e-12).log10().floor());
    let factor = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .find(|f| f * power >= at_least * (1.0 - 1e-9))
        .unwrap_or(10.0);
    factor * power
}

/// The shape of a point: series differ in more than colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mark {
    Dot,
    Square,
    Triangle,
    Ring,
    Plus,
}

/// One entry of a legend.
pub(crate) struct Key {
    pub(crate) class: &'static str,
    pub(crate) mark: Option<Mark>,
    /// Whether a line joins the marks.
    pub(crate) line: bool,
    pub(crate) label: &'static str,
}

/// A figure under construction.
pub(crate) struct Canvas {
    height: f64,
    label: String,
    body: String,
}

impl Canvas {
    /// `label` is what a reader who does not see it is told.
    pub(crate) fn new(height: f64, label: &str) -> Self {
        Self {
            height,
            label: escape(label),
            body: String::new(),
        }
    }

    pub(crate) fn finish(self) -> String {
        format!(
            "<svg class=\"plot\" role=\"img\" viewBox=\"0 0 {WIDTH} {}\" aria-label=\"{1}\"><title>{1}</title>{2}</svg>",
            Attr(self.height),
            self.label,
            self.body
        )
    }

    /// Raw elements.
    pub(crate) fn raw(&mut self, element: &str) {
        self.body.push_str(element);
    }

    pub(crate) fn text(&mut self, class: &str, x: f64, y: f64, text: &str) {
        let _ = write!(
            self.body,
            "<text class=\"{class}\" x=\"{}\" y=\"{}\">{}</text>",
            Attr(x),
            Attr(y),
            escape(text)
        );
    }

    pub(crate) fn mark(&mut self, class: &str, mark: Mark, x: f64, y: f64) {
        let r = 2.6;
        let d = match mark {
            Mark::Dot | Mark::Ring => {
                let kind = if mark == Mark::Ring { "ring" } else { "mark" };
                let r = if mark == Mark::Ring { 3.4 } else { r };
                let _ = write!(
                    self.body,
                    "<circle class=\"{kind} {class}\" cx=\"{}\" cy=\"{}\" r=\"{r}\"/>",
                    Attr(x),
                    Attr(y)
                );
                return;
            }
            Mark::Square => format!("M{} {}h4.6v4.6h-4.6z", Attr(x - 2.3), Attr(y - 2.3)),
            Mark::Triangle => format!("M{} {}l3 5.4h-6z", Attr(x), Attr(y - 3.4)),
            Mark::Plus => {
                let _ = write!(
                    self.body,
                    "<path class=\"line {class}\" d=\"M{} {}h12m-6 -6v12\"/>",
                    Attr(x - 6.0),
                    Attr(y)
                );
                return;
            }
        };
        let _ = write!(self.body, "<path class=\"mark {class}\" d=\"{d}\"/>");
    }

    /// Keys in one row from `x` on.
    pub(crate) fn legend(&mut self, mut x: f64, y: f64, keys: &[Key]) {
        for key in keys {
            if key.line {
                let _ = write!(
                    self.body,
                    "<path class=\"line {}\" d=\"M{} {}h14\"/>",
                    key.class,
                    Attr(x),
                    Attr(y - 4.0)
                );
            }
            if let Some(mark) = key.mark {
                self.mark(key.class, mark, x + 7.0, y - 4.0);
            }
            self.text("key", x + 18.0, y, key.label);
            x += 28.0 + 6.6 * key.label.chars().count() as f64;
        }
    }
}

/// One pair of axes in a figure.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Panel {
    pub(crate) left: f64,
    pub(crate) top: f64,
    pub(crate) width: f64,
    pub(crate) height: f64,
    pub(crate) x: Scale,
    pub(crate) y: Scale,
    /// Whether larger y lie lower, as in an image.
    pub(crate) y_down: bool,
}

impl Panel {
    /// Fills the figure's width between room for y labels and the right edge.
    pub(crate) fn wide(top: f64, height: f64, x: Scale, y: Scale) -> Self {
        let left = 44.0;
        Self {
            left,
            top,
            width: WIDTH - left - 8.0,
            height,
            x,
            y,
            y_down: false,
        }
    }

    pub(crate) fn at(&self, x: f64, y: f64) -> [f64; 2] {
        let down = self.y.share(y);
        let down = if self.y_down { down } else { 1.0 - down };
        [
            self.left + self.x.share(x) * self.width,
            self.top + down * self.height,
        ]
    }

    /// Grid, tick labels and axis names; no x labels for an empty `x_name`.
    pub(crate) fn axes(&self, c: &mut Canvas, x_name: &str, y_name: &str) {
        let (right, bottom) = (self.left + self.width, self.top + self.height);
        for (v, label) in self.y.ticks((self.height / 26.0) as usize) {
            let y = self.at(self.x.min, v)[1];
            let class = if v == 0.0 { "grid zero" } else { "grid" };
            let _ = write!(
                c.body,
                "<path class=\"{class}\" d=\"M{} {}H{}\"/>",
                Attr(self.left),
                Attr(y),
                Attr(right)
            );
            c.text("tick end", self.left - 5.0, y + 4.0, &label);
        }
        for (v, label) in self.x.ticks(5) {
            let x = self.at(v, self.y.min)[0];
            let _ = write!(
                c.body,
                "<path class=\"grid\" d=\"M{} {}V{}\"/>",
                Attr(x),
                Attr(self.top),
                Attr(bottom)
            );
            if !x_name.is_empty() {
                c.text("tick mid", x, bottom + 15.0, &label);
            }
        }
        if !x_name.is_empty() {
            c.text(
                "name mid",
                self.left + self.width / 2.0,
                bottom + 31.0,
                x_name,
            );
        }
        c.text("name", 0.0, self.top - 7.0, y_name);
    }

    /// A line through the finite points.
    pub(crate) fn line(&self, c: &mut Canvas, class: &str, points: &[[f64; 2]]) {
        let mut d = String::new();
        for p in points.iter().filter(|p| p.iter().all(|v| v.is_finite())) {
            let [x, y] = self.at(p[0], p[1]);
            let letter = if d.is_empty() { 'M' } else { 'L' };
            let _ = write!(d, "{letter}{} {}", Attr(x), Attr(y));
        }
        if !d.is_empty() {
            let _ = write!(c.body, "<path class=\"line {class}\" d=\"{d}\"/>");
        }
    }

    /// A mark at every finite point.
    pub(crate) fn marks(&self, c: &mut Canvas, class: &str, mark: Mark, points: &[[f64; 2]]) {
        for p in points.iter().filter(|p| p.iter().all(|v| v.is_finite())) {
            let [x, y] = self.at(p[0], p[1]);
            c.mark(class, mark, x, y);
        }
    }

    /// A line with marks, when they do not crowd.
    pub(crate) fn series(&self, c: &mut Canvas, class: &str, mark: Mark, points: &[[f64; 2]]) {
        self.line(c, class, points);
        if points.len() <= 36 {
            self.marks(c, class, mark, points);
        }
    }

    /// A horizontal band, cut to the panel.
    pub(crate) fn band(&self, c: &mut Canvas, class: &str, from: f64, to: f64) {
        let clamp = |v: f64| v.clamp(self.y.min, self.y.max);
        let (a, b) = (
            self.at(self.x.min, clamp(from))[1],
            self.at(self.x.min, clamp(to))[1],
        );
        let _ = write!(
            c.body,
            "<rect class=\"{class}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"/>",
            Attr(self.left),
            Attr(a.min(b)),
            Attr(self.width),
            Attr((a - b).abs())
        );
    }
}

/// A panel in which a unit is as long in both directions.
pub(crate) fn equal_panel(x: Scale, y: Scale, width: f64, height: f64) -> Panel {
    let per_unit = ((x.max - x.min) / width).max((y.max - y.min) / height);
    let around = |s: Scale, units: f64| {
        let middle = (s.min + s.max) / 2.0;
        Scale::exact(
            middle - units * per_unit / 2.0,
            middle + units * per_unit / 2.0,
        )
    };
    Panel::wide(46.0, height, around(x, width), around(y, height))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let s = Scale::exact(-0.7, 31.2);
        let ticks = s.ticks(5);
        assert_eq!(
            ticks.iter().map(|t| &*t.1).collect::<Vec<_>>(),
            ["0", "10", "20", "30"]
        );
        let s = Scale::log([0.02, 340.0]);
        let labels: Vec<_> = s.ticks(6).into_iter().map(|t| t.1).collect();
        assert_eq!(labels, ["0.1", "1", "10", "100"]);
        assert!((s.share(s.min)).abs() < 1e-12 && (s.share(s.max) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn nothing_degenerate_reaches_the_page() {
        for s in [
            Scale::linear([]),
            Scale::linear([f64::NAN]),
            Scale::linear([3.0]),
            Scale::linear([0.0, 0.0]),
            Scale::log([]),
            Scale::log([0.0, -1.0]),
        ] {
            assert!(s.share(0.5).is_finite());
            assert!(s.ticks(4).iter().all(|t| t.0.is_finite()));
        }
        assert_eq!(Attr(f64::NAN).to_string(), "0");
        assert_eq!(Attr(-0.001).to_string(), "0");
    }

    #[test]
    fn steps_are_one_two_five() {
        for (raw, step) in [
            (0.9, 1.0),
            (1.1, 2.0),
            (2.0, 2.0),
            (3.0, 5.0),
            (70.0, 100.0),
        ] {
            assert!((nice_step(raw) - step).abs() < 1e-9 * step);
        }
    }
}
