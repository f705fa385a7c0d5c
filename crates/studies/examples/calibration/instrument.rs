//! The instruments of a study: the paper's, and others of every kind.

use crate::specimens::{GRID_PITCHES_UM, Specimens};
use scopeservo_geometry::{Mat2, SplitMix64};
use scopeservo_scope::{Axis, CancelToken, Clock, Instrument, StagePose, VirtualClock};
use scopeservo_servo::Calibration;
use scopeservo_studies::rounds::Outcome;
use scopeservo_twin::{Config, StageConfig, Twin};
use std::collections::BTreeSet;
use std::sync::Arc;

/// An instrument at a place, with the objective that is to be calibrated.
pub(crate) struct Bench {
    pub(crate) twin: Twin,
    pub(crate) scope: Instrument,
    skew: f64,
}

/// What an instrument is made of, in words and as the twin has it.
pub(crate) struct Design {
    pub(crate) words: String,
    pub(crate) config: Config,
    pub(crate) objective: usize,
    pub(crate) play_um: f64,
}

/// Of an instrument: stage, play, scatter, angle of the camera, mirrored, skew, aspect of a pixel, objective.
type Choice = [usize; 8];
/// How many there are of each.
const CHOICES: Choice = [4, 4, 4, 5, 2, 2, 2, 3];
/// Instruments among which the next is chosen.
const CANDIDATES: usize = 200;

/// Instruments of which any two properties come together in one at least, greedily: always the one that has most pairs which are new.
pub(crate) fn pairwise() -> Vec<Choice> {
    let pairs = |choice: &Choice| -> Vec<[usize; 4]> {
        let choice = *choice;
        let of = |a: usize| (0..a).map(move |b| [a, choice[a], b, choice[b]]);
        (0..CHOICES.len()).flat_map(of).collect()
    };
    let mut left: BTreeSet<[usize; 4]> = BTreeSet::new();
    for (a, of_a) in CHOICES.into_iter().enumerate() {
        for (b, of_b) in CHOICES.into_iter().enumerate().take(a) {
            left.extend((0..of_a).flat_map(|p| (0..of_b).map(move |q| [a, p, b, q])));
        }
    }
    let mut rng = SplitMix64::new(0x9A125);
    let mut chosen = Vec::new();
    while !left.is_empty() {
        let candidates = (0..CANDIDATES).map(|_| CHOICES.map(|of| rng.below(of)));
        let new = |c: &Choice| pairs(c).iter().filter(|p| left.contains(*p)).count();
        // The first of the best, so that the order does not matter.
        let best = candidates.reduce(|best, c| if new(&c) > new(&best) { c } else { best });
        let Some(best) = best.filter(|c| new(c) > 0) else {
            continue;
        };
        for pair in pairs(&best) {
            left.remove(&pair);
        }
        chosen.push(best);
    }
    chosen
}

impl Design {
    /// The paper's instrument, with its three objectives by turns.
    pub(crate) fn of_paper(index: u64) -> Self {
        Self {
            words: "as in the paper".into(),
            config: Config::realistic(),
            objective: (index % 3) as usize,
            play_um: 0.0,
        }
    }

    /// Any mounting, stage, play and scatter.
    pub(crate) fn any(index: u64) -> Self {
        let mut rng = SplitMix64::new(0xCA11 + index);
        let choice = CHOICES.map(|of| rng.below(of));
        Self::of(choice, 360.0 * rng.uniform())
    }

    /// One of instruments of which any two properties come together in one at least: the number of all is [`pairwise`]'s, and more come
    /// round again with other angles.
    pub(crate) fn of_pairs(index: u64) -> Self {
        let all = pairwise();
        let angle_deg = 360.0 * SplitMix64::new(0xA4 + index).uniform();
        Self::of(all[index as usize % all.len()], angle_deg)
    }

