//! Made-up runs with made-up images: what a report is tested and shown with where no microscope is.

#![allow(dead_code, reason = "each user of this module needs a part of it")]

use scopeservo_geometry::{Affine2, Mat2};
use scopeservo_report::{Context, Convergence, Recorder, TrueCalibration, TrueIteration, Truth};
use scopeservo_scope::{
    Angle, Channels, Frame, Length, ObjectiveId, Samples, StagePose, Timestamp,
};
use scopeservo_servo::{
    CALIBRATION_SCHEMA, Calibration, Event, FocusResult, FrameRole, LocatedBy, MagnificationResult,
    Outcome, Phase, Reason, ServoEnd, ServoResult, Sink, Stamped, Verdict, control_law, pose_error,
};
use std::time::Duration;

pub(crate) const WIDTH: usize = 640;
pub(crate) const HEIGHT: usize = 480;
const CENTRE: [f64; 2] = [319.5, 239.5];
/// Name, kx, ky (px/m), phi (deg): the paper's Table II.
const OBJECTIVES: [(&str, f64, f64, f64); 3] = [
    ("100x", -448_672.0, -451_767.0, 0.4665),
    ("200x", -938_325.0, -942_616.0, 0.3868),
    ("400x", -1_953_155.0, -1_981_235.0, 0.5722),
];

fn hash(x: i64, y: i64, salt: u64) -> f64 {
    let mut h = (x as u64)
        .wrapping_mul(0x9e37_79b9_7f4a_7c15)
        .wrapping_add((y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f))
        .wrapping_add(salt.wrapping_mul(0x1656_67b1_9e37_79f9));
    h ^= h >> 31;
    h = h.wrapping_mul(0xbf58_476d_1ce4_e5b9);
    h ^= h >> 29;
    h = h.wrapping_mul(0x94d0_49bb_1331_11eb);
    h ^= h >> 32;
    (h >> 11) as f64 / (1u64 << 53) as f64
}

fn noise(x: f64, y: f64, salt: u64) -> f64 {
    let (i, j) = (x.floor(), y.floor());
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (u, v) = (smooth(x - i), smooth(y - j));
    let h = |a: f64, b: f64| hash(a as i64, b as i64, salt);
    let top = h(i, j) * (1.0 - u) + h(i + 1.0, j) * u;
    let bottom = h(i, j + 1.0) * (1.0 - u) + h(i + 1.0, j + 1.0) * u;
    top * (1.0 - v) + bottom * v
}

/// Something like stained tissue at a place of the specimen, um.
fn tissue(x: f64, y: f64, detail_um: f64) -> [f64; 3] {
    let bend = 14.0 * noise(x / 60.0, y / 60.0, 1);
    let fibre = noise((x + bend) / 7.0, (y + 2.0 * bend) / 28.0, 2);
    let cloud = noise(x / 45.0, y / 45.0, 3);
    let gap = ((noise(x / 80.0, y / 80.0, 9) - 0.62) * 9.0).clamp(0.0, 1.0);
    let mut c = [
        0.93 - 0.16 * fibre - 0.06 * cloud,
        0.70 - 0.26 * fibre - 0.14 * cloud,
        0.84 - 0.14 * fibre - 0.05 * cloud,
    ];
    c = [0, 1, 2].map(|k| c[k] * (1.0 - gap) + [0.96, 0.95, 0.96][k] * gap);
    let (gi, gj) = ((x / 9.0).floor() as i64, (y / 9.0).floor() as i64);
    for j in gj - 1..=gj + 1 {
        for i in gi - 1..=gi + 1 {
            if hash(i, j, 4) < 0.35 || gap > 0.6 {
                continue;
            }
            let cx = (i as f64 + hash(i, j, 5)) * 9.0;
            let cy = (j as f64 + hash(i, j, 6)) * 9.0;
            let (dx, dy) = (x - cx, y - cy);
            if dx * dx + dy * dy > 36.0 {
                continue;
            }
            let (sin, cos) = (6.3 * hash(i, j, 7)).sin_cos();
            let r = 2.0 + 1.6 * hash(i, j, 8);
            let d = f64::hypot((dx * cos + dy * sin) / 1.4, dy * cos - dx * sin) / r;
            let inside = ((1.0 - d) * r / detail_um.max(0.3) + 0.5).clamp(0.0, 1.0) * 0.85;
            let grain = 0.16 * noise(x * 1.3, y * 1.3, 10);
            c = [0, 1, 2].map(|k| c[k] * (1.0 - inside) + ([0.36, 0.22, 0.52][k] + grain) * inside);
        }
    }
    c
}

