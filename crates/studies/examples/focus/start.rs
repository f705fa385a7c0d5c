//! One start: a microscope, a specimen, a height, and what focus made of it. The truth only judges.

use crate::Outcome;
use clap::ValueEnum;
use scopeservo_geometry::SplitMix64;
use scopeservo_scope::{Axis, CancelToken, Clock, Frame, Instrument, StagePose, VirtualClock};
use scopeservo_servo::{
    Event, Focus, FocusOptions, FocusSweep, FrameRole, Measure, ServoError, Sink, Stamped,
    SweepEnd, run,
};
use scopeservo_twin::specimen::{FileSpecimen, Specimen, Tissue};
use scopeservo_twin::{Blank, Config, DustConfig, SpecimenEvent, Twin};
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

/// Slides, um per pixel, and what is left of their stain.
const SLIDES: [(&str, f64, f64); 6] = [
    ("carcinoma_he.png", 0.5, 1.0),
    ("embryo_section.png", 0.258, 1.0),
    ("liver_he.jpg", 0.49, 1.0),
    ("cytology_scanner_a.tif", 0.25, 1.0),
    ("liver_sirius_red.jpg", 0.49, 0.25),
    ("carcinoma_he.png", 0.5, 0.2),
];
/// Starts lie so far from the focus at most, um.
const WITHIN_UM: f64 = 200.0;
/// A place has enough to see when its true view varies by this share of its light.
const VARIES: f64 = 0.03;
/// So many arrivals tell their mean.
const ARRIVALS: u32 = 40;
const WAVELENGTH_UM: f64 = 0.55;

/// Hears the samples, and prints them where it is told to.
#[derive(Default)]
struct Trace {
    prints: bool,
    /// Time and height of each, s and um.
    seen: Vec<[f64; 2]>,
    swept: Option<FocusSweep>,
}

impl Trace {
    /// Frames and seconds of the coarse scan: the first looks, until one lies nearer than `near_um` to another.
    fn coarse(&self, near_um: f64) -> (usize, f64) {
        let near = |k: &usize| {
            let z = self.seen[*k][1];
            self.seen[..*k].iter().any(|s| (s[1] - z).abs() < near_um)
        };
        let count = (0..self.seen.len()).find(near).unwrap_or(self.seen.len());
        let ends = self.seen.first().zip(self.seen[..count].last());
        (count, ends.map_or(0.0, |(first, last)| last[0] - first[0]))
    }
}

impl Sink for Trace {
    fn event(&mut self, stamped: Stamped) {
        match stamped.event {
            Event::FocusSample { z_um, sharpness } => {
                self.seen.push([stamped.time_s, z_um]);
                if self.prints {
                    println!("{:.3} s, z {z_um:.2} um: {sharpness:.6}", stamped.time_s);
                }
            }
            Event::FocusSwept { sweep } => {
                if self.prints {
                    println!("{:.3} s, {sweep:?}", stamped.time_s);
                }
                self.swept = Some(sweep);
            }
            _ => {}
        }
    }
    fn frame(&mut self, _: &Frame, _: FrameRole) {}
}

/// What a start is spared, so that its share of the error shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Without {
    /// Arrivals that scatter, vibration, drift; backlash stays.
    Scatter,
    /// Shot and read noise.
    Noise,
}

/// What kind of starts.
#[derive(Debug, Clone, Default)]
pub(crate) struct Kind {
    /// On glass without a specimen.
    pub(crate) blank: bool,
    pub(crate) settle_s: Option<f64>,
    pub(crate) without: Vec<Without>,
}

/// What one start came to.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Record {
    pub(crate) index: u64,
    pub(crate) specimen: String,
    pub(crate) objective: String,
    /// Shot noise at mid grey over full scale.
    pub(crate) noise: f64,
    pub(crate) play_um: f64,
    /// Defocus at the beginning, um; positive: too close.
    pub(crate) start_um: f64,
    /// `focused`, or the error.
    pub(crate) answer: String,
    /// Defocus at the end, um.
    pub(crate) end_um: f64,
    /// The part of that by which this arrival at the height differs from the mean of many, um: the rest is the height's.
    pub(crate) arrival_um: f64,
    pub(crate) depth_um: f64,
    pub(crate) claimed_sigma_um: Option<f64>,
    pub(crate) frames: u64,
    pub(crate) moves: u64,
    pub(crate) seconds: f64,
    /// Of these the coarse scan's.
    pub(crate) coarse_frames: usize,
    pub(crate) coarse_seconds: f64,
    /// What came of a coarse scan in motion.
    #[serde(default)]
    pub(crate) swept: Option<SweepEnd>,
    /// A second focus, from some depths of field off: its defocus at the end and its frames.
    pub(crate) again: Option<(f64, u64)>,
}

