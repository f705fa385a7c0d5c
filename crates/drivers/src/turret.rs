//! A nosepiece on one more axis of a controller.
//!
//! An axis that does not know where it is finds its reference as part of the first change: then the motion gate has seen that the
//! objectives are out of the way, and somebody has asked for a change. Nothing turns on connecting.

use crate::session::{bad_setting, lock};
use scopeservo_scope::{Immersion, KnownBy, Motion, Nosepiece, Objective, ObjectiveId, ScopeError};
use serde::Deserialize;
use std::collections::HashSet;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

/// An objective and where the axis stands for it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TurretPlace {
    /// Its name.
    pub id: String,
    /// Total magnification; orders the objectives.
    pub magnification: f64,
    /// Numerical aperture.
    pub numerical_aperture: f64,
    /// Nominal size of a camera pixel on the specimen.
    pub um_per_px: f64,
    /// What it works in; air when left out.
    #[serde(default)]
    pub immersion: Immersion,
    /// Where the axis stands.
    pub at_deg: f64,
}

impl TurretPlace {
    fn objective(&self) -> Objective {
        Objective {
            id: ObjectiveId(self.id.clone()),
            magnification: self.magnification,
            numerical_aperture: self.numerical_aperture,
            nominal_um_per_px: self.um_per_px,
            immersion: self.immersion,
        }
    }
}

/// What an axis of a controller belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Part {
    Stage,
    Nosepiece,
}

/// The objectives of a nosepiece, checked: at least two, of different names and places that `tolerance_deg` tells apart.
pub(crate) fn check(places: &[TurretPlace], tolerance_deg: f64) -> Result<(), ScopeError> {
    if places.len() < 2 {
        return Err(bad_setting(
            "a nosepiece has at least two objectives: for a single one say nosepiece = \"none\"",
        ));
    }
    let names: HashSet<&str> = places.iter().map(|p| p.id.as_str()).collect();
    if names.len() != places.len() || names.contains("") {
        return Err(bad_setting(
            "every objective of the nosepiece needs a name of its own",
        ));
    }
    for place in places {
        place.objective().check()?;
    }
    if !(tolerance_deg.is_finite() && tolerance_deg > 0.0) {
        return Err(bad_setting("arrival_tolerance_deg must be above 0"));
    }
    let mut angles: Vec<f64> = places.iter().map(|p| p.at_deg).collect();
    angles.sort_by(f64::total_cmp);
    let apart = |pair: &[f64]| pair[1] - pair[0] > 2.0 * tolerance_deg;
    if !angles.iter().all(|a| a.is_finite()) || !angles.windows(2).all(apart) {
        return Err(bad_setting(
            "the places of the objectives must be farther apart than twice arrival_tolerance_deg",
        ));
    }
    Ok(())
}

/// What a controller does with the axis of a nosepiece. It is used while its stage stands, and its stage while this stands.
pub(crate) trait Turns: Send + Sync {
    /// Whether the axis knows where it is.
    fn is_homed(&self) -> Result<bool, ScopeError>;
    /// Starts to find its reference, over its whole travel perhaps.
    fn start_homing(&self) -> Result<(), ScopeError>;
    /// Where it stands.
    fn place_deg(&self) -> Result<f64, ScopeError>;
    /// Starts to turn.
    fn start_turn(&self, to_deg: f64) -> Result<(), ScopeError>;
    /// What it does.
    fn poll_turn(&self) -> Result<Motion, ScopeError>;
    /// Stops it at once.
    fn stop_turn(&self) -> Result<(), ScopeError>;
    /// It was stopped on the way: where it is, is not known any more, unless the controller measures it.
    fn invalidate_position(&self);
}

