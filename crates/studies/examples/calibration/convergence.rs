//! How wrong a calibration may be so that the paper's law still comes back with it: the convergence range of Table II.

use crate::instrument::{Bench, Design};
use crate::specimens::Specimens;
use scopeservo_geometry::Mat2;
use scopeservo_servo::{
    CALIBRATION_SCHEMA, Calibration, Law, NoSink, Progress, Servo, ServoOptions, ServoTask, Target,
    VisionOptions,
};
use scopeservo_studies::page::{Page, Plot};
use scopeservo_studies::rounds::Outcome;
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;

/// What the paper's Table II gives as its range to either side, at 100x, 200x and 400x: kx and ky as a share, phi (deg), eta (mm).
const PAPER: [[f64; 3]; 3] = [[0.06, 8.9, 9.1], [0.06, 4.1, 4.4], [0.06, 1.9, 2.1]];
/// Errors of a calibration, in these ranges.
const STEPS: [f64; 7] = [-4.0, -2.0, -1.0, 0.0, 1.0, 2.0, 4.0];
/// Where runs begin, from the target: along x and y as shares of the shorter side of the field, and turned, deg.
const STARTS: [[f64; 3]; 2] = [[-0.25, 0.1, -3.0], [0.05, 0.25, 3.0]];
/// A run came back when the view's centre lies within so many px of the target's, and is turned by no more than this, deg.
const THERE_PX: f64 = 2.0;
const THERE_DEG: f64 = 0.05;

/// Two errors of a calibration that come together in one map: their names, and which of kx, ky, phi, eta x, eta y each of them is.
const MAPS: [(&str, &str, [usize; 2]); 3] = [
    ("kx", "ky", [0, 1]),
    ("phi", "eta 1", [2, 3]),
    ("eta 1", "eta 2", [3, 4]),
];

/// The cells of all objectives, or of one.
pub(crate) fn numbers(objective: Option<usize>) -> Vec<u64> {
    let each = (MAPS.len() * STEPS.len() * STEPS.len()) as u64;
    let of = |k: &u64| objective.is_none_or(|o| k / each == o as u64);
    (0..3 * each).filter(of).collect()
}

/// One wrong calibration, tried from every start.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Cell {
    pub(crate) index: u64,
    /// Of every start: how it ended, the iterations, and how far off it truly is, px and deg.
    pub(crate) runs: Vec<Run>,
}

/// One run.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Run {
    pub(crate) end: String,
    pub(crate) iterations: usize,
    pub(crate) off_px: f64,
    pub(crate) off_deg: f64,
}

impl Run {
    /// It says so, and is.
    fn came_back(&self) -> bool {
        self.end == "converged" && self.off_px <= THERE_PX && self.off_deg.abs() <= THERE_DEG
    }

    /// The worst of all: it says so, and is not.
    fn false_arrival(&self) -> bool {
        self.end == "converged" && !self.came_back()
    }
}

impl Cell {
    fn came_back(&self) -> usize {
        self.runs.iter().filter(|r| r.came_back()).count()
    }
}

/// Objective, map, and the two steps of a cell.
fn place(index: u64) -> (usize, usize, [usize; 2]) {
    let (n, k) = (STEPS.len(), index as usize);
    let (cell, rest) = (k % (n * n), k / (n * n));
    (rest / MAPS.len(), rest % MAPS.len(), [cell % n, cell / n])
}

/// Errors of kx, ky (shares), phi (deg), eta (mm) of a cell.
fn errors(index: u64) -> [f64; 5] {
    let (objective, map, steps) = place(index);
    let [k, phi, eta] = PAPER[objective];
    let ranges = [k, k, phi, eta, eta];
    let mut out = [0.0; 5];
    for (which, step) in MAPS[map].2.into_iter().zip(steps) {
        out[which] = STEPS[step] * ranges[which];
    }
    out
}