/// Where a camera stands: its centre on the specimen (um, along the target's columns and rows) and its turn.
#[derive(Clone, Copy)]
struct Stand {
    x_um: f64,
    y_um: f64,
    theta: f64,
}

pub(crate) fn frame(sequence: u64, at: [f64; 3], um_per_px: f64, blank: bool) -> Frame {
    let (sin, cos) = at[2].sin_cos();
    let mut rgb = Vec::with_capacity(WIDTH * HEIGHT * 3);
    for row in 0..HEIGHT {
        for column in 0..WIDTH {
            let (px, py) = (column as f64 - CENTRE[0], row as f64 - CENTRE[1]);
            let x = at[0] + um_per_px * (cos * px - sin * py);
            let y = at[1] + um_per_px * (sin * px + cos * py);
            let c = if blank {
                [0.93 + 0.01 * noise(x / 300.0, y / 300.0, 1); 3]
            } else {
                tissue(x, y, um_per_px)
            };
            let grain = 0.02 * (hash(column as i64, row as i64, sequence) - 0.5);
            rgb.extend(c.map(|v| ((v + grain).clamp(0.0, 1.0) * 255.0) as u8));
        }
    }
    Frame {
        width: WIDTH,
        height: HEIGHT,
        channels: Channels::Rgb,
        bit_depth: 8,
        samples: Samples::U8(rgb),
        sequence,
        exposure_start: Timestamp::default(),
        exposure: Duration::from_millis(10),
    }
}

fn calibration(k: usize, off: f64) -> Calibration {
    let (name, kx, ky, phi) = OBJECTIVES[k];
    let (s, c) = phi.to_radians().sin_cos();
    let r_ec = Mat2([[-s, -c], [-c, s]]);
    let map = r_ec * Mat2::diagonal((1.0 + 6e-4 * off) / kx, (1.0 - 4e-4 * off) / ky);
    let spread = 5e-4 * map.frobenius();
    let mut covariance = [[0.0; 6]; 6];
    for (i, row) in covariance.iter_mut().enumerate() {
        row[i] = if i < 4 { spread * spread } else { 4e-8 };
    }
    Calibration {
        schema: CALIBRATION_SCHEMA,
        objective: ObjectiveId(name.into()),
        image_size_px: [WIDTH, HEIGHT],
        stage_from_pixel: map,
        rotation_centre_m: Some([0.125_403 + 1e-4 * off, 0.000_066]),
        covariance: Some(covariance),
        backlash: None,
        scatter: None,
    }
}

/// Tells a run to a recorder while it makes it up.
pub(crate) struct Teller {
    pub(crate) recorder: Recorder,
    time_s: f64,
    sequence: u64,
    results: Vec<MagnificationResult>,
    pub(crate) truth: Truth,
}

impl Teller {
    pub(crate) fn new() -> Self {
        Self {
            recorder: Recorder::new(),
            time_s: 3.0,
            sequence: 10,
            results: Vec::new(),
            truth: Truth {
                error_um: 0.381,
                error_deg: 0.0024,
                ..Truth::default()
            },
        }
    }

    pub(crate) fn tell(&mut self, after_s: f64, event: Event) {
        self.time_s += after_s;
        let time_s = self.time_s;
        self.recorder.event(Stamped { time_s, event });
    }

