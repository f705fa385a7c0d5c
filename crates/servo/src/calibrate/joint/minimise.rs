//! Levenberg-Marquardt: the unknowns that make the sum of squares least.

use super::equations::Problem;
use super::model::Unknowns;
use scopeservo_geometry::Cholesky;

/// Steps at most; from reported poses it takes four to eight.
const STEPS: usize = 60;
/// A step that lowers chi-square by less changes no digit that anyone reads.
const LEAST_GAIN: f64 = 1e-9;
/// Damping, as a share of each unknown's own information, at first and at most.
const DAMPING: [f64; 2] = [1e-6, 1e6];

/// Where the sum of squares is least, and its value. `None` where the measurements do not determine the unknowns.
pub(super) fn minimise(problem: &Problem, start: Unknowns) -> Option<(Unknowns, f64)> {
    let (mut cost, mut at) = (problem.cost(&start)?, start);
    let mut damping = DAMPING[0];
    for _ in 0..STEPS {
        let normal = problem.normal(&at)?;
        let n = normal.gradient.len();
        loop {
            let mut damped = normal.information.clone();
            for k in 0..n {
                damped[k * n + k] *= 1.0 + damping;
            }
            let downhill: Vec<f64> = normal.gradient.iter().map(|g| -g).collect();
            let step = Cholesky::of(&damped, n)?.solve(&downhill);
            let expected: f64 = step.iter().zip(&downhill).map(|(s, d)| s * d).sum();
            if expected < LEAST_GAIN {
                return Some((at, cost));
            }
            let next = at.plus(&step);
            match problem.cost(&next) {
                Some(lower) if lower <= cost => {
                    (at, cost) = (next, lower);
                    damping = (damping / 10.0).max(1e-12);
                    break;
                }
                _ if damping > DAMPING[1] => return Some((at, cost)),
                _ => damping *= 10.0,
            }
        }
    }
    Some((at, cost))
}
