//! The check as a step machine: one view per step.

use super::follow::{GridView, so_far, way};
use super::numbers::{Given, Told, tell as told};
use super::plan::{Move, first_turn, next_turns, translations};
use super::report::GridReport;
use crate::event::tell;
use crate::hand_eye::pose_sigma;
use crate::kinematics::PlanarPose;
use crate::one_side::below;
use crate::procedure::{Procedure, Progress, home_after_an_answer, withdrawn};
use crate::vision::{grab, gray};
use crate::{Calibration, Event, FrameRole, ServoError, Sink};
use scopeservo_registration::{NoGrid, find_grid, follow_grid};
use scopeservo_scope::{Axis, Instrument, Objective, ScopeError, StagePose};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Views that were not followed may be so many, at most, of all.
const LOST: f64 = 0.4;
/// A stage that goes farther than it says, or less far, by more than this has another unit, or the grid another pitch.
const STRETCH: f64 = 0.05;

/// Settings of a check with a pattern slide.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GridOptions {
    /// Distance of two neighbours of the grid, um: the shortest way on which the pattern repeats.
    pub pitch_um: f64,
    /// How far the stage goes from where it began along x and y, um.
    pub reach_um: f64,
    /// What is seen may be this many times what the stage's repeatability explains, at most.
    pub residual_factor: f64,
}

impl Default for GridOptions {
    fn default() -> Self {
        Self {
            pitch_um: 100.0,
            reach_um: 2000.0,
            residual_factor: 4.0,
        }
    }
}

/// The check around the present place with the active objective, which must be in focus on the grid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GridCheck {
    options: GridOptions,
    objective: Objective,
    /// Standard deviations of arrivals from one side, where they are known better than the stage states: m, m, rad.
    scatter: Option<[f64; 3]>,
    /// Where the stage stood when it began.
    start: Option<PlanarPose>,
    todo: VecDeque<Move>,
    views: Vec<GridView>,
    /// Why the last view was not followed, and how many were not.
    lost: Option<NoGrid>,
    lost_views: usize,
}

impl GridCheck {
    /// Its objective.
    pub fn objective(&self) -> &Objective {
        &self.objective
    }

    /// A check of `objective`.
    pub fn new(objective: Objective, options: GridOptions) -> Self {
        Self {
            options,
            objective,
            scatter: None,
            start: None,
            todo: VecDeque::new(),
            views: Vec::new(),
            lost: None,
            lost_views: 0,
        }
    }

    /// With how arrivals were seen to scatter, as a calibration knows it: what a stage states has its play in it, which the moves here take up.
    #[must_use]
    pub fn knowing(mut self, calibration: &Calibration) -> Self {
        self.scatter = calibration.scatter.filter(|s| s[0] > 0.0 && s[1] > 0.0);
        self
    }

    /// Standard deviations of where arrivals end: m, m, rad.
    fn pose_sigma(&self, scope: &Instrument) -> [f64; 3] {
        self.scatter
            .unwrap_or_else(|| pose_sigma(scope.gate().info()))
    }

    fn pitch_m(&self) -> f64 {
        1e-6 * self.options.pitch_um
    }

