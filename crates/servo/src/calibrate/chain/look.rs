//! One view: moved to, and registered to the earlier ones that overlap it.

use super::super::joint::{Next, Pair, Role, Taken, View, partners};
use super::Chain;
use super::pair::{Place, pair_of};
use crate::calibrate::told::{ChainPair, ChainView};
use crate::event::tell;
use crate::kinematics::PlanarPose;
use crate::proof::{SEEN_PX, stays};
use crate::vision::{grab, gray, same_objective};
use crate::{Event, FrameRole, ServoError, Sink};
use scopeservo_features::Features;
use scopeservo_registration::{Correspondences, Registration, register_correspondences};
use scopeservo_scope::{Instrument, StagePose};

/// Of the first views all features are kept, until it is known which are fixed to the camera.
const WHOLE: usize = 4;
/// Besides what the stage turns, the images may turn by this against each other, rad.
const TURN_SLACK_RAD: f64 = 0.02;
/// So many features stay in their place of the sensor when the image stays, and so great a share of them.
const STAYED: usize = 12;
const STAYED_SHARE: f64 = 0.3;

impl Chain {
    /// Moves, looks, registers, and learns.
    pub(super) fn look(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        (next, present): (&Next, &StagePose),
    ) -> Result<(), ServoError> {
        if let Some(via) = &next.via {
            scope.move_to(&via.request(present))?;
        }
        let at = scope.move_to(&next.pose.request(present))?;
        let frame = grab(scope, sink, FrameRole::Calibration, &self.objective.id)?;
        let image = gray(scope, &frame)?;
        let count = image.data().len().max(1) as f64;
        self.lit(image.data().iter().map(|v| f64::from(*v)).sum::<f64>() / count)?;
        let features = self.vision.of_view(&image)?;
        self.most_features = self.most_features.max(features.len());
        let index = self.taken.len();
        let (pairs, compared) = self.register(scope, next, &features);
        let surest = compared.first().filter(|c| c.reason.is_none());
        let inliers = surest.map_or(0, |c| c.inliers);
        let place = match pairs.first() {
            Some(pair) => self.places[pair.fixed].map(|fixed| fixed.after(pair)),
            None => (index == 0).then_some(Place::FIRST),
        };
        if index == 0 {
            self.via = next.via;
        }
        self.taken.push(Taken {
            role: next.role,
            asked: next.pose,
            view: View {
                optics: 0,
                reported: PlanarPose::from(&at),
                approach: next.approach,
                time_s: frame.exposure_start.seconds(),
                arrived: next.arrived,
            },
            found: place.is_some(),
        });
        // Of tries of one step the last may have little left to see, when all that stayed is left out.
        self.stayed &= place.is_none();
        self.places.push(place);
        self.pairs.extend(pairs);
        self.keep(features);
        // Along an arm and while it sweeps the path learns nothing new of what it needs.
        if !matches!(next.role, Role::Arm { .. } | Role::Sweep { index: 0..7 }) {
            self.fit = self.solve(scope);
        }
        let event = Event::CalibrationView {
            index,
            stage: at,
            shift_px: place.map(|p| p.centre_px),
            inliers,
            chain: Some(Box::new(ChainView {
                sequence: frame.sequence,
                role: next.role,
                asked: next.pose,
                compared,
            })),
        };
        tell(scope, sink, event);
        Ok(())
    }

    /// Keeps a view's features: the strongest that are not fixed to the camera.
    fn keep(&mut self, features: Features) {
        if self.first.is_none() {
            self.first = Some(features.clone());
        }
        self.features.push(features);
        let from = match self.features.len() {
            0..WHOLE => return,
            WHOLE => 0,
            more => more - 1,
        };
        for k in from..self.features.len() {
            let all = &self.features[k];
            let free = (0..all.len()).filter(|i| !self.fixed.has(&all.keypoints[*i]));
            let strongest: Vec<usize> = free.take(self.options.kept_features).collect();
            self.features[k] = all.subset(&strongest);
        }
    }

    /// The pairs that a view makes with the earlier ones, the surest first, and what is told of all that it was compared with.
    fn register(
        &mut self,
        scope: &Instrument,
        next: &Next,
        view: &Features,
    ) -> (Vec<Pair>, Vec<ChainPair>) {
        let Some(known) = self.known(scope) else {
            return (Vec::new(), Vec::new());
        };
        let found = self.taken.len();
        let others: Vec<(usize, bool)> = partners(&self.options.path, &known, &next.pose)
            .into_iter()
            .map(|k| {
                let moved = known.moves_px(&self.taken[k].asked, &next.pose);
                (k, moved >= SEEN_PX)
            })
            .collect();
        let (mut pairs, mut compared) = (Vec::new(), Vec::new());
        for (fixed, moved) in others {
            let turn_rad = next.pose.theta_rad - self.taken[fixed].asked.theta_rad;
            let (registration, told) = self.against(fixed, view, moved, turn_rad);
            compared.push(told);
            match &registration.outcome {
                Ok(estimate) => {
                    let size_px = [view.width, view.height];
                    pairs.push((
                        registration.inliers,
                        pair_of(estimate, size_px, fixed, found),
                    ));
                }
                Err(reason) => self.last_reason = Some(reason.clone()),
            }
        }
        pairs.sort_by_key(|(inliers, pair)| (usize::MAX - inliers, pair.fixed));
        compared.sort_by_key(|c| (c.reason.is_some(), usize::MAX - c.inliers, c.with));
        // One drawing is enough for each view.
        compared
            .iter_mut()
            .skip(1)
            .for_each(|c| c.places = Vec::new());
        (pairs.into_iter().map(|(_, pair)| pair).collect(), compared)
    }

    /// Registers a view to an earlier one, without what is fixed to the camera: what stays where it is, when the view `moved` for sure;
    /// else what stayed when it did.
    fn against(
        &mut self,
        fixed: usize,
        view: &Features,
        moved: bool,
        turn_rad: f64,
    ) -> (Registration, ChainPair) {
        let options = &self.vision.registration;
        let prior = same_objective(1.5 * turn_rad.abs() + TURN_SLACK_RAD);
        let engine = &*self.vision.engine;
        let all = match Correspondences::of(engine, view, &self.features[fixed], &prior, options) {
            Ok(all) => all,
            Err(reason) => {
                let registration = Registration::not_found(reason, 0);
                let told = ChainPair::of(fixed, &registration, &[]);
                return (registration, told);
            }
        };
        let free = all
            .those(|_, c| !(stays(c) && (moved || self.fixed.holds(c.p_in_b.map(|v| v as f32)))));
        let registration = register_correspondences(&free, &prior, options);
        if moved {
            let stay = all.pairs.iter().filter(|c| stays(c)).count();
            let fewer = view.len().min(self.features[fixed].len());
            self.stayed |= stay >= STAYED && stay as f64 >= STAYED_SHARE * fewer as f64;
            self.fixed.stayed(all.pairs.iter().filter(|c| stays(c)));
        }
        let told = ChainPair::of(fixed, &registration, &all.pairs);
        (registration, told)
    }
}
