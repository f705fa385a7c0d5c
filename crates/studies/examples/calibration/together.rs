//! Three objectives of one microscope: where they look beside each other, by each one's calibration and by all of them together.

use crate::specimens::Specimens;
use crate::table::mean;
use scopeservo_geometry::SplitMix64;
use scopeservo_scope::{
    Axis, CancelToken, Clock, Instrument, ObjectiveId, StagePose, VirtualClock,
};
use scopeservo_servo::{
    Calibrate, CalibrateOptions, Calibration, NoSink, VisionOptions, one_microscope, run,
};
use scopeservo_studies::rounds::Outcome;
use scopeservo_twin::{Config, Twin};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What came of three objectives.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Round {
    pub(crate) index: u64,
    /// Why there is no answer.
    refused: Option<String>,
    /// Of each two objectives and each axis: how far their centres' difference is off, and what it is uncertain by, um.
    alone: Vec<[f64; 2]>,
    together: Vec<[f64; 2]>,
    linked: usize,
    chi_sq: f64,
    freedom: usize,
}

/// The stage of a study.
#[derive(Clone, Copy)]
pub(crate) struct Stage {
    pub(crate) play_um: f64,
    /// `None`: the paper's.
    pub(crate) scatter_um: Option<f64>,
}

/// Three objectives calibrated one after the other, in focus.
pub(crate) fn tried(index: u64, stage: Stage, specimens: &Specimens) -> Outcome<Round> {
    let mut config = Config::realistic();
    // The truth is the middle of all arrivals: let there be no other.
    config.nosepiece.repeatability_um = 0.0;
    for axis in &mut config.stage.axes {
        let lever = match axis.axis {
            Axis::X | Axis::Y => 1.0,
            // The same at a lever of 100 mm.
            Axis::Rz => 10.0,
            _ => continue,
        };
        axis.backlash = lever * stage.play_um;
        if let Some(scatter_um) = stage.scatter_um {
            axis.repeatability = lever * scatter_um;
        }
    }
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
    let (specimen, half_um) = specimens.of(3 * index, 0);
    let seed = 0x3B0 + index;
    let twin = Twin::new(config, specimen, seed, clock)?;
    let scope = Instrument::new(twin.devices(), twin.rules(), CancelToken::new())?;
    let mut rng = SplitMix64::new(seed);
    let mut within = |half: f64| half * (2.0 * rng.uniform() - 1.0);
    twin.centre_specimen([within(half_um), within(half_um)], within(180.0));
    let mut round = Round {
        index,
        refused: None,
        alone: Vec::new(),
        together: Vec::new(),
        linked: 0,
        chi_sq: 0.0,
        freedom: 0,
    };
    if let Err(why) = round.fill(&twin, &scope) {
        round.refused = Some(why.to_string());
    }
    Ok(round)
}

impl Round {
    fn fill(&mut self, twin: &Twin, scope: &Instrument) -> Outcome<()> {
        let vision = VisionOptions::default();
        let (mut made, mut alone) = (Vec::<Calibration>::new(), Vec::new());
        for objective in scope.gate().objectives() {
            scope.select_objective(&objective.id)?;
            focus(twin, scope)?;
            let options = CalibrateOptions::default();
            let mut calibrate = Calibrate::new(objective.clone(), options, vision.clone());
            let calibration = run(&mut calibrate, scope, &mut NoSink)?;
            alone.extend(calibrate.alone(&calibration));
            made.push(calibration);
        }
        let mut truth = Vec::new();
        for calibration in &made {
            let own = twin.true_calibration(&calibration.objective);
            truth.push(
                own.ok_or("the twin has no such objective")?
                    .eta_mm
                    .map(|v| 1e3 * v),
            );
        }
        let kinematics = scope.gate().info().kinematics;
        let set = one_microscope(&alone, kinematics, &vision).ok_or("they are too few")?;
        let set = set.map_err(|why| why.to_string())?;
        for beside in &set.parcentric {
            let of = |id: &ObjectiveId| made.iter().position(|c| c.objective == *id);
            let (a, b) = of(&beside.from)
                .zip(of(&beside.to))
                .ok_or("an unknown objective")?;
            for k in 0..2 {
                let truly = truth[b][k] - truth[a][k];
                let [x, y] = [a, b].map(|o| made[o].rotation_centre_m.unwrap_or_default()[k]);
                let variance = |o: usize| made[o].covariance.map_or(0.0, |c| c[4 + k][4 + k]);
                let sigma = 1e6 * (variance(a) + variance(b)).sqrt();
                self.alone.push([1e6 * (y - x) - truly, sigma]);
                let one = beside.offset_um[k];
                self.together.push([one.value - truly, one.sigma]);
            }
        }
        (self.linked, self.chi_sq, self.freedom) = (set.linked, set.chi_sq, set.freedom);
        Ok(())
    }
}

/// By the truth: the focus has a study of its own.
fn focus(twin: &Twin, scope: &Instrument) -> Outcome<()> {
    if let Some(z) = scope.gate().position()?.si(Axis::Z) {
        let defocus = twin.truth_now().defocus_um * 1e-6;
        scope.move_to(&StagePose::default().with_si(Axis::Z, z - defocus))?;
    }
    Ok(())
}

/// The table; whether anything is wrong.
pub(crate) fn told(rounds: &[Round]) -> bool {
    println!(
        "| centres beside each other | rounds | numbers | rms off um | stated sd um | 95 % hold the truth |"
    );
    println!("|---|---|---|---|---|---|");
    let good: Vec<&Round> = rounds.iter().filter(|r| r.refused.is_none()).collect();
    type Of = fn(&Round) -> &Vec<[f64; 2]>;
    let ways: [(&str, Of); 2] = [("alone", |r| &r.alone), ("together", |r| &r.together)];
    for (name, of) in ways {
        let all: Vec<[f64; 2]> = good.iter().flat_map(|r| of(r).clone()).collect();
        let rms = |k: usize| mean(all.iter().map(|v| v[k] * v[k])).sqrt();
        let held = all
            .iter()
            .map(|[off, sigma]| f64::from(u8::from(off.abs() < 1.96 * sigma)));
        println!(
            "| {name} | {} | {} | {:.3} | {:.3} | {:.1} |",
            good.len(),
            all.len(),
            rms(0),
            rms(1),
            100.0 * mean(held)
        );
    }
    let of_freedom = good.iter().map(|r| r.chi_sq / r.freedom.max(1) as f64);
    println!(
        "\n{} of {} pairs were seen in each other; chi-square over its freedom {:.2}",
        good.iter().map(|r| r.linked).sum::<usize>(),
        3 * good.len(),
        mean(of_freedom)
    );
    for r in rounds {
        if let Some(why) = &r.refused {
            println!("refused {}: {why}", r.index);
        }
    }
    good.len() < rounds.len()
}
