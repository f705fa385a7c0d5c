//! The report of a calibration, of one that succeeds and of every way to fail.

mod common;

use common::{code, describe, json, ok, scopeservo, stderr};
use scopeservo_report::{Context, Failure, Recorder, Work, WorkEnd, work_html};
use scopeservo_scope::{
    Axis, CancelToken, Clock, Frame, Instrument, Motion, Objective, ScopeError, Stage, StageInfo,
    StagePose, VirtualClock,
};
use scopeservo_servo::{
    Calibrate, CalibrateOptions, Calibration, Event, FrameRole, ServoError, Sink, Stamped,
    VisionOptions, agree, joint::PathOptions, run,
};
use scopeservo_twin::specimen::{Blank, Specimen, Tissue};
use scopeservo_twin::{Config, StageConfig, StageFault, Twin};
use std::path::Path;
use std::sync::{Arc, Mutex};

const STAGE: &str = "stage = \"xy\"\nobjectives = [\"20x\"]\n";

fn page(at: &Path) -> String {
    std::fs::read_to_string(at).unwrap()
}

/// The pages of all runs, the oldest first.
fn pages_of_runs(here: &Path) -> Vec<String> {
    let list = ok(here, &["run", "list", "--json"]);
    let runs = list["runs"].as_array().unwrap().iter().rev();
    let runs = runs.filter(|run| run["report"] == true);
    runs.map(|run| {
        let id = run["id"].as_str().unwrap();
        let file = format!("{id}.html");
        ok(here, &["run", "show", id, "--report", &file, "--json"]);
        page(&here.join(file))
    })
    .collect()
}

#[test]
fn a_user_gets_a_page_with_what_was_measured_and_what_changed() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, STAGE);
    let calibrate = ["calibrate", "--no-focus", "--json", "--out", "first"];
    let made = ok(here, &calibrate);
    let first = page(&here.join("first/report.html"));
    assert!(first.contains("<h1>Calibrated</h1>"));
    assert!(first.contains("simulated microscope"));
    assert!(first.contains("None of this objective was kept before"));
    let um_per_px = made["calibrations"][0]["calibration"]["um_per_px"].as_f64();
    let pixel = format!("20x: a pixel is {:.4} µm", um_per_px.unwrap());
    assert!(first.contains(&pixel), "{pixel}");
    for part in [
        "skew",
        "Arrivals scatter",
        "Backlash:",
        "Predicted arrival error of one move of 100 µm:",
        "aria-label=\"Places of the calibration views of 20x\"",
        "The farthest view of the cross",
        "Home again",
    ] {
        assert!(first.contains(part), "{part}");
    }
    assert_eq!(pages_of_runs(here), [first]);
    let result: serde_json::Value =
        serde_json::from_str(&page(&here.join("first/result.json"))).unwrap();
    assert_eq!(result["calibrations"], made["calibrations"]);
    ok(
        here,
        &["calibrate", "--no-focus", "--json", "--out", "second"],
    );
    let second = page(&here.join("second/report.html"));
    let told = second.contains("nothing changed for sure") || second.contains("class=\"sure\"");
    assert!(told && second.contains("size of a pixel"));
}

#[test]
fn a_user_whose_slide_is_blank_gets_a_page_that_says_so_and_shows_it() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, &format!("{STAGE}made.blank = {{}}\n"));
    let failed = scopeservo(
        here,
        &["calibrate", "--no-focus", "--json", "--out", "glass"],
    );
    assert_eq!(code(&failed), 3, "{}", stderr(&failed));
    let glass = page(&here.join("glass/report.html"));
    assert!(glass.contains("<h1>Not calibrated</h1>"));
    // The twin's dust is all there is to see, and it stays where it is.
    assert!(glass.contains("all that is seen is on the camera"));
    let message = json(&failed)["error"]["message"].to_string();
    assert!(message.contains("all that is seen is on the camera"));
    assert!(glass.contains("The last view") && glass.contains("data:image/jpeg"));
    assert!(
        glass.contains("not recognised in view 1"),
        "what it should overlap"
    );
    assert_eq!(pages_of_runs(here), [glass]);
}

#[test]
fn a_focus_leaves_its_page_with_the_run() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, "objectives = [\"20x\"]\n");
    ok(here, &["focus", "--json"]);
    let pages = pages_of_runs(here);
    assert!(pages[0].contains("<h1>In focus</h1>") && pages[0].contains("Sharpness against"));
}

type Wires = fn(StagePose) -> StagePose;

/// A stage whose axes are wired otherwise than it says.
struct Wired {
    real: Box<dyn Stage>,
    info: StageInfo,
    wires: Wires,
    told: Mutex<StagePose>,
}

impl Stage for Wired {
    fn info(&self) -> &StageInfo {
        &self.info
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        Ok(*self.told.lock().unwrap())
    }
    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        let mut told = self.told.lock().unwrap();
        *told = to.or(&told);
        self.real.start_move(&(self.wires)(*told))
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        self.real.poll()
    }
    fn stop(&self) -> Result<(), ScopeError> {
        self.real.stop()
    }
}