    fn work(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<GridReport>, ServoError> {
        let Some(start) = self.start else {
            self.begin(scope)?;
            return Ok(Progress::Continue);
        };
        let goals = scope.gate().goals()?;
        while let Some(next) = self.todo.pop_front() {
            let pose = place(&start, next);
            let below = below(&pose, None);
            let reachable = [&below, &pose].map(|p| goals.allow(&p.request(&goals.here)));
            // Home is where the stage stood; without room below it, it goes there straight.
            if reachable[1] || next == Move::Home {
                let via = reachable[0].then_some(below);
                self.look(scope, sink, (next, &pose, via, &goals.here))?;
                return Ok(Progress::Continue);
            }
        }
        let report = self.verdict(scope)?;
        self.go_home(scope)?;
        Ok(Progress::Done(report))
    }

    fn begin(&mut self, scope: &Instrument) -> Result<(), ServoError> {
        let at = scope.gate().position()?;
        for (axis, value) in [(Axis::X, at.x), (Axis::Y, at.y)] {
            if value.is_none() {
                return Err(ScopeError::NoSuchAxis { axis }.into());
            }
        }
        let sigma = self.pose_sigma(scope);
        let sigma_m = sigma[0].max(sigma[1]);
        let moves = translations(self.pitch_m(), sigma_m, 1e-6 * self.options.reach_um);
        let moves = moves.ok_or(ServoError::GridTooFineForStage {
            pitch_um: self.options.pitch_um,
            scatter_um: 1e6 * sigma_m,
        })?;
        self.todo = moves.into();
        if scope.gate().info().axis(Axis::Rz).is_some() {
            self.todo.push_back(first_turn(self.pitch_m()));
        }
        self.start = Some(PlanarPose::from(&at));
        Ok(())
    }

    /// Moves, looks, and counts the periods on the way.
    fn look(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        (next, pose, via, present): (Move, &PlanarPose, Option<PlanarPose>, &StagePose),
    ) -> Result<(), ServoError> {
        if let Some(via) = via {
            scope.move_to(&via.request(present))?;
        }
        let at = scope.move_to(&pose.request(present))?;
        let frame = grab(scope, sink, FrameRole::Calibration, &self.objective.id)?;
        let image = gray(scope, &frame)?;
        let index = self.views.len() + self.lost_views;
        let grid = match self.views.first() {
            Some(first) => follow_grid(&image, &first.grid),
            None => {
                let expected_px = self.options.pitch_um / self.objective.nominal_um_per_px;
                Ok(find_grid(&image, expected_px).map_err(|why| self.no_grid(why))?)
            }
        };
        let kinematics = scope.gate().info().kinematics;
        let (reported, turned) = (PlanarPose::from(&at), matches!(next, Move::Turn { .. }));
        let seen = grid.map(|grid| {
            let way = way(kinematics, &self.views, (&reported, turned), &grid)?;
            Some(GridView {
                pose: reported,
                turned,
                grid,
                way,
            })
        });
        let (shift_px, inliers) = match &seen {
            Ok(Some(view)) => (
                Some(view.grid.pixel_from_lattice * view.way),
                view.grid.nodes,
            ),
            _ => (None, 0),
        };
        tell(
            scope,
            sink,
            Event::CalibrationView {
                index,
                stage: at,
                shift_px,
                inliers,
                chain: None,
            },
        );
        match seen {
            Ok(Some(view)) => {
                self.views.push(view);
                self.turn_on(scope, next);
            }
            Ok(None) => self.lost_views += 1,
            Err(why) => {
                self.lost = Some(why);
                self.lost_views += 1;
            }
        }
        Ok(())
    }

    /// After a rotation, how the axis lies says how far the next may go.
    fn turn_on(&mut self, scope: &Instrument, last: Move) {
        let info = scope.gate().info();
        let known = so_far(info.kinematics, &self.views);
        if let (Move::Turn { by_rad }, Some([x, y])) = (last, known.and_then(|k| k.centre_m))
            && self.todo.is_empty()
        {
            let [x_m, y_m, rad] = self.pose_sigma(scope);
            let (sigma, lever_m) = ((x_m.max(y_m), rad), x.hypot(y));
            let reach_m = 1e-6 * self.options.reach_um;
            self.todo = next_turns(self.pitch_m(), sigma, (by_rad, lever_m), reach_m).into();
        }
    }

    fn no_grid(&self, why: NoGrid) -> ServoError {
        ServoError::NoGrid {
            objective: self.objective.id.clone(),
            pitch_um: self.options.pitch_um,
            um_per_px: self.objective.nominal_um_per_px,
            why,
        }
    }

    fn verdict(&self, scope: &Instrument) -> Result<GridReport, ServoError> {
        let (info, camera) = (scope.gate().info(), scope.camera().info());
        let all = (self.views.len() + self.lost_views) as f64;
        let unfollowed = || ServoError::GridUnfollowed {
            objective: self.objective.id.clone(),
            followed: self.views.len(),
            views: self.views.len() + self.lost_views,
            why: self.lost,
        };
        let given = Given {
            objective: &self.objective.id,
            image_size_px: [camera.width, camera.height],
            pitch_m: self.pitch_m(),
            kinematics: info.kinematics,
            pose_sigma: self.pose_sigma(scope),
            views: &self.views,
        };
        let told = told(&given).filter(|_| self.lost_views as f64 <= LOST * all);
        let Told {
            report,
            residual_px,
            explained_px,
        } = told.ok_or_else(unfollowed)?;
        let stretch = report.stage.x.value.abs().max(report.stage.y.value.abs());
        // One pixel is for what the data sheet does not name: vibration, drift, the slide's seat.
        let allowed_px = 1.0 + self.options.residual_factor * explained_px;
        if residual_px > allowed_px || stretch > STRETCH {
            return Err(ServoError::GridStage {
                objective: self.objective.id.clone(),
                pitch_um: self.options.pitch_um,
                residual_px,
                allowed_px,
                stretch,
            });
        }
        Ok(report)
    }

    /// To where it began, by the way by which the first view was reached.
    fn go_home(&self, scope: &Instrument) -> Result<(), ServoError> {
        let (Some(start), goals) = (self.start, scope.gate().goals()?) else {
            return Ok(());
        };
        let via = Some(below(&start, None)).filter(|p| goals.allow(&p.request(&goals.here)));
        for pose in via.iter().chain([&start]) {
            scope.return_to(&pose.request(&goals.here))?;
        }
        Ok(())
    }
}

fn place(start: &PlanarPose, to: Move) -> PlanarPose {
    let mut pose = *start;
    match to {
        Move::Home => {}
        Move::Along { axis, by_m } => pose.x_m[axis] += by_m,
        Move::Turn { by_rad } => pose.theta_rad += by_rad,
    }
    pose
}

impl Procedure for GridCheck {
    type Output = GridReport;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<GridReport>, ServoError> {
        let ended = self.work(scope, sink);
        withdrawn(scope, home_after_an_answer(ended, || self.go_home(scope)))
    }
}
