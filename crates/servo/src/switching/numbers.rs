//! From where each arrival looked to offsets and scatter, with their uncertainty.

use crate::Known;
use scopeservo_geometry::Vec2;
use scopeservo_scope::ObjectiveId;
use serde::{Deserialize, Serialize};

/// Heights of the second objective beside the first.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FocusSwitch {
    /// The stage's z at which the second objective is in focus less that of the first, um.
    pub offset_um: Known,
    /// Standard deviation of where one arrival focuses, um.
    pub repeatability_um: Known,
}

/// What switching between two objectives has shown. Lengths are in the stage's axes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SwitchingReport {
    /// The first objective.
    pub from: ObjectiveId,
    /// The second.
    pub to: ObjectiveId,
    /// How often each came.
    pub arrivals: [usize; 2],
    /// Where the centre of the second one's view lies beside that of the first, x and y, um: the mean.
    pub offset_um: [Known; 2],
    /// Standard deviation of where one arrival looks, x and y, um: of the nosepiece, and of what the stage's retreat and return add to it.
    pub repeatability_um: [Known; 2],
    /// Standard deviation of the angle of one arrival, deg.
    pub repeatability_deg: Known,
    /// The same along z, where the stage has it.
    pub focus: Option<FocusSwitch>,
}

/// No nosepiece is off by more, um.
const MOST_UM: f64 = 5000.0;

impl SwitchingReport {
    /// Whether these can be the numbers of a nosepiece.
    pub fn is_possible(&self) -> bool {
        let focus = self.focus.iter();
        let focus = focus.flat_map(|f| [f.offset_um, f.repeatability_um]);
        let mut all = self
            .offset_um
            .into_iter()
            .chain(self.repeatability_um)
            .chain(focus);
        // What is no number is not within either.
        all.all(|k| k.value.abs() <= MOST_UM && (0.0..=MOST_UM).contains(&k.sigma))
    }

    /// What one later switch is expected to do to the view's centre, um, with the standard deviation of each coordinate: the mean's, and the
    /// scatter of the two arrivals.
    pub fn expected_um(&self) -> [Known; 2] {
        [0, 1].map(|k| {
            let (mean, one) = (self.offset_um[k], self.repeatability_um[k].value);
            Known {
                value: mean.value,
                sigma: mean.sigma.hypot(2f64.sqrt() * one),
            }
        })
    }

    /// The same along z.
    pub fn expected_focus_um(&self) -> Option<Known> {
        let focus = self.focus.as_ref()?;
        let one = focus.repeatability_um.value;
        Some(Known {
            value: focus.offset_um.value,
            sigma: focus.offset_um.sigma.hypot(2f64.sqrt() * one),
        })
    }
}

/// One arrival of an objective.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Arrival {
    /// Whether it is the second objective.
    pub(super) second: bool,
    /// Where the centre of its view lies in the reference's, stage axes, um, and its standard deviation.
    pub(super) centre_um: Vec2,
    pub(super) sigma_um: f64,
    /// How its view is turned against the reference, rad.
    pub(super) angle_rad: f64,
    /// Where it was in focus, um, and its standard deviation.
    pub(super) focus_um: Option<[f64; 2]>,
}

/// What two samples of arrivals say: the second's mean less the first's, and the standard deviation of one arrival. What looking is off by
/// is in both: the same specimen is looked at each time, so that most of it is the same as well, and `common` is what no mean makes
/// smaller.
fn compare(first: &[f64], second: &[f64], common: f64) -> (Known, Known) {
    let mean = |s: &[f64]| s.iter().sum::<f64>() / s.len() as f64;
    let squares = |s: &[f64]| {
        let middle = mean(s);
        s.iter().map(|v| (v - middle).powi(2)).sum::<f64>()
    };
    let freedom = (first.len() + second.len() - 2) as f64;
    let seen = (squares(first) + squares(second)) / freedom;
    let share = 1.0 / first.len() as f64 + 1.0 / second.len() as f64;
    let offset = Known {
        value: mean(second) - mean(first),
        sigma: (seen * share).sqrt().hypot(common),
    };
    let scatter = Known {
        value: seen.sqrt(),
        sigma: (seen / (2.0 * freedom)).sqrt(),
    };
    (offset, scatter)
}