/// Records, and does something to the microscope after a view.
struct Watched<'a> {
    recorder: Recorder,
    twin: &'a Twin,
    after: usize,
    what: &'a dyn Fn(&Twin),
}

impl Sink for Watched<'_> {
    fn event(&mut self, stamped: Stamped) {
        if let Event::CalibrationView { index, .. } = stamped.event
            && index == self.after
        {
            (self.what)(self.twin);
        }
        self.recorder.event(stamped);
    }
    fn frame(&mut self, frame: &Frame, role: FrameRole) {
        self.recorder.frame(frame, role);
    }
}

fn short_path() -> CalibrateOptions {
    CalibrateOptions {
        path: PathOptions {
            most_views: 20,
            ..PathOptions::default()
        },
        ..CalibrateOptions::default()
    }
}

fn as_it_says(pose: StagePose) -> StagePose {
    pose
}

/// A case: the wires of the stage, the specimen, the settings, the factor of what is engraved, whether the window was cleaned of dust, and what happens after a view.
struct Case<'a> {
    wires: Wires,
    specimen: Arc<dyn Specimen>,
    options: CalibrateOptions,
    engraved: f64,
    clean: bool,
    what: (usize, &'a dyn Fn(&Twin)),
}

impl Default for Case<'_> {
    fn default() -> Self {
        Self {
            wires: as_it_says,
            specimen: Arc::new(Tissue::new(5)),
            options: short_path(),
            engraved: 1.0,
            clean: false,
            what: (0, &|_| {}),
        }
    }
}

/// What came of it, and the recorder.
fn calibrated(case: Case<'_>) -> (Result<Calibration, ServoError>, Recorder, Vec<Objective>) {
    let mut config = Config::realistic().with_stage(StageConfig::xyz_theta());
    config.optics.truncate(1);
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
    let twin = Twin::new(config, case.specimen, 5, clock).unwrap();
    let mut devices = twin.devices();
    let real = twin.stage();
    devices.stage = Some(Box::new(Wired {
        info: real.info().clone(),
        told: Mutex::new(real.position().unwrap()),
        real,
        wires: case.wires,
    }));
    let scope = Instrument::new(devices, twin.rules(), CancelToken::new()).unwrap();
    let objectives = scope.gate().objectives().to_vec();
    let mut objective = objectives[0].clone();
    objective.nominal_um_per_px *= case.engraved;
    let mut calibrate = Calibrate::new(objective, case.options, VisionOptions::default());
    let mut watched = Watched {
        recorder: Recorder::new(),
        twin: &twin,
        after: case.what.0,
        what: case.what.1,
    };
    watched.recorder.keep_calibration_views();
    let phase = Event::PhaseStarted {
        phase: scopeservo_servo::Phase::Calibrate,
        objective: objectives[0].id.clone(),
    };
    watched.event(Stamped {
        time_s: 0.0,
        event: phase,
    });
    if case.clean {
        twin.clean_window();
    }
    let ended = run(&mut calibrate, &scope, &mut watched);
    (ended, watched.recorder, objectives)
}

fn page_of(recorder: &Recorder, error: &ServoError) -> String {
    let end = WorkEnd {
        work: Work::Calibration,
        failed: Some(Failure {
            message: error.to_string(),
            stopped: false,
        }),
        before: Vec::new(),
    };
    work_html(recorder, &end, &Context::default())
}

/// The page of a case that fails.
fn failed(case: Case<'_>) -> (ServoError, String) {
    let (ended, recorder, _) = calibrated(case);
    let error = ended.expect_err("it fails");
    let page = page_of(&recorder, &error);
    assert!(page.contains("<h1>Not calibrated</h1>"), "{error}");
    (error, page)
}