/// The true calibration, changed by so much.
fn wrong(bench: &Bench, [dkx, dky, dphi_deg, dx_mm, dy_mm]: [f64; 5]) -> Outcome<Calibration> {
    let objective = bench.scope.gate().objectives()[0].clone();
    let truth = bench.twin.true_calibration(&objective.id);
    let t = truth.ok_or("the twin has no such objective")?;
    let (s, c) = (t.phi_deg + dphi_deg).to_radians().sin_cos();
    let camera = Mat2::diagonal(1.0 / (t.kx * (1.0 + dkx)), 1.0 / (t.ky * (1.0 + dky)));
    let info = bench.scope.camera().info();
    Ok(Calibration {
        schema: CALIBRATION_SCHEMA,
        objective: objective.id,
        image_size_px: [info.width, info.height],
        stage_from_pixel: Mat2([[-s, -c], [-c, s]]) * camera,
        rotation_centre_m: Some([t.eta_mm[0] + dx_mm, t.eta_mm[1] + dy_mm].map(|v| v * 1e-3)),
        covariance: None,
        backlash: None,
        scatter: None,
    })
}

/// Runs from every start with the calibration of a cell.
pub(crate) fn tried(index: u64, specimens: &Specimens) -> Outcome<Cell> {
    let (objective, ..) = place(index);
    let design = Design::of_paper(objective as u64);
    let mut runs = Vec::new();
    for (k, start) in STARTS.iter().enumerate() {
        // The same places for every cell.
        let seed = (3 * k + objective) as u64;
        let bench = design.bench(seed, specimens)?;
        runs.push(run(&bench, errors(index), *start)?);
    }
    Ok(Cell { index, runs })
}

fn run(bench: &Bench, errors: [f64; 5], [x, y, turn_deg]: [f64; 3]) -> Outcome<Run> {
    // The paper's range is that of its law.
    let options = ServoOptions {
        law: Law::Proportional,
        ..ServoOptions::default()
    };
    let vision = VisionOptions::default();
    let target = Target::save(&bench.scope, &vision, &mut NoSink)?;
    let saved = bench.twin.truth_now();
    let calibration = wrong(bench, errors)?;
    let um_per_px = bench.scope.gate().objectives()[0].nominal_um_per_px;
    let side_um = um_per_px * calibration.image_size_px[1] as f64;
    let shift_um = [x * side_um, y * side_um];
    bench
        .twin
        .remount(saved.centre_um, shift_um, turn_deg, false);
    let task = ServoTask {
        target: &target,
        view_calibration: &calibration,
        target_calibration: &calibration,
        vision: &vision,
        options: &options,
        law: None,
        hand_overs: &[],
        localizer: None,
    };
    let mut servo = Servo::default();
    let ended = loop {
        match servo.step(&task, &bench.scope, &mut NoSink) {
            Ok(Progress::Continue) => {}
            Ok(Progress::Done(end)) => break Ok(end),
            Err(why) => break Err(why),
        }
    };
    let now = bench.twin.truth_now();
    let off_um = f64::hypot(
        now.centre_um[0] - saved.centre_um[0],
        now.centre_um[1] - saved.centre_um[1],
    );
    let [[a, _, _], [c, _, _]] = now.specimen_from_pixel;
    let [[a0, _, _], [c0, _, _]] = saved.specimen_from_pixel;
    let turned_rad = c.atan2(a) - c0.atan2(a0);
    let (end, iterations) = match &ended {
        Ok(end) => (
            end.word().to_owned(),
            end.result().map_or(0, |r| r.iterations),
        ),
        // A move that the stage's travel does not hold.
        Err(why) => (why.to_string(), 0),
    };
    Ok(Run {
        end,
        iterations,
        off_px: off_um / um_per_px,
        off_deg: turned_rad.sin().atan2(turned_rad.cos()).to_degrees(),
    })
}

const OBJECTIVES: [&str; 3] = ["10x (100x)", "20x (200x)", "40x (400x)"];

/// How often the calibrations within the paper's range came back, of how many runs; and false arrivals of all.
pub(crate) struct Summary {
    within: [(usize, usize); 3],
    false_arrivals: usize,
    runs: usize,
}

pub(crate) fn summary(cells: &[Cell]) -> Summary {
    let mut out = Summary {
        within: [(0, 0); 3],
        false_arrivals: 0,
        runs: 0,
    };
    for cell in cells {
        let (objective, _, steps) = place(cell.index);
        out.runs += cell.runs.len();
        out.false_arrivals += cell.runs.iter().filter(|r| r.false_arrival()).count();
        if steps.iter().all(|s| STEPS[*s].abs() <= 1.0) {
            out.within[objective].0 += cell.came_back();
            out.within[objective].1 += cell.runs.len();
        }
    }
    out
}

