//! Where a stage may stand, and where it may go: places, goals and ways against the rules. Nothing here talks to a device.
//!
//! A goal must keep the rules to the letter. A place that the stage reports is judged with the slack of its axes
//! ([`crate::AxisInfo::tolerance`]), those that were not asked to move included.

use crate::{
    Axis, AxisInfo, AxisRange, Breach, ObjectiveId, Rules, ScopeError, StageInfo, StagePose,
    Workspace, Zone,
};

/// The rules as they are with the objectives that may be active.
pub(crate) struct Judge<'a> {
    pub(crate) info: &'a StageInfo,
    pub(crate) rules: &'a Rules,
    /// Limits for all objectives.
    pub(crate) ranges: &'a [AxisRange],
    pub(crate) in_beam: &'a [ObjectiveId],
}

impl Judge<'_> {
    /// The rule that a reported place breaks by more than its slack: what is too near to the specimen first.
    pub(crate) fn breach(&self, at: &StagePose) -> Option<Breach> {
        self.too_near(at).or_else(|| self.elsewhere(at))
    }

    /// Whether the stage may be told to go from `here` to `to`, wherever the way leads.
    pub(crate) fn check_goal(&self, here: &StagePose, to: &StagePose) -> Result<(), ScopeError> {
        let whole = to.or(here);
        let moved: Vec<Axis> = Axis::ALL
            .into_iter()
            .filter(|&axis| to.si(axis).is_some() && to.si(axis) != here.si(axis))
            .collect();
        for range in self.ranges().filter(|r| moved.contains(&r.axis)) {
            if let Some(breach) = beyond(range, &whole, 0.0)
                && !self.comes_back(range, here, to)
            {
                return Err(breach.into());
            }
        }
        if self.retreats(here, to) {
            // Away from the specimen is the way out of everything but the end of the travel.
            return self.check_load(here, &whole, &moved);
        }
        if let Some(breach) = self.too_near(here) {
            return Err(ScopeError::StandsOutside { breach });
        }
        if let Some(breach) = self.elsewhere(here) {
            let comes_back = |axis: &Axis| {
                let mut ranges = self.ranges().filter(|r| r.axis == *axis);
                ranges.any(|range| self.comes_back(range, here, to))
            };
            let inwards = match breach {
                Breach::Workspace { share } => self.load(&whole, &moved) < share,
                _ => self.breach(&whole).is_none() || moved.iter().all(comes_back),
            };
            if moved.is_empty() || !inwards {
                return Err(ScopeError::StandsOutside { breach });
            }
        }
        self.check_load(here, &whole, &moved)?;
        let z = whole.si(Axis::Z).unwrap_or(f64::NAN);
        let slack = if moved.contains(&Axis::Z) {
            0.0
        } else {
            self.slack(Axis::Z)
        };
        let [x, y] = [Axis::X, Axis::Y].map(|axis| [whole.si(axis); 2]);
        self.clear_of_zones(x, y, z, slack)
    }

    /// The way to a goal. The axes may go one after the other, in any order: the whole box between start and goal counts.
    pub(crate) fn check_way(&self, here: &StagePose, to: &StagePose) -> Result<(), ScopeError> {
        let retreat = self.retreats(here, to);
        for largest in &self.rules.largest_steps {
            let axis = largest.axis;
            let Some(goal) = to.si(axis) else { continue };
            let step = here
                .si(axis)
                .map_or(f64::INFINITY, |from| (goal - from).abs());
            let retreats = retreat && axis == Axis::Z;
            if !retreats && !at_most(step, largest.step) {
                return Err(ScopeError::StepTooLarge {
                    axis,
                    step: axis.to_display(step),
                    largest: axis.to_display(largest.step),
                });
            }
        }
        if retreat {
            // Away from the specimen is the way out of everything.
            return Ok(());
        }
        let whole = to.or(here);
        let from = here.si(Axis::Z).unwrap_or(f64::NAN);
        let goal = to.si(Axis::Z).unwrap_or(from);
        // Neither is known to be the nearer one when one is unknown: then it is the unknown one.
        let (nearest, slack) = match self.info.positive_z.nearer_by(from, goal) < 0.0 {
            true => (goal, 0.0),
            // Where it stands was read, not chosen.
            false => (from, self.slack(Axis::Z)),
        };
        let both = |axis| [here.si(axis), whole.si(axis)];
        self.clear_of_zones(both(Axis::X), both(Axis::Y), nearest, slack)
    }

    /// As much of a way as may be gone in one step: all of it, or the first part of the straight line.
    pub(crate) fn first_part(&self, here: &StagePose, to: &StagePose) -> StagePose {
        if self.retreats(here, to) {
            return *to;
        }
        let longest = self.rules.largest_steps.iter().map(|largest| {
            let way = here.si(largest.axis).zip(to.si(largest.axis));
            let way = way.map_or(0.0, |(from, goal)| (goal - from).abs());
            largest.step / way
        });
        // What is no number is no way.
        let share = longest.fold(f64::INFINITY, f64::min);
        if share >= 1.0 {
            return *to;
        }
        Axis::ALL.into_iter().fold(*to, |part, axis| {
            match here.si(axis).zip(to.si(axis)) {
                // A little less, so that rounding is no reason to refuse.
                Some((from, goal)) => part.with_si(axis, from + 0.999 * share * (goal - from)),
                None => part,
            }
        })
    }

    /// A place that the stage has reported, as a goal: what stands beyond a limit by no more than its slack, at that limit.
    pub(crate) fn as_goal(&self, at: &StagePose) -> StagePose {
        self.ranges()
            .fold(*at, |goal, range| match goal.si(range.axis) {
                Some(si) if self.beyond_slack(range, &goal).is_none() => {
                    goal.with_si(range.axis, si.clamp(range.min, range.max))
                }
                _ => goal,
            })
    }

    /// After a move from `from` that ended at `at`: the rule that is broken, unless the stage stood outside before and came back
    /// some of the way.
    pub(crate) fn strayed(&self, from: &StagePose, at: &StagePose) -> Option<Breach> {
        for range in self.ranges() {
            let breach = self.beyond_slack(range, at);
            let stood = self.beyond_slack(range, from).is_some();
            let farther = excess(range, at) > excess(range, from) + self.slack(range.axis);
            if breach.is_some() && (!stood || farther) {
                return breach;
            }
        }
        match self.breach(from) {
            // It was inside all rules before.
            None => self.breach(at),
            Some(_) => None,
        }
    }

    /// Whether a move goes away from the specimen and nowhere else: the way out of everything.
    fn retreats(&self, here: &StagePose, to: &StagePose) -> bool {
        let rests = |axis: Axis| to.si(axis).is_none_or(|goal| Some(goal) == here.si(axis));
        let mut others = Axis::ALL.into_iter().filter(|a| *a != Axis::Z);
        let heights = here.si(Axis::Z).zip(to.si(Axis::Z));
        others.all(rests)
            && heights.is_some_and(|(from, goal)| self.info.positive_z.nearer_by(goal, from) < 0.0)
    }

    /// Limits for all objectives, and those of each that may be active.
    fn ranges(&self) -> impl Iterator<Item = &AxisRange> {
        let own = |id| self.rules.objective_limits.get(id);
        let own = self.in_beam.iter().filter_map(own);
        self.ranges.iter().chain(own.flat_map(|l| &l.ranges))
    }

    fn slack(&self, axis: Axis) -> f64 {
        self.info.axis(axis).map_or(0.0, AxisInfo::tolerance)
    }

    /// A place from which the only way is straight away from the specimen.
    fn too_near(&self, at: &StagePose) -> Option<Breach> {
        let near = |range: &&AxisRange| {
            let middle = 0.5 * (range.min + range.max);
            let z = at.si(Axis::Z).unwrap_or(f64::NAN);
            range.axis == Axis::Z && !at_most(self.info.positive_z.nearer_by(z, middle), 0.0)
        };
        let mut limits = self.ranges().filter(near);
        if let Some(breach) = limits.find_map(|range| self.beyond_slack(range, at)) {
            return Some(breach);
        }
        let slack = self.slack(Axis::Z);
        let z = at.si(Axis::Z).unwrap_or(f64::NAN);
        let [x, y] = [Axis::X, Axis::Y].map(|axis| [at.si(axis); 2]);
        self.zone_over(x, y, z, slack)
    }

    /// Limits and workspace.
    fn elsewhere(&self, at: &StagePose) -> Option<Breach> {
        let broken = |range| self.beyond_slack(range, at);
        let load = self.load(at, &[]);
        self.ranges()
            .find_map(broken)
            .or_else(|| (!at_most(load, 1.0)).then_some(Breach::Workspace { share: load }))
    }

    fn beyond_slack(&self, range: &AxisRange, at: &StagePose) -> Option<Breach> {
        beyond(range, at, self.slack(range.axis))
    }

    /// Whether a move brings an axis that stands outside a range back to it, or nearer to it.
    fn comes_back(&self, range: &AxisRange, here: &StagePose, to: &StagePose) -> bool {
        let (Some(from), Some(goal)) = (here.si(range.axis), to.si(range.axis)) else {
            return false;
        };
        let slack = self.slack(range.axis);
        (from > range.max + slack && goal < from && goal >= range.min)
            || (from < range.min - slack && goal > from && goal <= range.max)
    }

    fn check_load(
        &self,
        here: &StagePose,
        whole: &StagePose,
        moved: &[Axis],
    ) -> Result<(), ScopeError> {
        let (load, before) = (self.load(whole, moved), self.load(here, &[]));
        let falls = before > 1.0 && load < before;
        match at_most(load, 1.0) || falls {
            true => Ok(()),
            false => Err(ScopeError::OutsideWorkspace { share: load }),
        }
    }

    /// The share of the travel that the axes use together; 0 where each has its own. Those that are not `chosen` have slack.
    fn load(&self, at: &StagePose, chosen: &[Axis]) -> f64 {
        if self.rules.workspace == Workspace::Box {
            return 0.0;
        }
        let share = |axis: &AxisInfo| {
            let slack = if chosen.contains(&axis.axis) {
                0.0
            } else {
                axis.tolerance()
            };
            let (middle, half) = ((axis.max + axis.min) / 2.0, (axis.max - axis.min) / 2.0);
            // An axis whose place is not known may be anywhere.
            at.si(axis.axis).map_or(f64::INFINITY, |at| {
                (((at - middle).abs() - slack).max(0.0) / half).powi(2)
            })
        };
        self.info.axes.iter().map(share).sum::<f64>().sqrt()
    }

    fn clear_of_zones(
        &self,
        x: [Option<f64>; 2],
        y: [Option<f64>; 2],
        z: f64,
        slack: f64,
    ) -> Result<(), ScopeError> {
        match self.zone_over(x, y, z, slack) {
            Some(breach) => Err(breach.into()),
            None => Ok(()),
        }
    }

    /// The zone over which a height is too near, anywhere in a part of the plane. A height that nobody knows is not known to be clear.
    fn zone_over(
        &self,
        x: [Option<f64>; 2],
        y: [Option<f64>; 2],
        z: f64,
        slack: f64,
    ) -> Option<Breach> {
        let zone = self.zones().find(|zone| {
            let above = self.info.positive_z.nearer_by(z, zone.closest_z);
            reaches(zone.x, x) && reaches(zone.y, y) && !at_most(above, slack)
        })?;
        Some(Breach::Zone {
            zone: zone.name.clone(),
            z_um: z * 1e6,
            closest_um: zone.closest_z * 1e6,
        })
    }

    fn zones(&self) -> impl Iterator<Item = &Zone> {
        self.rules.zones.iter().filter(|zone| {
            zone.objectives.is_empty() || zone.objectives.iter().any(|id| self.in_beam.contains(id))
        })
    }
}

/// How far a place is outside a range; negative inside.
fn excess(range: &AxisRange, at: &StagePose) -> f64 {
    at.si(range.axis)
        .map_or(f64::NAN, |at| (at - range.max).max(range.min - at))
}

/// A place outside a range by more than the slack.
fn beyond(range: &AxisRange, at: &StagePose, slack: f64) -> Option<Breach> {
    let axis = range.axis;
    (!at_most(excess(range, at), slack)).then(|| Breach::Limits {
        axis,
        at: axis.to_display(at.si(axis).unwrap_or(f64::NAN)),
        min: axis.to_display(range.min),
        max: axis.to_display(range.max),
    })
}

/// What is no number is not known to be small.
pub(crate) fn at_most(value: f64, limit: f64) -> bool {
    value <= limit
}

/// Whether anything between two coordinates lies in a range; unknown ones may lie anywhere.
fn reaches(range: [f64; 2], between: [Option<f64>; 2]) -> bool {
    let [Some(a), Some(b)] = between else {
        return true;
    };
    !(a.max(b) < range[0] || a.min(b) > range[1])
}
