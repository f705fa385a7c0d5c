//! From displacements that were seen to what of a calibration has changed, and what that means.

use crate::hand_eye::{Observation, covariance, solve_hand_eye};
use crate::{Calibration, EXAMPLE_MOVE, PlanarPose};
use scopeservo_geometry::{Cholesky, Mat2, Vec2};
use scopeservo_scope::{Kinematics, ObjectiveId};
use serde::{Deserialize, Serialize};

/// A change is there when one as large comes by chance as seldom as three standard deviations of one number: normal deviate, one-sided.
const SURE: f64 = 2.782;
/// Up to these a servo still converges: relative, rad, m.
const SCALE: f64 = 0.1;
const ANGLE_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;
const CENTRE_M: f64 = 2e-3;
/// What is not known to within these limits by so many standard deviations cannot be judged.
const SIGMAS: f64 = 3.0;

/// A number of a calibration that may have changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Changing {
    /// The size of a pixel, percent.
    ScalePercent,
    /// phi; of a mirrored image the direction of its x in the stage's axes. Degrees.
    AngleDeg,
    /// How much more x is stretched than y, in stage axes, percent.
    StretchPercent,
    /// How far stage x and y have gone off a right angle, degrees.
    SquareDeg,
    /// Where the image's centre lies from the axis of rotation, x, um.
    CentreXUm,
    /// And y.
    CentreYUm,
}

/// How one number has changed: what was seen less what the calibration says.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Which, with its unit.
    pub what: Changing,
    /// By how much.
    pub by: f64,
    /// Standard deviation, of what was seen and of the calibration together.
    pub sigma: f64,
}

impl Change {
    /// The change in standard deviations.
    pub fn sigmas(&self) -> f64 {
        self.by.abs() / self.sigma
    }
}

/// What a self-test says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SelfTestVerdict {
    /// Nothing has changed that was seen, or nothing that matters for a move.
    Good,
    /// Something has; a run still converges. Calibrate soon.
    Drifted,
    /// It is of no use any more: calibrate.
    Replace,
}

/// Why a calibration is of no use, beyond numbers that are too far off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Broken {
    /// The image is mirrored against the stage, and by the calibration it is not, or the other way round.
    OtherHand,
    /// The view was lost however little the stage turned: the axis of rotation lies elsewhere, or the rotation does not do what it says.
    CentreLost,
}

/// What a self-test of one objective found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SelfTestReport {
    /// The objective.
    pub objective: ObjectiveId,
    /// What it means.
    pub verdict: SelfTestVerdict,
    /// Why it is of no use, where that is no number.
    pub broken: Option<Broken>,
    /// What was measured: four numbers of the map, and two of the rotation centre where the stage was turned. None of a map of the other hand.
    pub changes: Vec<Change>,
    /// All of them together, `d^T C^-1 d`.
    pub chi_square: f64,
    /// How far the example move would end from where it should by these changes alone, um.
    pub misses_um: f64,
    /// How far it is expected to end off by a calibration that holds, um.
    pub expected_error_um: f64,
}

impl SelfTestReport {
    /// One of the changes.
    pub fn change(&self, what: Changing) -> Option<&Change> {
        self.changes.iter().find(|c| c.what == what)
    }

    /// Those that are more than three standard deviations; the surest one where none is.
    pub fn sure_changes(&self) -> Vec<Change> {
        let sure = |c: &&Change| c.sigmas() > SIGMAS;
        let all: Vec<Change> = self.changes.iter().filter(sure).copied().collect();
        let surest = || {
            let by = |a: &&Change, b: &&Change| a.sigmas().total_cmp(&b.sigmas());
            self.changes.iter().max_by(by).copied()
        };
        match all.is_empty() {
            true => surest().into_iter().collect(),
            false => all,
        }
    }
}

/// What was seen from a reference view.
pub(super) struct Evidence<'a> {
    pub(super) kinematics: Kinematics,
    pub(super) reference: PlanarPose,
    pub(super) translations: &'a [Observation],
    pub(super) rotations: &'a [Observation],
    /// Standard deviations of arrivals: m, m, rad.
    pub(super) pose_sigma: [f64; 3],
    /// Whether the view was lost on turning.
    pub(super) lost_turning: bool,
}

/// What cannot be told: the standard deviation of the scale, percent, infinite where there is none.
pub(super) struct TooCoarse(pub(super) f64);