/// A nosepiece that a controller turns.
pub struct Turret {
    axis: Arc<dyn Turns>,
    objectives: Vec<Objective>,
    places_deg: Vec<f64>,
    tolerance_deg: f64,
    doing: Mutex<Doing>,
    stops: AtomicU64,
    known_by: KnownBy,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Doing {
    Nothing,
    /// Finding its reference, to go on to an objective unless it is stopped.
    Finding {
        then: usize,
        stops: u64,
    },
    Turning,
    Stopped,
}

impl Turret {
    /// On an axis, for settings that were [`check`]ed. `zero_is_given`: it has no switch that tells where it is.
    pub(crate) fn new(
        axis: Arc<dyn Turns>,
        places: &[TurretPlace],
        tolerance_deg: f64,
        zero_is_given: bool,
    ) -> Self {
        Self {
            axis,
            objectives: places.iter().map(TurretPlace::objective).collect(),
            places_deg: places.iter().map(|p| p.at_deg).collect(),
            tolerance_deg,
            doing: Mutex::new(Doing::Nothing),
            stops: AtomicU64::new(0),
            known_by: match zero_is_given {
                true => KnownBy::Count,
                false => KnownBy::Sensor,
            },
        }
    }

    /// Turns to an objective.
    fn turn(&self, doing: &mut Doing, to: usize, stops: u64) -> Result<(), ScopeError> {
        let begin = || self.axis.start_turn(self.places_deg[to]);
        self.begin(doing, Doing::Turning, stops, begin)
    }