    fn of(choice: Choice, angle_deg: f64) -> Self {
        let [
            stage,
            play,
            scatter,
            turned,
            mirrored,
            skew,
            stretch,
            objective,
        ] = choice;
        let stage = match stage {
            0 => StageConfig::hexapod(),
            1 => StageConfig::xyz_theta(),
            2 => StageConfig::xyz(),
            _ => StageConfig::xy(),
        };
        let play_um = [0.0, 2.0, 5.0, 20.0][play];
        let scatter_um = [0.15, 0.5, 1.5, 5.0][scatter];
        let mirrored = mirrored == 1;
        let skew = [0.0, 0.005][skew];
        let stretch = [1.0, 1.005][stretch];
        let mut config = Config::realistic().with_stage(stage);
        config.mount.phi_deg = [0.0, 90.0, 180.0, -90.0]
            .get(turned)
            .map_or(angle_deg, |a| *a);
        (config.mount.mirrored, config.mount.skew) = (mirrored, skew);
        for optics in &mut config.optics {
            optics.ky_px_per_m *= stretch;
        }
        for axis in &mut config.stage.axes {
            match axis.axis {
                Axis::X | Axis::Y => {
                    (axis.backlash, axis.repeatability) = (play_um, scatter_um);
                }
                // The same at a lever of 100 mm.
                Axis::Rz => {
                    (axis.backlash, axis.repeatability) = (10.0 * play_um, 10.0 * scatter_um)
                }
                _ => {}
            }
        }
        Self {
            words: format!(
                "{}, play {play_um} um, repeatability {scatter_um} um, {:.0} deg{}",
                config.stage.name,
                config.mount.phi_deg,
                if mirrored { ", mirrored" } else { "" }
            ),
            config,
            objective,
            play_um,
        }
    }

    /// The pitch of a grid that this objective shows well, um.
    pub(crate) fn pitch_um(&self) -> f64 {
        GRID_PITCHES_UM[self.objective]
    }

    /// Over one of the specimens, in focus.
    pub(crate) fn bench(&self, seed: u64, specimens: &Specimens) -> Outcome<Bench> {
        let mut config = self.config.clone();
        let optics = config.optics[self.objective].clone();
        config.optics = vec![optics];
        let skew = config.mount.skew;
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
        let (specimen, half_um) = specimens.of(seed, self.objective);
        let twin = Twin::new(config, specimen, seed, clock)?;
        let scope = Instrument::new(twin.devices(), twin.rules(), CancelToken::new())?;
        let mut rng = SplitMix64::new(seed);
        let mut within = |half: f64| half * (2.0 * rng.uniform() - 1.0);
        twin.centre_specimen([within(half_um), within(half_um)], within(180.0));
        let bench = Bench { twin, scope, skew };
        bench.focus()?;
        Ok(bench)
    }
}

impl Bench {
    /// By the truth: the focus has a study of its own.
    fn focus(&self) -> Outcome<()> {
        let gate = self.scope.gate();
        let Some(z) = gate.position()?.si(Axis::Z) else {
            return Ok(());
        };
        let defocus = self.twin.truth_now().defocus_um * 1e-6;
        self.scope
            .move_to(&StagePose::default().with_si(Axis::Z, z - defocus))?;
        Ok(())
    }

    /// The true map, m per px row by row, and the true rotation centre, m.
    pub(crate) fn truth(&self, made: &Calibration) -> Outcome<[f64; 6]> {
        let truth = self.twin.true_calibration(&made.objective);
        let t = truth.ok_or("the twin has no such objective")?;
        let (s, c) = t.phi_deg.to_radians().sin_cos();
        let camera = Mat2([[1.0 / t.kx, -self.skew / t.kx], [0.0, 1.0 / t.ky]]);
        let Mat2([[a, b], [d, e]]) = Mat2([[-s, -c], [-c, s]]) * camera;
        let [x, y] = t.eta_mm.map(|v| v * 1e-3);
        Ok([a, b, d, e, x, y])
    }
}
