//! Studies as pages of their own: text, tables and plots, no scripts, nothing loaded from anywhere.

use std::fmt::Write as _;

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;max-width:76rem;margin:2rem auto;padding:0 1rem;color:#1b1d21;background:#fbfaf8}\
h1,h2,h3{line-height:1.2}h2{margin-top:2.4rem}h3{margin:1.6rem 0 .4rem}p{max-width:75ch}svg{display:block;width:100%;height:auto}\
.row{display:grid;gap:1.2rem;grid-template-columns:repeat(auto-fill,minmax(min(100%,19rem),1fr))}figure{margin:0}\
figcaption{font-size:.86rem;color:#5a5f68}text{font:11px system-ui,sans-serif;fill:#5a5f68}text.name{fill:#1b1d21}\
.scroll{overflow-x:auto}table{border-collapse:collapse;font-size:.88rem;font-variant-numeric:tabular-nums}\
th,td{padding:.25rem .9rem .25rem 0;text-align:right;border-bottom:1px solid #e3e1dc;white-space:nowrap}th:first-child,td:first-child{text-align:left}\
thead th{font-weight:500;color:#5a5f68}.good{fill:#2a6b45;stroke:#2a6b45}.bad{fill:#b3361e;stroke:#b3361e}.dot{fill-opacity:.75;stroke:none}\
.bar{stroke-opacity:.45}.grid{stroke:#e3e1dc}.zero{stroke:#5a5f68}.band{fill:#e2efe6}.limit{fill:none;stroke:#0072b2;stroke-dasharray:5 3;stroke-width:1.5}\
text.in{font-size:10px;fill:#1b1d21}";

/// A page under construction.
pub struct Page {
    out: String,
}

/// Safe as text.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

impl Page {
    /// A page with this title.
    pub fn new(title: &str) -> Self {
        let title = escape(title);
        Self {
            out: format!(
                "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content=\"width=device-width,initial-scale=1\">\
                 <title>{title}</title><style>{STYLE}</style><h1>{title}</h1>\n"
            ),
        }
    }

    /// A heading.
    pub fn heading(&mut self, text: &str) {
        let _ = writeln!(self.out, "<h2>{}</h2>", escape(text));
    }

    /// A paragraph.
    pub fn text(&mut self, text: &str) {
        let _ = writeln!(self.out, "<p>{}</p>", escape(text));
    }

    /// A table; the first column names the rows.
    pub fn table(&mut self, head: &[&str], rows: &[Vec<String>]) {
        let cells = |tag: &str, all: &mut dyn Iterator<Item = &str>| -> String {
            all.map(|c| format!("<{tag}>{}</{tag}>", escape(c)))
                .collect()
        };
        let head = cells("th", &mut head.iter().copied());
        let _ = write!(
            self.out,
            "<div class=scroll><table><thead><tr>{head}</tr></thead><tbody>"
        );
        for row in rows {
            let row = cells("td", &mut row.iter().map(String::as_str));
            let _ = writeln!(self.out, "<tr>{row}</tr>");
        }
        self.out.push_str("</tbody></table></div>\n");
    }

    /// Plots beside each other, each with what it shows.
    pub fn plots(&mut self, all: Vec<(Plot, String)>) {
        self.out.push_str("<div class=row>\n");
        for (plot, caption) in all {
            let _ = writeln!(
                self.out,
                "<figure>{}<figcaption>{}</figcaption></figure>",
                plot.finish(),
                escape(&caption)
            );
        }
        self.out.push_str("</div>\n");
    }

    /// The page.
    pub fn finish(self) -> String {
        self.out
    }
}

const WIDTH: f64 = 320.0;
const HEIGHT: f64 = 230.0;
const LEFT: f64 = 52.0;
const TOP: f64 = 18.0;
const RIGHT: f64 = 8.0;
const BOTTOM: f64 = 34.0;

/// One pair of axes. What lies outside is drawn at their edge.
pub struct Plot {
    x: [f64; 2],
    y: [f64; 2],
    left: f64,
    height: f64,
    body: String,
}

/// Where a value lies between two ends, 0 to 1.
fn share(value: f64, [from, to]: [f64; 2]) -> f64 {
    ((value - from) / (to - from)).clamp(0.0, 1.0)
}

/// Few round values between two ends, with as many decimals as they need.
fn ticks([from, to]: [f64; 2]) -> Vec<(f64, String)> {
    let rough = (to - from) / 5.0;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .find(|f| f * power >= rough)
        .unwrap_or(10.0)
        * power;
    let decimals = (-(step * 1.000_001).log10().floor()).max(0.0) as usize;
    let (first, last) = ((from / step).ceil() as i64, (to / step).floor() as i64);
    let label = |k: i64| {
        let v = k as f64 * step;
        (v, format!("{v:.decimals$}"))
    };
    (first..=last).map(label).collect()
}

/// A range around values and zero, as far to either side as they reach, at least so far.
pub fn around(values: impl IntoIterator<Item = f64>, least: f64) -> [f64; 2] {
    let finite = values.into_iter().filter(|v| v.is_finite());
    let reach = finite.fold(least.max(1e-12), |m, v| m.max(v.abs()));
    [-1.1 * reach, 1.1 * reach]
}

impl Plot {
    /// Axes with their names and round values.
    pub fn new(x: [f64; 2], y: [f64; 2], x_name: &str, y_name: &str) -> Self {
        let mut plot = Self::bare(x, y, x_name, y_name);
        for (v, label) in ticks(y) {
            plot.y_tick(v, &label);
        }
        for (v, label) in ticks(x) {
            plot.x_tick(v, &label);
        }
        plot
    }

    /// Axes with their names alone.
    pub fn bare(x: [f64; 2], y: [f64; 2], x_name: &str, y_name: &str) -> Self {
        Self::sized(x, y, [x_name, y_name], [LEFT, HEIGHT])
    }

    /// So many rows from 0 on, with room for their names.
    pub fn rows(x: [f64; 2], rows: usize, x_name: &str) -> Self {
        let height = 15.0 * (rows + 1) as f64 + TOP + BOTTOM;
        Self::sized(x, [-1.0, rows as f64], [x_name, ""], [118.0, height])
    }

    fn sized(
        x: [f64; 2],
        y: [f64; 2],
        [x_name, y_name]: [&str; 2],
        [left, height]: [f64; 2],
    ) -> Self {
        let mut body = String::new();
        let _ = write!(
            body,
            "<text class=name x=0 y=11>{}</text><text class=name x={:.1} y={:.1} text-anchor=middle>{}</text>",
            escape(y_name),
            left + (WIDTH - left - RIGHT) / 2.0,
            height - 4.0,
            escape(x_name)
        );
        Self {
            x,
            y,
            left,
            height,
            body,
        }
    }

    fn px(&self, x: f64) -> f64 {
        self.left + share(x, self.x) * (WIDTH - self.left - RIGHT)
    }

    fn py(&self, y: f64) -> f64 {
        self.height - BOTTOM - share(y, self.y) * (self.height - TOP - BOTTOM)
    }

    /// A line across at a y, with a label.
    pub fn y_tick(&mut self, y: f64, label: &str) {
        let class = if y == 0.0 { "zero" } else { "grid" };
        let at = self.py(y);
        let _ = write!(
            self.body,
            "<path class={class} d=\"M{:.1} {at:.1}H{:.1}\"/><text x={:.1} y={:.1} text-anchor=end>{}</text>",
            self.left,
            WIDTH - RIGHT,
            self.left - 5.0,
            at + 4.0,
            escape(label)
        );
    }

    /// A label at an x.
    pub fn x_tick(&mut self, x: f64, label: &str) {
        let _ = write!(
            self.body,
            "<text x={:.1} y={:.1} text-anchor=middle>{}</text>",
            self.px(x),
            self.height - BOTTOM + 13.0,
            escape(label)
        );
    }

    /// A dot.
    pub fn dot(&mut self, x: f64, y: f64, good: bool) {
        let class = if good { "good" } else { "bad" };
        let _ = write!(
            self.body,
            "<circle class=\"dot {class}\" cx={:.1} cy={:.1} r=2.6 />",
            self.px(x),
            self.py(y)
        );
    }

    /// A line through points.
    pub fn line(&mut self, points: impl IntoIterator<Item = (f64, f64)>, good: bool) {
        let class = if good { "good" } else { "bad" };
        let points: Vec<String> = points
            .into_iter()
            .map(|(x, y)| format!("{:.1} {:.1}", self.px(x), self.py(y)))
            .collect();
        if points.len() > 1 {
            let _ = write!(
                self.body,
                "<path class=\"bar {class}\" fill=none style=\"fill:none\" d=\"M{}\"/>",
                points.join("L")
            );
        }
    }

    /// A bar upright from one y to another.
    pub fn upright(&mut self, x: f64, [from, to]: [f64; 2], good: bool) {
        let class = if good { "good" } else { "bad" };
        let _ = write!(
            self.body,
            "<path class=\"bar {class}\" d=\"M{:.1} {:.1}V{:.1}\"/>",
            self.px(x),
            self.py(from),
            self.py(to)
        );
    }

    /// A bar across from one x to another.
    pub fn across(&mut self, y: f64, [from, to]: [f64; 2], good: bool) {
        let class = if good { "good" } else { "bad" };
        let _ = write!(
            self.body,
            "<path class=\"bar {class}\" d=\"M{:.1} {:.1}H{:.1}\"/>",
            self.px(from),
            self.py(y),
            self.px(to)
        );
    }

    /// A rectangle of a colour, with words in it.
    pub fn cell(&mut self, x: [f64; 2], y: [f64; 2], fill: &str, words: &str) {
        let (left, right) = (self.px(x[0]), self.px(x[1]));
        let (bottom, top) = (self.py(y[0]), self.py(y[1]));
        let _ = write!(
            self.body,
            "<rect x={left:.1} y={top:.1} width={:.1} height={:.1} fill=\"{fill}\"/><text class=in x={:.1} y={:.1} text-anchor=middle>{}</text>",
            right - left - 0.8,
            bottom - top - 0.8,
            (left + right) / 2.0,
            (top + bottom) / 2.0 + 3.5,
            escape(words)
        );
    }

    /// A filled rectangle, beneath all else.
    pub fn band(&mut self, x: [f64; 2], y: [f64; 2]) {
        let band = self.rectangle("band", x, y);
        self.body.insert_str(0, &band);
    }

    /// The outline of a rectangle.
    pub fn limit(&mut self, x: [f64; 2], y: [f64; 2]) {
        let limit = self.rectangle("limit", x, y);
        self.body.push_str(&limit);
    }

    fn rectangle(&self, class: &str, x: [f64; 2], y: [f64; 2]) -> String {
        let (left, top) = (self.px(x[0]), self.py(y[1]));
        format!(
            "<rect class={class} x={left:.1} y={top:.1} width={:.1} height={:.1} />",
            self.px(x[1]) - left,
            self.py(y[0]) - top
        )
    }

    fn finish(self) -> String {
        format!(
            "<svg viewBox=\"0 0 {WIDTH} {}\" role=img>{}</svg>",
            self.height, self.body
        )
    }
}

/// The interval in which a share lies with 95 %, by so many of so many: Wilson's. All of it where there are none.
pub fn wilson_95(hits: usize, of: usize) -> [f64; 2] {
    if of == 0 {
        return [0.0, 1.0];
    }
    let (n, p, z) = (of as f64, hits as f64 / of as f64, 1.96f64);
    let middle = p + z * z / (2.0 * n);
    let half = z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    [middle - half, middle + half].map(|v| v / (1.0 + z * z / n))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_outside_is_drawn_at_the_edge_and_markup_is_harmless() {
        let mut plot = Plot::new([0.0, 10.0], [-1.0, 1.0], "a<b", "y");
        plot.dot(20.0, 5.0, false);
        let svg = plot.finish();
        assert!(svg.contains("cx=312.0 cy=18.0"), "{svg}");
        assert!(svg.contains("a&lt;b") && !svg.contains("a<b"));
    }

    #[test]
    fn ticks_are_round() {
        let labels: Vec<String> = ticks([-0.7, 31.0]).into_iter().map(|t| t.1).collect();
        assert_eq!(labels, ["0", "10", "20", "30"]);
    }

    #[test]
    fn an_interval_is_wilsons() {
        let [low, high] = wilson_95(95, 100);
        assert!(
            (low - 0.8882).abs() < 5e-4 && (high - 0.9785).abs() < 5e-4,
            "{low} {high}"
        );
        assert_eq!(wilson_95(0, 0), [0.0, 1.0]);
        assert!(wilson_95(10, 10)[1] <= 1.0 + 1e-12);
    }
}
