//! Devices that write down every rule that is broken, whatever is asked and whatever fails.

#![allow(
    dead_code,
    unreachable_pub,
    reason = "each test file uses its own part of this module"
)]

use scopeservo_scope::{
    Axis, AxisInfo, AxisRange, CancelToken, ChangeRule, Clock, Immersion, Instrument, Kinematics,
    LargestStep, Limits, Motion, MotionGate, Nosepiece, Objective, ObjectiveId, PositiveZ, Rules,
    ScopeError, Stage, StageInfo, StagePose, Timestamp, VirtualClock, Workspace, Zone,
};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

pub const AXES: [Axis; 3] = [Axis::X, Axis::Y, Axis::Z];
pub const TRAVEL: f64 = 1e-2;
pub const LIMIT: f64 = 8e-3;
/// Of the strongest objective, along z.
pub const NARROW: f64 = 2e-3;
/// Of the strongest objective, along x.
pub const NARROW_X: f64 = 3e-3;
pub const RETRACTED: f64 = -5e-3;
pub const STEP: f64 = 6e-3;
pub const CLAMP: [f64; 2] = [4e-3, 6e-3];
pub const CLAMP_Z: f64 = -3e-3;
/// By this much a place that is reported may miss.
pub const SLACK: f64 = 1.1e-6;
/// The last works in oil.
pub const OBJECTIVES: [&str; 3] = ["10x", "40x", "60x"];

/// A move: from where, to where, and how far on the way each axis is. They go at speeds of their own.
pub struct Way {
    pub from: [f64; 3],
    pub to: [f64; 3],
    pub done: [f64; 3],
}

/// What really happens. It knows nothing of the gate.
pub struct World {
    pub at: [f64; 3],
    pub way: Option<Way>,
    pub stopped: bool,
    pub objective: Option<usize>,
    pub turning: Option<(usize, u32)>,
    /// What is on the specimen.
    pub medium: Immersion,
    /// The height at which the last turn began.
    pub turned_at: Option<f64>,
    pub fault: Option<Fault>,
    /// An obstacle beyond which an axis does not go.
    pub wall: Option<(usize, [f64; 2])>,
    /// What moves along x or y lifts z by this.
    pub lifts: f64,
    /// Each move of an axis ends short by this, where it is longer.
    pub short: f64,
    /// What it says of an axis is off by this.
    pub says: Option<(usize, f64)>,
    /// It takes stops, and goes on.
    pub deaf: bool,
    /// The devices have broken rules by themselves: from now on only what is begun is judged.
    pub excused: bool,
    pub broken: Vec<String>,
    /// The goals of the last move.
    pub asked: Option<[Option<f64>; 3]>,
    pub begun: u32,
    pub stops: u32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    Poll,
    Position,
    Start,
    NosepiecePoll,
    NosepieceCurrent,
    /// From now on.
    Wall(usize, [f64; 2]),
    Lifts(f64),
    Says(usize, f64),
    Deaf(bool),
    /// Nothing is wrong any more, where it stands.
    Mended,
}

impl Fault {
    /// What breaks for longer than one call.
    pub fn lasts(self, world: &mut World) -> bool {
        match self {
            Fault::Wall(axis, between) => world.wall = Some((axis, between)),
            Fault::Lifts(by) => (world.lifts, world.excused) = (by, true),
            Fault::Says(axis, by) => (world.says, world.excused) = (Some((axis, by)), true),
            Fault::Deaf(deaf) => world.deaf = deaf,
            Fault::Mended => {
                (world.wall, world.lifts, world.says, world.deaf) = (None, 0.0, None, false)
            }
            _ => return false,
        }
        true
    }
}

impl World {
    pub fn new() -> Self {
        Self {
            at: [0.0, 0.0, RETRACTED],
            way: None,
            stopped: false,
            objective: Some(0),
            turning: None,
            medium: Immersion::Air,
            turned_at: None,
            fault: None,
            wall: None,
            lifts: 0.0,
            short: 0.0,
            says: None,
            deaf: false,
            excused: false,
            broken: Vec::new(),
            asked: None,
            begun: 0,
            stops: 0,
        }
    }