impl Record {
    /// Whether the focus is right to a quarter of the depth of field.
    pub(crate) fn is_right(&self) -> bool {
        self.answer == "focused" && self.end_um.abs() <= 0.25 * self.depth_um
    }

    /// Whether a failure left the stage nearer to the specimen, or worse off. What backlash leaves is away from the specimen.
    pub(crate) fn is_harmed(&self) -> bool {
        self.answer != "focused" && self.end_um > self.start_um + 0.5
    }
}

pub(crate) struct Start {
    index: u64,
    specimen: String,
    twin: Twin,
    scope: Instrument,
    objective: usize,
    noise: f64,
    play_um: f64,
    start_um: f64,
    again_um: f64,
}

fn slide(kind: usize) -> Outcome<(String, Arc<dyn Specimen>, f64)> {
    let Some(folder) = std::env::var_os("SCOPESERVO_SPECIMENS") else {
        let seed = kind as u64;
        let faded = if kind >= 4 { 0.25 } else { 1.0 };
        return Ok((
            format!("tissue {seed} at {faded}"),
            Arc::new(Tissue::new(seed)),
            faded,
        ));
    };
    let (name, um_per_px, faded) = SLIDES[kind];
    let path = Path::new(&folder).join(name);
    let specimen = FileSpecimen::open(&path, Some(um_per_px))?;
    Ok((format!("{name} at {faded}"), Arc::new(specimen), faded))
}

/// A place on a slide of some millimetres.
fn place(rng: &mut SplitMix64, kind: usize) -> [f64; 2] {
    // The smallest slide is a millimetre wide.
    let half = if kind == 3 { 500.0 } else { 320.0 };
    [0, 1].map(|_| (2.0 * rng.uniform() - 1.0) * half)
}

