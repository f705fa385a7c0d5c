//! The nosepiece as a function of time, and the offsets of its objectives.

use crate::config::NosepieceConfig;
use crate::seeds;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use scopeservo_scope::{Motion, ScopeError};
use std::f64::consts::TAU;

/// Where an objective looks and focuses, relative to a perfect one.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Offset {
    /// Shift of the view in the end-effector frame, um.
    pub(crate) centre_um: [f64; 2],
    /// Height of the focus above the stage's start, towards the specimen, um.
    pub(crate) focus_um: f64,
}

/// The fixed offsets of each objective, drawn once.
pub(crate) fn fixed_offsets(config: &NosepieceConfig, count: usize, seed: u64) -> Vec<Offset> {
    let mut rng = seeds::rng(seed, seeds::NOSEPIECE, 0);
    (0..count)
        .map(|_| {
            let radius = config.parcentric_um * rng.random::<f64>().sqrt();
            let angle = rng.random::<f64>() * TAU;
            Offset {
                centre_um: [radius * angle.cos(), radius * angle.sin()],
                focus_um: config.parfocal_um * rng.random_range(-1.0..1.0),
            }
        })
        .collect()
}

#[derive(Debug, Clone, Copy)]
struct Change {
    start: f64,
    end: f64,
    to: usize,
    /// Scatter of this arrival, on top of the fixed offset.
    scatter: Offset,
    ended: Motion,
}

/// Which objective is where, over time.
pub(crate) struct NosepieceState {
    config: NosepieceConfig,
    changes: Vec<Change>,
    rng: Pcg64Mcg,
    /// What is in the beam, whatever it says.
    in_beam: Option<usize>,
}

impl NosepieceState {
    pub(crate) fn new(config: NosepieceConfig, seed: u64, now: f64) -> Self {
        Self {
            config,
            changes: vec![Change {
                start: now,
                end: now,
                to: 0,
                scatter: Offset::default(),
                ended: Motion::Settled,
            }],
            rng: seeds::rng(seed, seeds::NOSEPIECE, 1),
            in_beam: None,
        }
    }

    fn last(&self) -> &Change {
        // There is always one: the start.
        &self.changes[self.changes.len() - 1]
    }

    fn change_at(&self, t: f64) -> &Change {
        let begun = self.changes.iter().rev().find(|c| c.start <= t);
        begun.unwrap_or(&self.changes[0])
    }

    /// The objective in the beam, or the one that comes next, its scatter, and whether light passes.
    pub(crate) fn at(&self, t: f64) -> (usize, Offset, bool) {
        let change = self.change_at(t);
        let lit = t >= change.end && change.ended == Motion::Settled;
        (self.in_beam.unwrap_or(change.to), change.scatter, lit)
    }

    /// Another objective is in the beam than is told.
    pub(crate) fn put_in_beam(&mut self, index: Option<usize>) {
        self.in_beam = index;
    }

    /// What it says.
    pub(crate) fn current(&self, now: f64) -> Option<usize> {
        let (_, _, lit) = self.at(now);
        lit.then_some(self.change_at(now).to)
    }

    pub(crate) fn motion(&self, now: f64) -> Motion {
        if now < self.last().end {
            Motion::Moving
        } else {
            self.last().ended
        }
    }

    pub(crate) fn start_change(&mut self, to: usize, now: f64) -> Result<(), ScopeError> {
        if self.motion(now) == Motion::Moving {
            return Err(ScopeError::Busy {
                device: "nosepiece",
            });
        }
        if self.current(now) == Some(to) {
            return Ok(());
        }
        let mut draw = || self.rng.random_range(-1.0..1.0);
        let unit: [f64; 3] = [draw(), draw(), draw()];
        let scatter = Offset {
            centre_um: [
                self.config.repeatability_um * unit[0],
                self.config.repeatability_um * unit[1],
            ],
            focus_um: self.config.focus_repeatability_um * unit[2],
        };
        self.push(Change {
            start: now,
            end: now + self.config.change_s,
            to,
            scatter,
            ended: Motion::Settled,
        });
        Ok(())
    }

    /// Stops between two objectives.
    pub(crate) fn stop(&mut self, now: f64) {
        if self.motion(now) == Motion::Moving {
            let last = *self.last();
            self.push(Change {
                start: now,
                end: now,
                ended: Motion::Stopped,
                ..last
            });
        }
    }

    fn push(&mut self, change: Change) {
        // Changes take seconds, exposures at most one: eight are history enough.
        if self.changes.len() > 8 {
            self.changes.remove(0);
        }
        self.changes.push(change);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state() -> NosepieceState {
        NosepieceState::new(NosepieceConfig::default(), 7, 0.0)
    }

    #[test]
    fn offsets_differ_and_stay_inside_their_bounds() {
        let config = NosepieceConfig::default();
        let all = fixed_offsets(&config, 200, 3);
        for o in &all {
            assert!(o.centre_um[0].hypot(o.centre_um[1]) <= 15.0 && o.focus_um.abs() <= 15.0);
        }
        assert!(all.iter().any(|o| o.focus_um > 10.0) && all.iter().any(|o| o.focus_um < -10.0));
        assert_ne!(all[0], all[1]);
        assert_eq!(all, fixed_offsets(&config, 200, 3));
        assert_ne!(all, fixed_offsets(&config, 200, 4));
    }

    #[test]
    fn a_change_takes_two_dark_seconds_and_scatters_anew() {
        let mut n = state();
        n.start_change(2, 1.0).unwrap();
        assert_eq!(n.current(0.5), Some(0));
        assert_eq!(n.current(2.9), None);
        assert_eq!(n.motion(2.9), Motion::Moving);
        assert!(n.start_change(1, 2.9).is_err());
        assert_eq!(n.current(3.0), Some(2));
        let first = n.at(3.0).1;
        n.start_change(0, 4.0).unwrap();
        n.start_change(2, 7.0).unwrap();
        let second = n.at(9.5).1;
        assert_ne!(first, second);
        for s in [first, second] {
            assert!(s.centre_um.iter().all(|v| v.abs() <= 2.0) && s.centre_um[0] != 0.0);
        }
    }

    #[test]
    fn what_is_in_the_beam_may_be_another_than_is_said() {
        let mut n = state();
        n.put_in_beam(Some(2));
        assert_eq!((n.current(0.0), n.at(0.0).0), (Some(0), 2));
        n.start_change(1, 0.0).unwrap();
        assert_eq!((n.current(2.0), n.at(2.0).0), (Some(1), 2));
        n.put_in_beam(None);
        assert_eq!((n.current(2.0), n.at(2.0).0), (Some(1), 1));
    }

    #[test]
    fn stopped_between_objectives_nothing_is_in_the_beam() {
        let mut n = state();
        n.start_change(1, 0.0).unwrap();
        n.stop(1.0);
        assert_eq!(n.motion(1.0), Motion::Stopped);
        assert_eq!(n.current(9.0), None);
        n.start_change(1, 9.0).unwrap();
        assert_eq!(n.current(11.0), Some(1));
    }
}