    /// Where the stage says it is.
    pub fn said(&self) -> [f64; 3] {
        let mut said = self.at;
        if let Some((axis, by)) = self.says {
            said[axis] += by;
        }
        said
    }

    /// Judges what begins, by what the devices say: a move to a goal, or a turn.
    pub fn judge(&mut self, goal: Option<[f64; 3]>) {
        let from = self.said();
        let tops = match self.objective {
            Some(0 | 2) => [LIMIT; 3],
            _ => [NARROW_X, LIMIT, NARROW],
        };
        let outside = |at: [f64; 3], slack: f64| -> Vec<usize> {
            let out = |k: &usize| !(at[*k] <= tops[*k] + slack && at[*k] >= -LIMIT - slack);
            (0..3).filter(out).collect()
        };
        let in_clamp = |at: [f64; 3]| {
            let over = |v: f64| (CLAMP[0]..=CLAMP[1]).contains(&v);
            over(at[0]) && over(at[1]) && at[2] > CLAMP_Z + SLACK
        };
        let possible = from.iter().all(|v| v.abs() <= TRAVEL + SLACK);
        if !possible {
            self.broken
                .push(format!("something begins at {from:?}, where no stage is"));
        }
        let out = outside(from, SLACK);
        let Some(goal) = goal else {
            if !out.is_empty() || in_clamp(from) || from[2] > RETRACTED + SLACK {
                self.broken
                    .push(format!("it turns at {from:?}, as it says"));
            }
            return;
        };
        let moved: Vec<usize> = (0..3).filter(|&k| goal[k] != from[k]).collect();
        let nearer = |k: &usize| out.contains(k) && goal[*k].abs() < from[*k].abs();
        let retreat = moved == [2] && goal[2] < from[2];
        let beyond = outside(goal, 0.0);
        if beyond.iter().any(|k| moved.contains(k) && !nearer(k)) {
            self.broken
                .push(format!("from {from:?} to {goal:?}, which is outside"));
        }
        let too_near = from[2] > tops[2] + SLACK || in_clamp(from);
        let back = outside(goal, SLACK).is_empty() || moved.iter().all(nearer);
        if !retreat && (too_near || !out.is_empty() && !back) {
            self.broken
                .push(format!("from {from:?}, which is outside, to {goal:?}"));
        }
    }

    pub fn look(&mut self) {
        if self.turning.is_some() && self.way.is_some() {
            self.broken.push("moves while it turns".into());
        }
        if self.excused {
            return;
        }
        let [x, y, z] = self.at;
        for (axis, v) in AXES.iter().zip(self.at) {
            if v.abs() > LIMIT + 1e-12 {
                self.broken.push(format!("{axis} at {v}"));
            }
        }
        let in_clamp = |v: f64| (CLAMP[0]..=CLAMP[1]).contains(&v);
        if in_clamp(x) && in_clamp(y) && z > CLAMP_Z + 1e-12 {
            self.broken.push(format!("in the clamp at {:?}", self.at));
        }
        // A place within the slack is inside when another objective comes; goals are judged to the last bit, in `judge`.
        if self.objective == Some(1) && (z > NARROW + SLACK || x > NARROW_X + SLACK) {
            self.broken
                .push(format!("40x outside its own limits at {:?}", self.at));
        }
        if self.turning.is_some() && z > RETRACTED + SLACK {
            self.broken.push(format!("turns at z = {z}"));
        }
    }