    pub(crate) fn grab(
        &mut self,
        role: FrameRole,
        objective: &str,
        at: [f64; 3],
        um: f64,
        blank: bool,
    ) -> u64 {
        self.sequence += 1;
        self.recorder
            .frame(&frame(self.sequence, at, um, blank), role);
        let event = Event::FrameGrabbed {
            sequence: self.sequence,
            role,
            objective: ObjectiveId(objective.into()),
            exposure_start_s: None,
            exposure_s: None,
            stage: None,
        };
        self.tell(0.03, event);
        self.sequence
    }

    pub(crate) fn start(&mut self) {
        self.grab(FrameRole::Target, "400x", [0.0; 3], 0.5084, false);
        let ids = OBJECTIVES.map(|o| ObjectiveId(o.0.into()));
        self.tell(
            2.0,
            Event::Started {
                target_objective: ids[2].clone(),
                objectives: ids.into(),
                engine: "scopeservo-sift 0.1.0".into(),
                cpu_level: "x86-64-v3".into(),
            },
        );
    }

    pub(crate) fn phase(&mut self, phase: Phase, objective: &str) {
        let objective = ObjectiveId(objective.into());
        self.tell(0.01, Event::PhaseStarted { phase, objective });
    }

    pub(crate) fn focus(&mut self, k: usize, blank: bool) {
        let name = OBJECTIVES[k].0;
        self.phase(Phase::Switch, name);
        self.time_s += 2.4;
        self.phase(Phase::Focus, name);
        let best = 3.2 + k as f64;
        let width = [16.0, 8.0, 4.0][k];
        let coarse = (0..17).map(|i| -40.0 + 5.0 * f64::from(i));
        let fine = (0..13).map(|i| best - 6.0 + f64::from(i));
        let sample = |z: f64| 0.004 + 0.021 / (1.0 + ((z - best) / width).powi(2));
        let plan: Vec<f64> = if blank {
            coarse.collect()
        } else {
            coarse.chain(fine).collect()
        };
        let samples = plan.len();
        for (i, z) in plan.into_iter().enumerate() {
            if blank && i % 6 == 0 {
                self.grab(FrameRole::Focus, name, [40.0, 0.0, 0.0], 0.5, blank);
            }
            let sharpness = if blank {
                0.0041 + 2e-5 * hash(i as i64, 0, 1)
            } else {
                sample(z)
            };
            self.tell(0.12, Event::FocusSample { z_um: z, sharpness });
        }
        if !blank {
            let result = FocusResult {
                z_um: Some(best),
                sigma_um: Some(0.05),
                sharpness: sample(best),
                contrast: sample(best) / sample(-40.0),
                samples,
            };
            let objective = ObjectiveId(name.into());
            self.tell(0.1, Event::Focused { objective, result });
        }
    }

    pub(crate) fn calibrate(&mut self, k: usize) {
        let name = OBJECTIVES[k].0;
        self.phase(Phase::Calibrate, name);
        for index in 0..14usize {
            let angle = index as f64 * std::f64::consts::TAU / 8.0;
            let r = if index < 8 { 168.0 } else { 60.0 };
            let shift = [r * angle.cos() + 4.0, r * angle.sin() * 0.98];
            let event = Event::CalibrationView {
                index,
                stage: StagePose::default(),
                shift_px: (index != 11).then_some(shift),
                inliers: 240,
                chain: None,
            };
            self.tell(0.5, event);
        }
        self.tell(
            0.2,
            Event::Calibrated {
                calibration: Box::new(calibration(k, 1.0)),
                residual_px: 0.118,
                views: 13,
            },
        );
    }