impl Start {
    pub(crate) fn draw(index: u64, kind: &Kind) -> Outcome<Self> {
        let mut rng = SplitMix64::new(0x00F0_C005 ^ index.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let blank = kind.blank;
        let (objective, slide_of) = ((index % 3) as usize, (index / 3 % 6) as usize);
        let noise = 0.0025 * f64::powf(4.0, rng.uniform());
        let play_um = if rng.uniform() < 0.3 {
            0.0
        } else {
            8.0 * rng.uniform()
        };
        let start_um = (2.0 * rng.uniform() - 1.0) * WITHIN_UM;
        let mut config = Config::realistic();
        config.camera.full_well_e = 0.5 / (noise * noise);
        if kind.without.contains(&Without::Noise) {
            config.camera.shot_noise = false;
            config.camera.read_noise_e = 0.0;
        }
        if kind.without.contains(&Without::Scatter) {
            config.stage = config.stage.exact();
        }
        config.stage.settle_s = kind.settle_s.unwrap_or(config.stage.settle_s);
        for axis in &mut config.stage.axes {
            if axis.axis == Axis::Z {
                axis.backlash = play_um;
            }
        }
        let dusty = blank && index.is_multiple_of(2);
        if blank && !dusty {
            config.camera.dust.clear();
        }
        if dusty {
            config.camera.dust.push(DustConfig {
                specks: 60,
                radius_px: [2.0, 12.0],
                attenuation: [0.3, 0.9],
                steepness: [15, 60],
                ..DustConfig::default()
            });
        }
        let (specimen, over, faded): (String, Arc<dyn Specimen>, f64) = match blank {
            true => {
                let dust = if dusty { "glass with dust" } else { "glass" };
                (dust.into(), Arc::new(Blank), 1.0)
            }
            false => slide(slide_of)?,
        };
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
        let twin = Twin::new(config, over, index, clock)?;
        let scope = Instrument::new(twin.devices(), twin.rules(), CancelToken::new())?;
        let start = Self {
            index,
            specimen,
            twin,
            scope,
            objective,
            noise,
            play_um,
            start_um,
            again_um: rng.uniform() * 2.0 - 1.0,
        };
        start.prepare(&mut rng, slide_of, blank, faded)?;
        Ok(start)
    }

    /// Puts the objective in, finds a place with something to see, fades the stain and leaves the focus.
    fn prepare(&self, rng: &mut SplitMix64, kind: usize, blank: bool, faded: f64) -> Outcome<()> {
        let objective = self.scope.gate().objectives()[self.objective].clone();
        self.scope.select_objective(&objective.id)?;
        for _ in 0..40 {
            self.twin.centre_specimen(place(rng, kind), 0.0);
            self.go_to_defocus(0.0)?;
            if blank {
                break;
            }
            let light = self.scope.grab()?.luminance();
            let n = light.len() as f64;
            let mean = light.iter().map(|v| f64::from(*v)).sum::<f64>() / n;
            let spread = light
                .iter()
                .map(|v| (f64::from(*v) - mean).powi(2))
                .sum::<f64>()
                / n;
            if spread.sqrt() - self.noise > VARIES * mean {
                break;
            }
        }
        if faded < 1.0 {
            self.twin.inject(SpecimenEvent::Bleach { factor: faded });
        }
        self.go_to_defocus(self.start_um)
    }

    /// Moves z until the truth says so.
    fn go_to_defocus(&self, defocus_um: f64) -> Outcome<()> {
        for _ in 0..3 {
            let off = defocus_um - self.twin.truth_now().defocus_um;
            let z = self.scope.gate().position()?.si(Axis::Z).ok_or("no z")?;
            let to = StagePose::default().with_si(Axis::Z, z + off * 1e-6);
            self.scope.move_to(&to)?;
        }
        Ok(())
    }

    /// Mean defocus of many arrivals at the present height from the side away from the specimen, um; the drift of that time taken off.
    fn mean_of_arrivals(&self) -> Outcome<f64> {
        let z = self.scope.gate().position()?.si(Axis::Z).ok_or("no z")?;
        let begun = self.scope.clock().now();
        let rate = self.twin.config().stage.drift_um_per_s[2];
        let mut sum = 0.0;
        for _ in 0..ARRIVALS {
            for away_um in [20.0, 0.0] {
                let si = self.scope.gate().info().positive_z.away(z, away_um * 1e-6);
                self.scope
                    .move_to(&StagePose::default().with_si(Axis::Z, si))?;
            }
            let passed = self.scope.clock().now().since(begun).as_secs_f64();
            sum += self.twin.truth_now().defocus_um - rate * passed;
        }
        Ok(sum / f64::from(ARRIVALS))
    }

    /// `trace`: prints each sample.
    pub(crate) fn run(self, measure: Measure, sweep: bool, trace: bool) -> Outcome<Record> {
        let objective = self.scope.gate().objectives()[self.objective].clone();
        let depth_um = WAVELENGTH_UM / objective.numerical_aperture.powi(2);
        let options = FocusOptions {
            measure,
            // A sweep must reach beyond a focus at the end of its range.
            half_range_um: 1.15 * WITHIN_UM,
            nearest_um: 1.15 * WITHIN_UM,
            sweep,
            ..FocusOptions::default()
        };
        let focus = || {
            let before = self.scope.counters();
            let mut focus = Focus::new(objective.clone(), options.clone());
            let mut sink = Trace {
                prints: trace,
                ..Trace::default()
            };
            let answer = run(&mut focus, &self.scope, &mut sink);
            let after = self.scope.counters();
            (
                answer,
                after.frames - before.frames,
                after.moves - before.moves,
                sink.coarse(8.0 * depth_um),
                sink.swept.map(|s| s.end),
            )
        };
        let start_um = self.twin.truth_now().defocus_um;
        let begun = self.scope.clock().now();
        let (answer, frames, moves, (coarse_frames, coarse_seconds), swept) = focus();
        let seconds = self.scope.clock().now().since(begun).as_secs_f64();
        let end_um = self.twin.truth_now().defocus_um;
        let claimed_sigma_um = answer.as_ref().ok().and_then(|r| r.sigma_um);
        let told = match answer {
            Ok(_) => "focused".into(),
            Err(ServoError::NoFocus { .. }) => "no_focus".into(),
            Err(ServoError::FocusAtLimit { .. }) => "at_limit".into(),
            Err(other) => other.to_string(),
        };
        let arrival_um = match told.as_str() {
            "focused" => end_um - self.mean_of_arrivals()?,
            _ => 0.0,
        };
        let again = match told.as_str() {
            "focused" => {
                self.go_to_defocus(end_um + 3.0 * self.again_um * depth_um)?;
                let (answer, frames, ..) = focus();
                answer
                    .is_ok()
                    .then(|| (self.twin.truth_now().defocus_um, frames))
            }
            _ => None,
        };
        Ok(Record {
            index: self.index,
            specimen: self.specimen.clone(),
            objective: objective.id.0.clone(),
            noise: self.noise,
            play_um: self.play_um,
            start_um,
            answer: told,
            end_um,
            arrival_um,
            depth_um,
            claimed_sigma_um,
            frames,
            moves,
            seconds,
            coarse_frames,
            coarse_seconds,
            swept,
            again,
        })
    }
}