    pub fn tick(&mut self) {
        if let Some(way) = &mut self.way {
            for (k, speed) in [0.3, 0.5, 0.2].into_iter().enumerate() {
                way.done[k] += speed;
                self.at[k] = match way.done[k] < 1.0 {
                    true => way.from[k] + (way.to[k] - way.from[k]) * way.done[k],
                    false => way.to[k],
                };
            }
            if way.done.iter().all(|&done| done >= 1.0) {
                self.way = None;
            }
        }
        if let Some((to, left)) = self.turning {
            self.turning = (left > 1).then_some((to, left - 1));
            if left <= 1 {
                self.objective = Some(to);
            }
        }
        self.look();
    }

    pub fn fails(&mut self, fault: Fault) -> Result<(), ScopeError> {
        if self.fault == Some(fault) {
            self.fault = None;
            return Err(ScopeError::Device {
                device: "stage",
                detail: format!("{fault:?}"),
            });
        }
        Ok(())
    }
}

#[derive(Clone)]
pub struct Devices {
    pub world: Arc<Mutex<World>>,
    pub info: StageInfo,
    pub objectives: Vec<Objective>,
}

impl Devices {
    pub fn new() -> Self {
        let axis = |&axis: &Axis| AxisInfo {
            axis,
            min: -TRAVEL,
            max: TRAVEL,
            repeatability: 0.0,
            arrival_tolerance: None,
        };
        let objective = |id: &&str| Objective {
            id: ObjectiveId((*id).into()),
            magnification: 100.0,
            numerical_aperture: 0.25,
            nominal_um_per_px: 1.0,
            immersion: match *id {
                "60x" => Immersion::Oil,
                _ => Immersion::Air,
            },
        };
        Self {
            world: Arc::new(Mutex::new(World::new())),
            info: StageInfo {
                name: "recorder".into(),
                axes: AXES.iter().map(axis).collect(),
                kinematics: Kinematics::SpecimenXyOnTop,
                positive_z: PositiveZ::Closer,
            },
            objectives: OBJECTIVES.iter().map(objective).collect(),
        }
    }

    pub fn gate(&self, rules: Rules) -> MotionGate {
        MotionGate::new(Box::new(self.clone()), Box::new(self.clone()), rules).unwrap()
    }

    pub fn instrument(
        &self,
        rules: Rules,
        clock: Arc<dyn Clock>,
        cancel: CancelToken,
    ) -> Instrument {
        let devices = scopeservo_scope::Devices {
            stage: Some(Box::new(self.clone())),
            nosepiece: Some(Box::new(self.clone())),
            ..scopeservo_scope::Devices::none(clock)
        };
        Instrument::new(devices, rules, cancel).unwrap()
    }

    pub fn world(&self) -> std::sync::MutexGuard<'_, World> {
        self.world.lock().unwrap()
    }
}

impl Stage for Devices {
    fn info(&self) -> &StageInfo {
        &self.info
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        let mut world = self.world();
        world.fails(Fault::Position)?;
        Ok(pose(world.said()))
    }
    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        let mut world = self.world();
        world.fails(Fault::Start)?;
        if world.way.is_some() {
            world.broken.push("a move on top of a move".into());
        }
        let said = world.said();
        let asked = [0, 1, 2].map(|k| to.si(AXES[k]).unwrap_or(said[k]));
        world.judge(Some(asked));
        let retreat = asked[0] == said[0] && asked[1] == said[1] && asked[2] <= said[2];
        for k in 0..3 {
            if (asked[k] - said[k]).abs() > STEP && !(retreat && k == 2) {
                world
                    .broken
                    .push(format!("a step from {said:?} to {asked:?}"));
            }
        }
        let from = world.at;
        let mut goal = [0, 1, 2].map(|k| from[k] + (asked[k] - said[k]));
        for (goal, from) in goal.iter_mut().zip(from) {
            if (*goal - from).abs() > world.short {
                *goal -= world.short * (*goal - from).signum();
            }
        }
        if let Some((axis, [low, high])) = world.wall {
            goal[axis] = goal[axis].clamp(low.min(from[axis]), high.max(from[axis]));
        }
        if goal[0] != from[0] || goal[1] != from[1] {
            goal[2] += world.lifts;
        }
        world.way = Some(Way {
            from,
            to: goal,
            done: [0.0; 3],
        });
        world.asked = Some(AXES.map(|axis| to.si(axis)));
        world.stopped = false;
        world.begun += 1;
        world.look();
        Ok(())
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        let mut world = self.world();
        world.fails(Fault::Poll)?;
        Ok(match (&world.way, world.stopped) {
            (Some(_), _) => Motion::Moving,
            (None, true) => Motion::Stopped,
            (None, false) => Motion::Settled,
        })
    }
    fn stop(&self) -> Result<(), ScopeError> {
        let mut world = self.world();
        world.stops += 1;
        if world.deaf {
            return Ok(());
        }
        world.stopped |= world.way.take().is_some();
        Ok(())
    }
}