impl Summary {
    /// In lines for people.
    pub(crate) fn words(&self) -> String {
        let mut out = String::new();
        let all = OBJECTIVES.iter().zip(self.within);
        for (objective, (back, of)) in all.filter(|(_, (_, of))| *of > 0) {
            let _ = writeln!(
                out,
                "{objective}: within the paper's range {back} of {of} runs came back"
            );
        }
        let _ = write!(
            out,
            "false arrivals: {} of {} runs",
            self.false_arrivals, self.runs
        );
        out
    }

    /// Whether a run said that it arrived and had not.
    pub(crate) fn is_wrong(&self) -> bool {
        self.false_arrivals > 0
    }
}

/// Maps of all.
pub(crate) fn page(cells: &[Cell]) -> String {
    let mut page = Page::new("Convergence range");
    let ours = ServoOptions::default();
    page.text(&format!(
        "The true calibration of the paper's instrument, two of its numbers changed at a time; the servo then runs with the law of Eq. (22), lambda = {}, \
         from {} starts (a quarter of the field away, turned by up to 3 degrees) to a target of the same objective. A cell tells the iterations of the \
         slowest run where all came back, else how many of them did; green: all, yellow: some, red: none. Steps are 1, 2 and 4 times the range of the \
         paper's Table II, which is the dashed square.",
        ours.lambda,
        STARTS.len()
    ));
    page.text(&summary(cells).words().replace('\n', "; "));
    for (objective, name) in OBJECTIVES.iter().enumerate() {
        if cells.iter().all(|c| place(c.index).0 != objective) {
            continue;
        }
        page.heading(name);
        let plots = (0..MAPS.len()).map(|map| plot(cells, objective, map));
        page.plots(plots.collect());
    }
    page.finish()
}

fn plot(cells: &[Cell], objective: usize, map: usize) -> (Plot, String) {
    let n = STEPS.len() as f64;
    let (x_name, y_name, which) = MAPS[map];
    let unit = |k: usize| match k {
        0 | 1 => "%",
        2 => "deg",
        _ => "mm",
    };
    let axis = |name: &str, k: usize| format!("error of {name}, {}", unit(k));
    let mut plot = Plot::bare(
        [0.0, n],
        [0.0, n],
        &axis(x_name, which[0]),
        &axis(y_name, which[1]),
    );
    let [k, phi, eta] = PAPER[objective];
    let ranges = [100.0 * k, 100.0 * k, phi, eta, eta];
    for (s, step) in STEPS.iter().enumerate() {
        let label = |k: usize| format!("{:.0}", step * ranges[k]);
        plot.x_tick(s as f64 + 0.5, &label(which[0]));
        plot.y_tick(s as f64 + 0.5, &label(which[1]));
    }
    for cell in cells {
        let (o, m, [i, j]) = place(cell.index);
        if (o, m) != (objective, map) {
            continue;
        }
        let back = cell.came_back();
        let slowest = cell.runs.iter().map(|r| r.iterations).max().unwrap_or(0);
        let (fill, words) = match back {
            0 => ("#e8b4ab", "0".to_owned()),
            _ if back < cell.runs.len() => ("#f3dfa2", format!("{back}/{}", cell.runs.len())),
            _ => ("#b8dcc6", slowest.to_string()),
        };
        let at = |v: usize| [v as f64, v as f64 + 1.0];
        plot.cell(at(i), at(j), fill, &words);
    }
    plot.limit([2.0, 5.0], [2.0, 5.0]);
    let all = cells.iter().filter(|c| {
        let (o, m, _) = place(c.index);
        (o, m) == (objective, map)
    });
    let back = all
        .clone()
        .filter(|c| c.came_back() == c.runs.len())
        .count();
    let caption = format!(
        "{x_name} and {y_name}: {back} of {} cells come back from every start.",
        all.count()
    );
    (plot, caption)
}

/// A line for each run.
pub(crate) fn csv(cells: &[Cell]) -> String {
    let mut out = String::from(
        "cell,objective,dkx,dky,dphi_deg,deta1_mm,deta2_mm,start,end,iterations,off_px,off_deg\n",
    );
    for cell in cells {
        let (objective, ..) = place(cell.index);
        let errors = errors(cell.index).map(|v| v.to_string()).join(",");
        for (k, r) in cell.runs.iter().enumerate() {
            let _ = writeln!(
                out,
                "{},{},{errors},{k},\"{}\",{},{:.3},{:.4}",
                cell.index, OBJECTIVES[objective], r.end, r.iterations, r.off_px, r.off_deg
            );
        }
    }
    out
}
