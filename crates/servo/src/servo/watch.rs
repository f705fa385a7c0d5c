//! The camera as an encoder: how the promises of moves were kept, and what follows of it.

use super::promise::{DRIFTED_CENTRE_M, Fits, Kept, Mover, Promise, Promised};
use super::refit::{Refit, Remark};
use crate::attempt::Tried;
use crate::{Attempt, Calibration, Contradiction, PlanarPose, PoseError, PoseEstimate, Velocity};
use scopeservo_geometry::Vec2;
use scopeservo_scope::{Axis, Instrument, ObjectiveId};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// How far moves are trusted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Trust {
    /// As far as the calibration supports them.
    #[default]
    Whole,
    /// A move has lost the target, and the stage went back. The next one is a small step of x and y, which shows them alone.
    Shift,
    /// They do what they are to do: the next one turns a little, which shows the rotation centre.
    Turn,
    /// That is known as well.
    Regained,
}

impl Trust {
    fn after_a_change(self) -> Self {
        match self {
            Self::Shift | Self::Turn => self,
            Self::Whole | Self::Regained => Self::Whole,
        }
    }
}

/// The last promise, and how those before it were kept.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Watch {
    pub(crate) promise: Option<Promise>,
    /// Promises in a row that were not kept, and why, where something was seen of it.
    broken: Option<(u8, Option<Contradiction>)>,
    /// How well each cause explains the last of them.
    #[serde(default, rename = "explained")]
    fits: Option<Fits>,
    #[serde(default)]
    trust: Trust,
    /// Frames since the last move in which nothing had moved yet.
    #[serde(default)]
    looks: u8,
    /// The promise is that of another leg, and says nothing of this one's calibration.
    #[serde(default)]
    handed: bool,
    /// The target may only be out of this leg's view: who goes back loses what the next one is about to see.
    #[serde(default)]
    stays: bool,
    #[serde(default)]
    refit: Refit,
    /// What was seen of the instrument, and went on.
    #[serde(default)]
    remarks: Vec<Remark>,
    /// What loops tried in this run.
    #[serde(default)]
    tried: Tried,
}

/// A small step moves the view by this share of its shorter side: x and y of the stage by these shares of it, which are not the same.
const SMALL: f64 = 0.1;
const BOTH: [f64; 2] = [0.86, 0.51];

/// So many times its arrival tolerance an axis stands from where it was sent, at most.
const ARRIVALS: f64 = 2.0;
/// So many moves in a row may contradict what is seen before nothing moves any more.
const BROKEN: u8 = 2;
/// So many more frames are looked at before it is said that nothing moved.
const LOOKS: u8 = 8;

/// What lies beside a way by less than this share of how far it is off lies on its line.
const ON_LINE: f64 = 0.25;

/// By how much of its way a view went too far, where it ended on the line that it was to go.
fn share_of_way(way_m: Vec2, off_m: Vec2) -> Option<f64> {
    let ([x, y], [a, b]) = (way_m, off_m);
    let (along, across) = (x * a + y * b, x * b - y * a);
    let far_sq = x * x + y * y;
    (across.abs() < ON_LINE * f64::hypot(along, across)).then_some(along / far_sq)
}

impl Watch {
    /// In another leg. `first`: its objective has not seen the target yet.
    pub(crate) fn handed_over(self, first: bool) -> Self {
        let wary = self.is_wary();
        Self {
            promise: self.promise,
            broken: self.broken,
            fits: self.fits,
            handed: self.promise.is_some(),
            stays: first && self.promise.is_some(),
            // Where it went back before, it goes on in small steps.
            trust: self.trust.after_a_change(),
            refit: Refit::doubting(wary),
            tried: self.tried,
            ..Self::default()
        }
    }

    /// Where the last move was to lead, unless a frame has shown it already.
    pub(crate) fn promised(&self, mover: &Mover<'_>) -> Option<Promised> {
        self.promise.as_ref().map(|promise| promise.told(mover))
    }

    /// Forgets where the last move was to lead when the stage says that it stands elsewhere: the program was killed in the next one.
    pub(crate) fn forgets_elsewhere(&mut self, stands: &PlanarPose, scope: &Instrument) {
        let axes = [Axis::X, Axis::Y, Axis::Rz];
        // A move that ended as it should ended within its tolerance.
        let most = axes.map(|axis| {
            let info = scope.gate().info().axis(axis);
            info.map_or(f64::INFINITY, |info| ARRIVALS * info.tolerance())
        });
        if self
            .promise
            .take_if(|promise| !promise.leads_to(stands, most))
            .is_some()
        {
            (self.looks, self.handed) = (0, false);
        }
    }

