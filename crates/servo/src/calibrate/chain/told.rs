//! What the chain tells when it has ended, however it did.

use super::Chain;
use super::sense::standing;
use crate::calibrate::told::ChainPlace;
use crate::kinematics::{PlanarPose, motion_between};
use crate::{Event, Sink, event::tell};
use scopeservo_geometry::{Mat2, Vec2};
use scopeservo_scope::{Instrument, Kinematics};

impl Chain {
    /// Where the views lie, which of them were registered to each other, and which pairs count for nothing.
    pub(super) fn tell_all(&self, scope: &Instrument, sink: &mut dyn Sink) {
        let kinematics = scope.gate().info().kinematics;
        let Some(reference) = self.taken.first().map(|t| t.asked) else {
            return;
        };
        let fit = self.fit.as_ref();
        let centre_m = fit.map(|fit| fit.instrument.optics[0].centre_m);
        let at = |pose: &PlanarPose| looks_at(kinematics, &reference, pose, centre_m);
        let of = self.taken.iter().enumerate().map(|(k, taken)| {
            let off_m = fit.and_then(|fit| {
                let (seen, said) = (
                    at(fit.poses.get(k)?),
                    at(&standing(taken, fit.instrument.backlash)),
                );
                Some([seen[0] - said[0], seen[1] - said[1]])
            });
            ChainPlace {
                at_m: at(&taken.asked),
                off_m,
            }
        });
        let event = Event::ChainEnded {
            objective: self.objective.id.clone(),
            places: of.collect(),
            pairs: self.pairs.iter().map(|p| [p.fixed, p.found]).collect(),
            left_out: fit.map_or(Vec::new(), |fit| fit.left_out.clone()),
        };
        tell(scope, sink, event);
    }
}

/// Where the view's middle lies from that at the reference, as far as the stage has gone, in its axes there, m. Stages that carry the specimen
/// move the view the other way.
fn looks_at(
    kinematics: Kinematics,
    reference: &PlanarPose,
    pose: &PlanarPose,
    centre_m: Option<Vec2>,
) -> Vec2 {
    let Some(eta) = centre_m else {
        return [0, 1].map(|k| pose.x_m[k] - reference.x_m[k]);
    };
    let motion = motion_between(kinematics, reference, pose);
    let turned = Mat2::rotation(motion.alpha_rad) * eta;
    let side = match kinematics {
        Kinematics::MovesMicroscope => 1.0,
        Kinematics::SpecimenRotationOnTop | Kinematics::SpecimenXyOnTop => -1.0,
    };
    [0, 1].map(|k| side * (turned[k] + motion.d_m[k] - eta[k]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::{Motion2, pose_after};

    #[test]
    fn a_turn_about_the_views_middle_leaves_it_where_it_is_on_every_stage() {
        let eta = [0.125, 0.002];
        let reference = PlanarPose {
            x_m: [1e-3, -2e-3],
            theta_rad: 0.0,
        };
        for kinematics in [
            Kinematics::MovesMicroscope,
            Kinematics::SpecimenRotationOnTop,
            Kinematics::SpecimenXyOnTop,
        ] {
            let mut aside = reference;
            aside.x_m = [1.1e-3, -2.05e-3];
            let turned = Mat2::rotation(0.1) * eta;
            let about = Motion2 {
                alpha_rad: 0.1,
                d_m: [0, 1].map(|k| eta[k] - turned[k]),
            };
            let pose = pose_after(kinematics, &aside, &about);
            for pose in [aside, pose] {
                let [x, y] = looks_at(kinematics, &reference, &pose, Some(eta));
                assert!(f64::hypot(x - 1e-4, y + 5e-5) < 1e-12, "{x} {y}");
            }
        }
    }
}