#[test]
fn every_way_to_fail_is_shown_with_the_views_and_their_matches() {
    let swapped: Wires = |p| {
        let (x, y) = (p.si(Axis::X).unwrap(), p.si(Axis::Y).unwrap());
        p.with_si(Axis::X, y).with_si(Axis::Y, x)
    };
    let both_x: Wires = |p| {
        let sum = p.si(Axis::X).unwrap() + p.si(Axis::Y).unwrap();
        p.with_si(Axis::X, sum).with_si(Axis::Y, 0.0)
    };
    let stuck = |twin: &Twin| {
        let axis = Axis::X;
        twin.fault(StageFault::StuckAxis { axis, stuck: true });
    };
    let mut far = short_path();
    far.path.first_share = 7.2;
    let cases: [(&str, Case<'_>, &[&str]); 7] = [
        (
            "blank field",
            Case {
                specimen: Arc::new(Blank),
                clean: true,
                ..Case::default()
            },
            &["The last view", "not recognised in view 1"],
        ),
        (
            "too little overlap",
            Case {
                options: far,
                ..Case::default()
            },
            &[
                "The last view",
                "after the first 0 were recognised",
                "no earlier view was expected to overlap it",
            ],
        ),
        (
            "an axis that stands",
            Case {
                what: (0, &stuck),
                ..Case::default()
            },
            // Both look the same: every place is where it was.
            &["not recognised in view 1", "alike places"],
        ),
        (
            "the wrong axis",
            Case {
                wires: both_x,
                ..Case::default()
            },
            &["The last view", "agree in view"],
        ),
        (
            "mirrored against the rotation",
            Case {
                wires: swapped,
                ..Case::default()
            },
            &[
                "turned wider",
                "aria-label=\"Places of the calibration views",
            ],
        ),
        (
            "far from what is engraved",
            Case {
                engraved: 1.4,
                ..Case::default()
            },
            &[
                "The last view",
                "aria-label=\"Places of the calibration views",
            ],
        ),
        (
            "the light goes off",
            Case {
                what: (7, &|twin| drop(twin.light().set_level(0.0))),
                ..Case::default()
            },
            &["The last image of all", "The last view"],
        ),
    ];
    let expected: [fn(&ServoError) -> bool; 7] = [
        |e| matches!(e, ServoError::BlankView { .. }),
        |e| matches!(e, ServoError::CalibrationViews { .. }),
        |e| matches!(e, ServoError::AxisStands { .. }),
        |e| matches!(e, ServoError::AxesAlike { .. }),
        // Which of the two it is takes two views that turned.
        |e| {
            matches!(
                e,
                ServoError::AxesContradict { .. } | ServoError::ViewAstray { .. }
            )
        },
        |e| matches!(e, ServoError::CalibrationImplausible { .. }),
        |e| matches!(e, ServoError::WentDark { .. }),
    ];
    for ((name, case, words), is) in cases.into_iter().zip(expected) {
        let (error, page) = failed(case);
        if let Some(folder) = std::env::var_os("SCOPESERVO_PAGES") {
            let file = Path::new(&folder).join(format!("{}.html", name.replace(' ', "-")));
            std::fs::write(file, &page).unwrap();
        }
        assert!(is(&error), "{name}: {error}");
        for word in words {
            assert!(page.contains(word), "{name}: {word} is not in the page");
        }
        assert!(page.contains("data:image/jpeg"), "{name}: no image");
    }
}

#[test]
fn objectives_that_disagree_are_shown_beside_each_other() {
    let (made, mut recorder, mut objectives) = calibrated(Case::default());
    let made = made.unwrap();
    let mut other = made.clone();
    other.objective.0 = "20x".into();
    other.rotation_centre_m = other.rotation_centre_m.map(|[x, y]| [x + 0.02, y]);
    for row in &mut other.stage_from_pixel.0 {
        *row = row.map(|v| 0.5 * v);
    }
    let mut twenty = objectives[0].clone();
    twenty.id = other.objective.clone();
    twenty.magnification *= 2.0;
    objectives.push(twenty);
    let error = agree(&objectives, &[&made], &other).unwrap_err();
    recorder.event(Stamped {
        time_s: 100.0,
        event: Event::Calibrated {
            calibration: Box::new(other),
            residual_px: 0.1,
            views: 20,
        },
    });
    let page = page_of(&recorder, &error);
    assert!(page.contains("<h1>Not calibrated</h1>") && page.contains("Beside each other"));
    let [x, _] = made.rotation_centre_m.unwrap();
    for x in [x, x + 0.02] {
        assert!(page.contains(&format!("<td>{:.3}, ", 1e3 * x)), "{x}");
    }
}

#[test]
fn what_is_shown_of_a_chain_is_what_the_stage_did() {
    let (made, recorder, _) = calibrated(Case::default());
    let scatter_m = made.unwrap().scatter.unwrap();
    let of = recorder.events().iter().find_map(|e| match &e.event {
        Event::ChainEnded { places, pairs, .. } => Some((places, pairs)),
        _ => None,
    });
    let (places, pairs) = of.expect("it is told");
    let last = places.len() - 1;
    // It began and ended at one place; the cross reaches 0.8 mm, and turned views lie on it.
    let far = |k: usize| f64::hypot(places[k].at_m[0], places[k].at_m[1]);
    assert!(far(0) == 0.0 && far(last) < 1e-9, "{}", far(last));
    let farthest = (0..=last).map(far).fold(0.0, f64::max);
    assert!((farthest - 0.8e-3).abs() < 1e-6, "{farthest}");
    // Arrows are what the stage scatters, and every pair is of views that are there.
    let off: Vec<f64> = places
        .iter()
        .filter_map(|p| p.off_m)
        .map(|[x, y]| x * x + y * y)
        .collect();
    assert_eq!(off.len(), places.len());
    let rms = (off.iter().sum::<f64>() / off.len() as f64).sqrt();
    let along = f64::hypot(scatter_m[0], scatter_m[1]);
    let most = along.hypot(0.126 * scatter_m[2]);
    assert!(
        rms > 0.4 * along && rms < 1.5 * most,
        "{rms} {along} {most}"
    );
    assert!(pairs.iter().all(|[a, b]| a < b && *b <= last) && pairs.len() > last);
}