/// Compares what was seen with a calibration.
pub(super) fn report(c: &Calibration, seen: &Evidence) -> Result<SelfTestReport, TooCoarse> {
    let none = || TooCoarse(f64::INFINITY);
    let (k, reference) = (seen.kinematics, &seen.reference);
    let (map, centre_m, _) =
        solve_hand_eye(k, reference, seen.translations, seen.rotations).ok_or_else(none)?;
    let map = map.inverse().ok_or_else(none)?;
    let by_views = covariance(
        k,
        reference,
        seen.translations,
        seen.rotations,
        seen.pose_sigma,
    );
    let by_views = by_views.ok_or_else(none)?;
    let kept = c.covariance.unwrap_or_default();
    let both: [[f64; 6]; 6] =
        std::array::from_fn(|i| std::array::from_fn(|j| by_views[i][j] + kept[i][j]));
    let expected_error_um = expected_error_um(c, seen.pose_sigma).ok_or_else(none)?;
    let off_m = c
        .rotation_centre_m
        .zip(centre_m)
        .map(|(was, is)| [0, 1].map(|k| is[k] - was[k]));
    let ratio = map * c.pixel_from_stage().ok_or_else(none)?;
    let mut report = SelfTestReport {
        objective: c.objective.clone(),
        verdict: SelfTestVerdict::Replace,
        broken: Some(Broken::OtherHand),
        changes: Vec::new(),
        chi_square: chi_square(&(map - c.stage_from_pixel), off_m, &both).ok_or_else(none)?,
        misses_um: misses_um(&ratio, off_m),
        expected_error_um,
    };
    if ratio.det() <= 0.0 {
        return Ok(report);
    }
    report.broken = seen.lost_turning.then_some(Broken::CentreLost);
    report.changes = changes(c, &map, off_m, &both).ok_or_else(none)?;
    let known = report
        .changes
        .iter()
        .all(|c| SIGMAS * c.sigma <= most(c.what));
    if !known && report.chi_square <= limit(report.changes.len()) {
        return Err(TooCoarse(report.changes[0].sigma));
    }
    report.verdict = verdict(&report);
    Ok(report)
}

/// How a later calibration of an objective differs from an earlier one, by what both know of themselves; `None` where one does not, or where
/// they are of opposite hands.
pub fn changes_between(before: &Calibration, after: &Calibration) -> Option<Vec<Change>> {
    let (a, b) = (before.covariance?, after.covariance?);
    let both = std::array::from_fn(|i| std::array::from_fn(|j| a[i][j] + b[i][j]));
    let centres = before.rotation_centre_m.zip(after.rotation_centre_m);
    let off_m = centres.map(|(was, is)| [0, 1].map(|k| is[k] - was[k]));
    changes(before, &after.stage_from_pixel, off_m, &both)
}

/// Up to how much a change leaves a calibration that a servo converges with.
fn most(what: Changing) -> f64 {
    match what {
        Changing::ScalePercent | Changing::StretchPercent => 100.0 * SCALE,
        Changing::AngleDeg | Changing::SquareDeg => ANGLE_RAD.to_degrees(),
        Changing::CentreXUm | Changing::CentreYUm => 1e6 * CENTRE_M,
    }
}

fn verdict(report: &SelfTestReport) -> SelfTestVerdict {
    // All together, and one of them by itself.
    let sure = report.changes.iter().any(|c| c.sigmas() > SIGMAS);
    let seen = sure && report.chi_square > limit(report.changes.len());
    if report.broken.is_some() {
        SelfTestVerdict::Replace
    } else if !seen || report.misses_um < report.expected_error_um {
        SelfTestVerdict::Good
    } else if report.changes.iter().all(|c| c.by.abs() <= most(c.what)) {
        SelfTestVerdict::Drifted
    } else {
        SelfTestVerdict::Replace
    }
}

/// The chi-square that so many numbers exceed by chance once in 370 times (Wilson and Hilferty).
fn limit(freedom: usize) -> f64 {
    let n = freedom as f64;
    let part = 2.0 / (9.0 * n);
    n * (1.0 - part + SURE * part.sqrt()).powi(3)
}

/// `d^T C^-1 d` of all numbers.
fn chi_square(map: &Mat2, centre_m: Option<Vec2>, covariance: &[[f64; 6]; 6]) -> Option<f64> {
    let [[a, b], [c, d]] = map.0;
    let off: Vec<f64> = [a, b, c, d]
        .into_iter()
        .chain(centre_m.into_iter().flatten())
        .collect();
    let n = off.len();
    let rows: Vec<f64> = (0..n * n).map(|i| covariance[i / n][i % n]).collect();
    let solved = Cholesky::of(&rows, n)?.solve(&off);
    let sum: f64 = off.iter().zip(&solved).map(|(a, b)| a * b).sum();
    sum.is_finite().then_some(sum)
}