    pub(crate) fn servo(&mut self, k: usize, from: [f64; 3]) {
        let view = calibration(k, 1.0);
        let target = calibration(2, 1.0);
        let name = OBJECTIVES[k].0;
        self.phase(Phase::Servo, name);
        let um = view.um_per_px();
        let um_t = target.um_per_px();
        let mut at = Stand {
            x_um: from[0],
            y_um: from[1],
            theta: from[2],
        };
        let mut passed = 0;
        let mut iteration = 0;
        loop {
            let stand = [at.x_um, at.y_um, at.theta];
            let sequence = self.grab(FrameRole::Servo, name, stand, um, false);
            let jitter = |salt| (hash(sequence as i64, k as i64, salt) - 0.5) * 0.5 * um;
            let turned = Mat2::rotation(at.theta) * (um / um_t);
            let about_centres = Affine2 {
                linear: turned,
                offset: [(at.x_um + jitter(1)) / um_t, (at.y_um + jitter(2)) / um_t],
            };
            let back = CENTRE.map(|c| -c);
            let target_from_view = about_centres.recentred(back, back);
            let error = pose_error(&target_from_view, &view, &target, CENTRE, CENTRE).unwrap();
            let velocity = control_law(&error, 0.2);
            let converged = error.distance_um() <= 0.8 * um;
            passed = if converged { passed + 1 } else { 0 };
            let pairs = pairs(&target_from_view, 60 + 120 * k);
            self.truth.iterations.push(TrueIteration {
                sequence,
                error_um: at.x_um.hypot(at.y_um),
                error_deg: at.theta.to_degrees(),
                x_um: at.x_um,
                y_um: at.y_um,
            });
            let stage = StagePose {
                x: Some(Length::from_um(at.y_um)),
                y: Some(Length::from_um(at.x_um)),
                rz: Some(Angle::from_rad(at.theta)),
                ..StagePose::default()
            };
            let event = Event::Iteration {
                objective: view.objective.clone(),
                iteration,
                sequence,
                stage,
                error,
                velocity,
                target_from_view,
                by: LocatedBy::default(),
                inliers: pairs.len(),
                matches: pairs.len() + 40,
                sigma_px: 0.12 * um / um_t,
                pairs,
                converged,
                pixels: None,
                promised: None,
            };
            self.tell(0.28, event);
            iteration += 1;
            if passed == 2 {
                let result = ServoResult {
                    limited_by: None,
                    angle_is_left: false,
                    iterations: iteration,
                    inliers: 240,
                    error,
                    sigma_um: 0.12 * um,
                    sigma_deg: 0.002,
                };
                self.results.push(MagnificationResult {
                    objective: view.objective.clone(),
                    magnification: f64::from([100, 200, 400][k]),
                    end: ServoEnd::Converged(result),
                    calibration: view,
                });
                return;
            }
            if !converged {
                at.x_um = at.x_um * 0.8 + 0.06 * um * (hash(iteration as i64, 3, 3) - 0.5);
                at.y_um = at.y_um * 0.8 + 0.06 * um * (hash(iteration as i64, 4, 4) - 0.5);
                at.theta *= 0.8;
            }
        }
    }

    pub(crate) fn lose(&mut self, k: usize) {
        let name = OBJECTIVES[k].0;
        self.phase(Phase::Servo, name);
        for iteration in 0..3 {
            let sequence = self.grab(FrameRole::Servo, name, [2000.0, 500.0, 0.1], 2.2, false);
            // The reason's type is another crate's; its stored form is public.
            let event = serde_json::json!({
                "event": "lost", "objective": name, "iteration": iteration, "sequence": sequence,
                "reason": {"code": "by_chance", "inliers": 6, "matches": 41, "log10_nfa": 1.3},
            });
            self.tell(0.3, serde_json::from_value(event).unwrap());
        }
    }