    /// Takes the next frame.
    pub(crate) fn see(
        &mut self,
        seen: &PoseEstimate,
        mover: &Mover<'_>,
        view_m: f64,
    ) -> Option<Kept> {
        self.stays = false;
        let promise = self.promise.take()?;
        let kept = promise.kept(seen, mover, view_m);
        let looks = std::mem::take(&mut self.looks);
        let handed = std::mem::take(&mut self.handed);
        match kept {
            Kept::No(Contradiction::NothingMoved) if looks < LOOKS => {
                (self.promise, self.looks, self.handed) = (Some(promise), looks + 1, handed);
                return Some(Kept::NotYet);
            }
            Kept::No(why) => {
                let fits = promise.fits(seen, mover, view_m);
                let both = self.fits.as_ref().and_then(|first| fits.both(first));
                self.breaks(Some(why));
                // What explains both moves is better than what explains each.
                if let Some((_, named)) = self.broken.as_mut().filter(|_| both.is_some()) {
                    *named = both;
                }
                self.fits = Some(fits);
            }
            // It moved, and was not shown at once.
            _ if looks > 0 => self.broken = Some((BROKEN, Some(Contradiction::Late(looks)))),
            _ => {
                self.mends(&mover.view.objective);
                let (way_m, off_m, lever) = promise.tells(&seen.error, mover);
                match handed {
                    // It was another objective's calibration that made it.
                    true if kept == Kept::Drifted => self.remarks.push(Remark::Beside {
                        objective: mover.view.objective.clone(),
                        um: 1e6 * f64::hypot(off_m[0], off_m[1]),
                        share_of_way: share_of_way(way_m, off_m),
                    }),
                    true => {}
                    false => {
                        let [a, b, _] = seen.sigma();
                        let sigma_m = f64::hypot(promise.sigma_m, f64::hypot(a, b));
                        self.refit.take(way_m, off_m, lever, sigma_m);
                    }
                }
                // Where a move has lost the target less is promised, and what is off shows in the fit; so it does where each of several moves
                // was within what is uncertain, and all of them went wrong alike.
                let shows = kept == Kept::Drifted || self.refit.shows(mover.view);
                let drifts = shows && !handed;
                if drifts && !std::mem::replace(&mut self.refit.drifted, true) {
                    self.remarks
                        .extend(self.refit.remark(&mover.view.objective));
                }
            }
        }
        Some(kept)
    }

    fn breaks(&mut self, why: Option<Contradiction>) {
        let (count, first) = self.broken.unwrap_or_default();
        let both = first.zip(why).map(|(first, why)| first.and(why));
        self.broken = Some((count + 1, both.or(why).or(first)));
    }

    fn mends(&mut self, objective: &ObjectiveId) {
        match self.trust {
            // Of what lost the target x and y are cleared, and no more.
            Trust::Shift => {
                self.trust = Trust::Turn;
                return;
            }
            Trust::Turn => self.trust = Trust::Regained,
            Trust::Whole | Trust::Regained => {}
        }
        self.fits = None;
        if let Some((_, why)) = self.broken.take() {
            self.remarks.push(Remark::Contradicted {
                objective: objective.clone(),
                why: why.map_or(Contradiction::Elsewhere, Contradiction::once),
            });
        }
    }

    /// Takes a scale that is not that of the calibrations.
    pub(crate) fn scaled(&mut self, objective: &ObjectiveId, factor: f64) {
        let objective = objective.clone();
        self.remarks
            .push(Remark::ScalesDisagree { objective, factor });
    }

    /// Takes an attempt; whether it is the first of its kind.
    pub(crate) fn tries(&mut self, objective: &ObjectiveId, attempt: &Attempt) -> bool {
        let first = self.tried.first(attempt);
        if first {
            self.remarks.push(Remark::Tried {
                objective: objective.clone(),
                attempt: attempt.clone(),
            });
        }
        first
    }

    /// What was seen of the instrument, as it is known now, in the order in which it was seen.
    pub(crate) fn remarks(&self) -> Vec<Remark> {
        let now = |remark: &Remark| match remark {
            Remark::Drifted { objective, .. } => self.refit.remark(objective),
            _ => None,
        };
        let all = self.remarks.iter();
        all.map(|r| now(r).unwrap_or_else(|| r.clone())).collect()
    }