impl Nosepiece for Devices {
    fn objectives(&self) -> &[Objective] {
        &self.objectives
    }
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        let mut world = self.world();
        world.fails(Fault::NosepieceCurrent)?;
        Ok(world.objective.map(|k| self.objectives[k].id.clone()))
    }
    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        let mut world = self.world();
        let Some(index) = OBJECTIVES.iter().position(|id| *id == to.0) else {
            world.broken.push("an unknown objective".into());
            return Ok(());
        };
        if world.turning.is_some() {
            world.broken.push("a change on top of a change".into());
        }
        world.judge(None);
        let (works_in, there) = (self.objectives[index].immersion, world.medium);
        if works_in != there {
            world.broken.push(format!(
                "{to}, which works in {works_in}, comes into {there}"
            ));
        }
        world.turned_at = Some(world.at[2]);
        world.objective = None;
        world.turning = Some((index, 3));
        world.begun += 1;
        world.look();
        Ok(())
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        let mut world = self.world();
        world.fails(Fault::NosepiecePoll)?;
        Ok(match (world.turning, world.objective) {
            (Some(_), _) => Motion::Moving,
            (None, Some(_)) => Motion::Settled,
            (None, None) => Motion::Stopped,
        })
    }
    fn stop(&self) -> Result<(), ScopeError> {
        self.world().turning = None;
        Ok(())
    }
}

pub fn pose(at: [f64; 3]) -> StagePose {
    (0..3).fold(StagePose::default(), |pose, k| pose.with_si(AXES[k], at[k]))
}

pub fn z(at: f64) -> StagePose {
    StagePose::default().with_si(Axis::Z, at)
}

pub fn id(name: &str) -> ObjectiveId {
    ObjectiveId(name.into())
}

pub fn rules() -> Rules {
    let range = |axis, min, max| AxisRange { axis, min, max };
    Rules {
        limits: Limits {
            ranges: AXES.map(|axis| range(axis, -LIMIT, LIMIT)).into(),
        },
        objective_limits: BTreeMap::from([(
            id("40x"),
            Limits {
                ranges: vec![
                    range(Axis::Z, -LIMIT, NARROW),
                    range(Axis::X, -LIMIT, NARROW_X),
                ],
            },
        )]),
        largest_steps: AXES.map(|axis| LargestStep { axis, step: STEP }).into(),
        workspace: Workspace::Box,
        zones: vec![Zone {
            name: "the clamp".into(),
            x: CLAMP,
            y: CLAMP,
            closest_z: CLAMP_Z,
            objectives: Vec::new(),
        }],
        change: ChangeRule::Retracted {
            z: RETRACTED,
            margin: 0.0,
        },
    }
}

/// A clock that lets the world go on while somebody sleeps.
pub struct Ticking {
    pub clock: VirtualClock,
    pub devices: Devices,
}

impl Clock for Ticking {
    fn now(&self) -> Timestamp {
        self.clock.now()
    }
    fn sleep(&self, duration: Duration) {
        self.clock.sleep(duration);
        self.devices.world().tick();
    }
}