/// What arrivals show; `None` where an objective was not seen to come twice. `scale_sigma` is what the reference's scale and angle are
/// uncertain by, relative.
pub(super) fn report(
    [from, to]: [&ObjectiveId; 2],
    arrivals: &[Arrival],
    scale_sigma: f64,
) -> Option<SwitchingReport> {
    let of = |second: bool, number: &dyn Fn(&Arrival) -> f64| -> Vec<f64> {
        let those = arrivals.iter().filter(|a| a.second == second);
        those.map(number).collect()
    };
    let counts = [false, true].map(|second| of(second, &|a| a.sigma_um).len());
    if counts.iter().any(|&count| count < 2) {
        return None;
    }
    let worst = |number: &dyn Fn(&Arrival) -> f64| arrivals.iter().map(number).fold(0.0, f64::max);
    let compared = |number: &dyn Fn(&Arrival) -> f64, common: f64| {
        compare(&of(false, number), &of(true, number), common)
    };
    let looking_um = worst(&|a| a.sigma_um);
    let centres = [0, 1].map(|k| {
        let (mut offset, scatter) = compared(&|a: &Arrival| a.centre_um[k], looking_um);
        offset.sigma = offset.sigma.hypot(scale_sigma * offset.value);
        (offset, scatter)
    });
    let (_, turn) = compared(&|a| a.angle_rad.to_degrees(), 0.0);
    let all_focused = arrivals.iter().all(|a| a.focus_um.is_some());
    let focus = all_focused.then(|| {
        let focus_um = |k: usize| move |a: &Arrival| a.focus_um.unwrap_or_default()[k];
        // Blur that is not the same above and below is the same each time.
        let (offset_um, repeatability_um) = compared(&focus_um(0), worst(&focus_um(1)));
        FocusSwitch {
            offset_um,
            repeatability_um,
        }
    });
    Some(SwitchingReport {
        from: from.clone(),
        to: to.clone(),
        arrivals: counts,
        offset_um: centres.map(|(offset, _)| offset),
        repeatability_um: centres.map(|(_, scatter)| scatter),
        repeatability_deg: turn,
        focus,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::SplitMix64;

    #[test]
    fn offset_and_scatter_of_drawn_arrivals_lie_within_what_is_stated_as_often_as_they_should() {
        const ROUNDS: usize = 400;
        let (truth, scatter) = (12.0, 1.5);
        let mut rng = SplitMix64::new(3);
        for common in [0.0, 1.0] {
            let (mut offset_in, mut scatter_in, mut mean) = (0, 0, 0.0);
            for _ in 0..ROUNDS {
                let off = common * rng.normal();
                let mut sample = |middle: f64| -> Vec<f64> {
                    (0..6).map(|_| middle + scatter * rng.normal()).collect()
                };
                let (first, second) = (sample(-3.0), sample(truth - 3.0 + off));
                let (offset, one) = compare(&first, &second, common);
                offset_in += usize::from((offset.value - truth).abs() <= 2.0 * offset.sigma);
                scatter_in += usize::from((one.value - scatter).abs() <= 2.0 * one.sigma);
                mean += one.value / ROUNDS as f64;
            }
            // Of ten degrees of freedom: Student's 2 sigma hold 92.7 %, a normal distribution's 95.4 %.
            let share = |count: usize| count as f64 / ROUNDS as f64;
            assert!((0.89..=0.98).contains(&share(offset_in)), "{offset_in}");
            assert!((0.86..=0.98).contains(&share(scatter_in)), "{scatter_in}");
            assert!((mean / scatter - 1.0).abs() < 0.06, "{mean}");
        }
    }
}