    /// A calibration as well as moves have shown it to be known.
    pub(crate) fn believed<'a>(&self, view: &'a Calibration) -> Cow<'a, Calibration> {
        self.refit.believed(view)
    }

    /// Why the last move did not do what it was to do, where that shows.
    pub(crate) fn suspects(&self) -> Option<Contradiction> {
        let named = self.broken.and_then(|(_, why)| why);
        named.filter(|why| *why != Contradiction::Elsewhere)
    }

    /// Where to go back to, after a move by which the target was lost; once.
    pub(crate) fn turns_back(&mut self) -> Option<(PlanarPose, PoseError)> {
        let may = self.trust == Trust::Whole && !self.stays;
        let promise = self.promise.take_if(|_| may)?;
        (self.trust, self.handed) = (Trust::Shift, false);
        self.refit.doubted = true;
        self.breaks(None);
        Some((promise.before, promise.from))
    }

    /// Where to go back to, after a move by which all was lost: nothing is in focus there.
    pub(crate) fn led_astray(&mut self) -> Option<PlanarPose> {
        self.stays = false;
        self.turns_back().map(|(before, _)| before)
    }

    /// The stage went back, and the target is not seen any more, there or after a small step: what contradicts the moves.
    pub(crate) fn not_there_any_more(&self) -> Option<Contradiction> {
        self.is_wary().then(|| self.why())
    }

    /// Whether the last moves did what they were to do: only then may another objective take over.
    pub(crate) fn trusts(&self) -> bool {
        !self.is_wary() && self.broken.is_none()
    }

    /// Whether a move was lost, and the next ones are small and only show what moves do.
    pub(crate) fn is_wary(&self) -> bool {
        matches!(self.trust, Trust::Shift | Trust::Turn)
    }

    /// As much of a velocity as may be tried: the first of these that the stage can take. A small step shows what moves do whichever way it goes.
    pub(crate) fn limited(&self, velocity: Velocity, view: &Calibration) -> [Velocity; 4] {
        let reach_m = SMALL * view.shorter_side_m();
        let theta_rad = velocity.theta_rad;
        match self.trust {
            Trust::Whole | Trust::Regained => [velocity; 4],
            Trust::Shift => {
                let camera = view.stage_from_camera();
                let way = camera * velocity.t_m;
                let small = [0, 1].map(|k| way[k].signum() * BOTH[k] * reach_m);
                let signs = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];
                signs.map(|sign| Velocity {
                    t_m: camera.transpose() * [0, 1].map(|k| sign[k] * small[k]),
                    theta_rad: 0.0,
                })
            }
            Trust::Turn => {
                // The view stays there whether the rotation stands, or x and y that go with it, or the centre is elsewhere.
                let centre_m = view.rotation_centre_m.unwrap_or_default();
                let lever_m = f64::hypot(centre_m[0], centre_m[1]).max(DRIFTED_CENTRE_M);
                let most_rad = reach_m / lever_m;
                match theta_rad.abs() > most_rad {
                    // It turns and does nothing else: what it leaves is seen for what it is.
                    true => [1.0, -1.0, 1.0, -1.0].map(|sign| Velocity {
                        t_m: [0.0; 2],
                        theta_rad: sign * theta_rad.signum() * most_rad,
                    }),
                    false => [velocity; 4],
                }
            }
        }
    }

    fn why(&self) -> Contradiction {
        let why = self.broken.and_then(|(_, why)| why);
        why.unwrap_or(Contradiction::Elsewhere)
    }

    /// Why nothing may move any more.
    pub(crate) fn stops(&self) -> Option<Contradiction> {
        let broken = self.broken.filter(|(count, _)| *count >= BROKEN);
        broken.map(|_| self.why())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_ends_on_its_line_is_told_as_a_share_of_its_way() {
        let way_m = [3e-4, -4e-4];
        let of = |off_m| share_of_way(way_m, off_m);
        let is = |share: Option<f64>, right: f64| share.is_some_and(|s| (s - right).abs() < 1e-9);
        assert!(is(of([-3e-5, 4e-5]), -0.1), "a tenth short");
        assert!(is(of([6e-5, -8e-5]), 0.2), "a fifth too far");
        assert!(of([-2.5e-5, 4.4e-5]).is_some_and(|s| (s + 0.1).abs() < 0.01));
        assert_eq!(of([4e-5, 3e-5]), None, "aside");
        assert_eq!(of([-7e-5, 1e-5]), None, "half aside");
        assert_eq!(share_of_way([0.0; 2], [1e-5, 0.0]), None, "no way");
    }
}