/// Scale, angle (rad), stretch and shear (rad) of `ratio = map_seen map_kept^-1`.
fn parts(ratio: &Mat2) -> Option<[f64; 4]> {
    let turn_rad = ratio.rotation_angle()?;
    let Mat2([[xx, xy], [yx, yy]]) = Mat2::rotation(-turn_rad) * *ratio;
    let mean = (xx + yy) / 2.0;
    Some([
        ratio.det().sqrt() - 1.0,
        turn_rad,
        (xx - yy) / mean,
        (xy + yx) / mean,
    ])
}

fn changes(
    c: &Calibration,
    map: &Mat2,
    centre_m: Option<Vec2>,
    covariance: &[[f64; 6]; 6],
) -> Option<Vec<Change>> {
    let inverse = c.pixel_from_stage()?;
    // phi of Eq. (3) counts the other way than the stage's axes.
    let sign = c.reading().map_or(1.0, |_| -1.0);
    let units = [
        100.0,
        sign * 180.0 / std::f64::consts::PI,
        100.0,
        180.0 / std::f64::consts::PI,
    ];
    let by = parts(&(*map * inverse))?;
    let step = 1e-6 * map.frobenius();
    let mut by_cell = [[0.0; 4]; 4];
    for (k, parts_by) in by_cell.iter_mut().enumerate() {
        let at = |sign: f64| {
            let mut moved = *map;
            moved.0[k / 2][k % 2] += sign * step;
            parts(&(moved * inverse))
        };
        let (up, down) = (at(1.0)?, at(-1.0)?);
        *parts_by = std::array::from_fn(|q| (up[q] - down[q]) / (2.0 * step));
    }
    let sigma = |g: &[f64; 4]| {
        let variance: f64 = (0..16)
            .map(|i| g[i / 4] * covariance[i / 4][i % 4] * g[i % 4])
            .sum();
        variance.max(0.0).sqrt()
    };
    let what = [
        Changing::ScalePercent,
        Changing::AngleDeg,
        Changing::StretchPercent,
        Changing::SquareDeg,
    ];
    let of_map = (0..4).map(|q| Change {
        what: what[q],
        by: units[q] * by[q],
        sigma: units[q].abs() * sigma(&by_cell.map(|parts_by| parts_by[q])),
    });
    let of_centre = centre_m.into_iter().flat_map(|off_m| {
        [Changing::CentreXUm, Changing::CentreYUm]
            .into_iter()
            .enumerate()
            .map(move |(k, what)| Change {
                what,
                by: 1e6 * off_m[k],
                sigma: 1e6 * covariance[4 + k][4 + k].sqrt(),
            })
    });
    Some(of_map.chain(of_centre).collect())
}

/// How far the example move ends off with a map that is wrong by `ratio`, whatever its direction, and a rotation centre that is off.
fn misses_um(ratio: &Mat2, off_m: Option<Vec2>) -> f64 {
    let (moved_m, turned_rad) = EXAMPLE_MOVE;
    let by_map = (*ratio - Mat2::IDENTITY).frobenius() / 2f64.sqrt() * moved_m;
    let by_centre = off_m.map_or(0.0, |[x, y]| x.hypot(y) * turned_rad);
    1e6 * by_map.hypot(by_centre)
}

/// What a calibration says of itself; of one that does not know, what the stage scatters.
fn expected_error_um(c: &Calibration, pose_sigma: [f64; 3]) -> Option<f64> {
    let whole = Calibration {
        covariance: c.covariance.or(Some([[0.0; 6]; 6])),
        scatter: c.scatter.or(Some(pose_sigma)),
        ..c.clone()
    };
    whole.expected_error_um()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_is_that_of_three_standard_deviations() {
        // By tables of chi-square at 0.9973.
        for (n, table) in [(4, 16.25), (6, 20.06)] {
            assert!((limit(n) / table - 1.0).abs() < 0.01, "{}", limit(n));
        }
    }

    #[test]
    fn a_map_is_taken_apart_into_scale_angle_stretch_and_shear() {
        let ratio = Mat2::rotation(0.03) * Mat2([[1.05, 0.001], [0.001, 1.03]]);
        let [scale, angle, stretch, shear] = parts(&ratio).unwrap();
        assert!((scale - 0.03995).abs() < 1e-4);
        assert!((angle - 0.03).abs() < 1e-12);
        assert!((stretch - 0.02 / 1.04).abs() < 1e-12);
        assert!((shear - 0.002 / 1.04).abs() < 1e-12);
    }
}