    /// Begins something, unless somebody has stopped it since `stops`. What fails to begin, or is stopped meanwhile, is stopped.
    fn begin(
        &self,
        doing: &mut Doing,
        what: Doing,
        stops: u64,
        begin: impl FnOnce() -> Result<(), ScopeError>,
    ) -> Result<(), ScopeError> {
        let stopped = || self.stops.load(Ordering::SeqCst) != stops;
        *doing = Doing::Stopped;
        if stopped() {
            return Ok(());
        }
        let begun = begin();
        if begun.is_err() || stopped() {
            // Its own fault is the news.
            let halted = self.axis.stop_turn();
            return begun.and(halted);
        }
        *doing = what;
        Ok(())
    }
}

impl Nosepiece for Turret {
    fn objectives(&self) -> &[Objective] {
        &self.objectives
    }

    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        if *lock(&self.doing) != Doing::Nothing || !self.axis.is_homed()? {
            return Ok(None);
        }
        let here = self.axis.place_deg()?;
        let near = |at: &f64| (at - here).abs() <= self.tolerance_deg;
        let found = self.places_deg.iter().position(near);
        Ok(found.map(|at| self.objectives[at].id.clone()))
    }

    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        let stops = self.stops.load(Ordering::SeqCst);
        let found = self.objectives.iter().position(|o| o.id == *to);
        let Some(index) = found else {
            let names: Vec<&str> = self.objectives.iter().map(|o| o.id.0.as_str()).collect();
            return Err(ScopeError::NoSuchObjective {
                asked: to.clone(),
                available: names.join(", "),
            });
        };
        if self.poll()? == Motion::Moving {
            return Err(ScopeError::Busy {
                device: "nosepiece",
            });
        }
        let mut doing = lock(&self.doing);
        if self.axis.is_homed()? {
            return self.turn(&mut doing, index, stops);
        }
        let finding = Doing::Finding { then: index, stops };
        self.begin(&mut doing, finding, stops, || self.axis.start_homing())
    }

    fn poll(&self) -> Result<Motion, ScopeError> {
        let mut doing = lock(&self.doing);
        let now = match *doing {
            Doing::Nothing => return Ok(Motion::Settled),
            Doing::Stopped => return Ok(Motion::Stopped),
            Doing::Finding { .. } | Doing::Turning => self.axis.poll_turn()?,
        };
        match (now, *doing) {
            (Motion::Moving, _) => {}
            (Motion::Stopped, _) => *doing = Doing::Stopped,
            (Motion::Settled, Doing::Finding { then, stops }) => {
                self.turn(&mut doing, then, stops)?;
            }
            (Motion::Settled, _) => *doing = Doing::Nothing,
        }
        Ok(match *doing {
            Doing::Nothing => Motion::Settled,
            Doing::Stopped => Motion::Stopped,
            Doing::Finding { .. } | Doing::Turning => Motion::Moving,
        })
    }

    fn stop(&self) -> Result<(), ScopeError> {
        // Counted first: what is about to go on sees it, or has begun and is stopped here.
        self.stops.fetch_add(1, Ordering::SeqCst);
        self.axis.stop_turn()?;
        let mut doing = lock(&self.doing);
        if *doing != Doing::Nothing {
            *doing = Doing::Stopped;
            // A stepper may have run on uncounted.
            self.axis.invalidate_position();
        }
        Ok(())
    }

    fn known_by(&self) -> KnownBy {
        self.known_by
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An axis that moves when it is told to.
    #[derive(Default)]
    struct Axis {
        state: Mutex<State>,
    }

    #[derive(Default)]
    struct State {
        at_deg: f64,
        goal_deg: Option<f64>,
        known: bool,
        finding: bool,
        stopped: bool,
        log: Vec<String>,
    }

    impl Axis {
        fn arrive(&self) {
            let mut state = lock(&self.state);
            if state.finding {
                (state.finding, state.known, state.at_deg) = (false, true, 0.0);
            }
            if let Some(goal) = state.goal_deg.take() {
                state.at_deg = goal;
            }
        }
        fn log(&self) -> Vec<String> {
            lock(&self.state).log.clone()
        }
    }

    impl Turns for Axis {
        fn is_homed(&self) -> Result<bool, ScopeError> {
            Ok(lock(&self.state).known)
        }
        fn start_homing(&self) -> Result<(), ScopeError> {
            let mut state = lock(&self.state);
            (state.finding, state.stopped) = (true, false);
            state.log.push("find".into());
            Ok(())
        }
        fn place_deg(&self) -> Result<f64, ScopeError> {
            Ok(lock(&self.state).at_deg)
        }
        fn start_turn(&self, to_deg: f64) -> Result<(), ScopeError> {
            let mut state = lock(&self.state);
            (state.goal_deg, state.stopped) = (Some(to_deg), false);
            state.log.push(format!("to {to_deg}"));
            Ok(())
        }
        fn poll_turn(&self) -> Result<Motion, ScopeError> {
            let state = lock(&self.state);
            Ok(
                match (state.finding || state.goal_deg.is_some(), state.stopped) {
                    (true, _) => Motion::Moving,
                    (false, true) => Motion::Stopped,
                    (false, false) => Motion::Settled,
                },
            )
        }
        fn stop_turn(&self) -> Result<(), ScopeError> {
            let mut state = lock(&self.state);
            let moves = state.finding || state.goal_deg.is_some();
            (state.finding, state.goal_deg) = (false, None);
            state.stopped = moves;
            state.log.push("stop".into());
            Ok(())
        }
        fn invalidate_position(&self) {
            lock(&self.state).known = false;
        }
    }

    fn places() -> Vec<TurretPlace> {
        [("10x", 0.0), ("20x", 90.0), ("40x", 180.0)]
            .map(|(id, at_deg)| TurretPlace {
                immersion: Immersion::Air,
                id: id.into(),
                magnification: 100.0,
                numerical_aperture: 0.3,
                um_per_px: 1.0,
                at_deg,
            })
            .into()
    }

    fn id(name: &str) -> ObjectiveId {
        ObjectiveId(name.into())
    }

    fn turret(known: bool) -> (Arc<Axis>, Turret) {
        let axis = Arc::new(Axis::default());
        lock(&axis.state).known = known;
        (axis.clone(), Turret::new(axis, &places(), 0.5, false))
    }

    #[test]
    fn the_first_change_finds_the_reference_and_goes_on() {
        let (axis, turret) = turret(false);
        assert_eq!(turret.current(), Ok(None));
        assert_eq!(turret.poll(), Ok(Motion::Settled));
        turret.start_change(&id("40x")).unwrap();
        assert_eq!(turret.poll(), Ok(Motion::Moving));
        assert!(matches!(
            turret.start_change(&id("10x")),
            Err(ScopeError::Busy { .. })
        ));
        axis.arrive();
        assert_eq!(turret.poll(), Ok(Motion::Moving));
        assert_eq!(turret.current(), Ok(None));
        axis.arrive();
        assert_eq!(turret.poll(), Ok(Motion::Settled));
        assert_eq!(turret.current(), Ok(Some(id("40x"))));
        assert_eq!(axis.log(), ["find", "to 180"]);
        turret.start_change(&id("20x")).unwrap();
        axis.arrive();
        assert_eq!(turret.poll(), Ok(Motion::Settled));
        assert_eq!(turret.current(), Ok(Some(id("20x"))));
        assert!(turret.start_change(&id("63x")).is_err());
    }

    #[test]
    fn what_is_stopped_while_it_finds_its_reference_does_not_go_on() {
        let (axis, turret) = turret(false);
        turret.start_change(&id("40x")).unwrap();
        turret.stop().unwrap();
        assert_eq!(turret.poll(), Ok(Motion::Stopped));
        assert_eq!(turret.current(), Ok(None));
        assert_eq!(axis.log(), ["find", "stop"]);
        // Stopped at the very moment at which it goes on.
        turret.start_change(&id("40x")).unwrap();
        axis.arrive();
        turret.stops.fetch_add(1, Ordering::SeqCst);
        assert_eq!(turret.poll(), Ok(Motion::Stopped));
        assert_eq!(axis.log()[2..], ["find"]);
    }

    #[test]
    fn what_was_stopped_on_the_way_does_not_know_where_it_is() {
        let (axis, turret) = turret(true);
        turret.start_change(&id("40x")).unwrap();
        turret.stop().unwrap();
        turret.start_change(&id("20x")).unwrap();
        assert_eq!(axis.log(), ["to 180", "stop", "find"]);
        // Without a switch it counts from where it was said to stand: behind a gate, a stop makes a report of that again.
        let turret = Turret::new(axis.clone(), &places(), 0.5, true);
        lock(&axis.state).known = true;
        assert_eq!(turret.known_by(), KnownBy::Count);
        let stage = Box::new(scopeservo_scope::Absent::new());
        let rules = scopeservo_scope::Rules::travel_only(scopeservo_scope::ChangeRule::Anywhere);
        let gate = scopeservo_scope::MotionGate::new(stage, Box::new(turret), rules).unwrap();
        gate.confirm_objective();
        gate.start_change(&id("40x")).unwrap();
        assert!(!gate.objective_is_reported());
        gate.stop().unwrap();
        assert!(gate.objective_is_reported());
    }

    #[test]
    fn between_two_objectives_there_is_none() {
        let (axis, turret) = turret(true);
        lock(&axis.state).at_deg = 90.4;
        assert_eq!(turret.current(), Ok(Some(id("20x"))));
        lock(&axis.state).at_deg = 91.0;
        assert_eq!(turret.current(), Ok(None));
    }

    #[test]
    fn places_that_make_no_sense_are_refused() {
        assert!(check(&places(), 0.5).is_ok());
        assert!(check(&places()[..1], 0.5).is_err());
        assert!(check(&places(), 45.0).is_err());
        assert!(check(&places(), 0.0).is_err());
        for change in [
            |p: &mut TurretPlace| p.id = "20x".into(),
            |p: &mut TurretPlace| p.id = String::new(),
            |p: &mut TurretPlace| p.at_deg = f64::NAN,
            |p: &mut TurretPlace| p.um_per_px = 0.0,
        ] {
            let mut wrong = places();
            change(&mut wrong[0]);
            assert!(check(&wrong, 0.5).is_err(), "{wrong:?}");
        }
    }
}