    pub(crate) fn finish(&mut self, verdict: Verdict, reason: Reason, message: &str) {
        let last = self.results.last().and_then(|m| match &m.end {
            ServoEnd::Converged(r) if verdict == Verdict::Arrived => Some(r.clone()),
            _ => None,
        });
        if let Some(t) = self.truth.iterations.last() {
            (self.truth.error_um, self.truth.error_deg) = (t.error_um, t.error_deg);
        }
        let message = last.as_ref().map_or(message.to_string(), |r| {
            format!(
                "the saved view is back, {:.2} um and {:.4} deg off by its own measurement",
                r.error.distance_um(),
                r.error.angle_deg()
            )
        });
        let outcome = Outcome {
            verdict,
            reason,
            message,
            estimated_error_um: last
                .as_ref()
                .map(|r| r.error.distance_um().hypot(r.sigma_um)),
            limited_by: None,
            angle_left_deg: None,
            in_view: None,
            missing: None,
            estimated_error_deg: last.as_ref().map(|r| r.error.angle_deg().abs()),
            remarks: Vec::new(),
            unique_within_um: None,
            magnifications: self.results.clone(),
        };
        self.tell(0.05, Event::Finished { outcome });
    }
}

/// Places that fall into both images.
fn pairs(target_from_view: &Affine2, wanted: usize) -> Vec<[f32; 4]> {
    let back = target_from_view.inverse().unwrap();
    (0..)
        .map(|i| [hash(i, 0, 21) * 639.0, hash(i, 0, 22) * 479.0])
        .take(4 * wanted)
        .map(|t| (t, back.apply(t)))
        .filter(|(_, v)| (0.0..639.0).contains(&v[0]) && (0.0..479.0).contains(&v[1]))
        .take(wanted)
        .map(|(t, v)| [v[0] as f32, v[1] as f32, t[0] as f32, t[1] as f32])
        .collect()
}

/// A run over three magnifications that arrives.
pub(crate) fn arrived() -> Teller {
    let mut t = Teller::new();
    t.start();
    t.focus(2, false);
    t.calibrate(2);
    for (k, from) in [
        [318.0, -204.0, 0.105],
        [-9.0, 12.5, 0.009],
        [4.6, -3.1, -0.0016],
    ]
    .into_iter()
    .enumerate()
    {
        t.focus(k, false);
        t.calibrate(k);
        t.servo(k, from);
    }
    t.finish(Verdict::Arrived, Reason::Converged, "");
    t.truth.calibrations = OBJECTIVES
        .iter()
        .map(|o| TrueCalibration {
            objective: o.0.into(),
            kx_px_per_m: o.1,
            ky_px_per_m: o.2,
            phi_deg: o.3,
            eta_mm: [125.4031, 0.0663],
        })
        .collect();
    t
}

/// A run in which the target is nowhere to be seen.
pub(crate) fn not_found() -> Teller {
    let mut t = Teller::new();
    t.start();
    t.focus(2, false);
    t.calibrate(2);
    t.focus(0, false);
    t.calibrate(0);
    t.lose(0);
    t.finish(
        Verdict::NotFound,
        Reason::TargetNotInView,
        "the saved view was not found at 100x: 6 inliers among 41 matches could be chance. Bring the specimen so \
         that the place lies in the field at the lowest magnification, and try again",
    );
    t
}

/// A run over blank glass.
pub(crate) fn no_focus() -> Teller {
    let mut t = Teller::new();
    t.start();
    t.focus(2, true);
    t.finish(
        Verdict::Refused,
        Reason::NoFocus,
        "no focus found with 400x: sharpness varies by a factor of 1.01 over -40 to 40 um, as over blank glass. Move to a \
         place with tissue, or nearer to focus, and try again",
    );
    t
}

/// What is said beside a run.
pub(crate) fn context() -> Context {
    Context {
        date: "2026-11-27 09:30 UTC".into(),
        target: "mitosis-3".into(),
        stored: Vec::new(),
        title: "Back to the saved view".into(),
        specimen: "made-up tissue".into(),
        instrument: "simulated six-axis stage, 640 x 480 camera, 100x to 400x".into(),
        command: "scopeservo demo --seed 7 --report run.html".into(),
        seed: Some(7),
        version: "scopeservo 0.1.0".into(),
        simulated: true,
        virtual_time: true,
        wall_time_s: Some(21.4),
        credit: None,
        convergence: Some(Convergence {
            position_px: 0.8,
            angle_deg: 0.01,
        }),
    }
}
