//! The sum of squares over what all objectives of a microscope say, and its minimum.

use super::link::{Link, Off, STAND, Seen, Stand, angle_beside};
use super::model::{OPTICS, Optics};
use super::single::{SINGLE, SetFit, Shared, Single};
use crate::kinematics::PlanarPose;
use scopeservo_geometry::{Cholesky, Mat2};

/// Rounds of Gauss-Newton at most; all but the links is linear.
const ROUNDS: usize = 8;
/// A step of this share of a standard deviation is none.
const SETTLED: f64 = 1e-6;

/// Where the unknowns stand: the backlash, of each objective the map, the centre and the pose of its first view, the camera's angle, the
/// middle of all centres, and how fast the stage drifts from view to view.
#[derive(Clone, Copy)]
struct Order {
    count: usize,
}

impl Order {
    fn stand(self, objective: usize) -> usize {
        3 + STAND * objective
    }
    fn angle(self) -> usize {
        self.stand(self.count)
    }
    fn drift(self) -> usize {
        self.angle() + 3
    }
    fn all(self) -> usize {
        self.drift() + 2
    }
    /// Where the numbers of a single stand.
    fn single(self, objective: usize) -> Vec<usize> {
        let own = self.stand(objective);
        let drift = self.drift();
        (0..3)
            .chain(own..own + STAND)
            .chain(drift..drift + 2)
            .collect()
    }
}

/// The normal equations with the sum of squares.
struct Sums {
    information: Vec<f64>,
    gradient: Vec<f64>,
    chi_sq: f64,
}

impl Sums {
    fn new(n: usize) -> Self {
        Self {
            information: vec![0.0; n * n],
            gradient: vec![0.0; n],
            chi_sq: 0.0,
        }
    }

    /// Adds `(off + by step)^T certainty (off + by step)`, the columns of `by` each with its unknown.
    fn add<const N: usize>(&mut self, by: &[(usize, [f64; N])], off: &[f64; N], certainty: &[f64]) {
        let n = self.gradient.len();
        let weighed = |v: &[f64; N]| -> [f64; N] {
            std::array::from_fn(|r| (0..N).map(|c| certainty[N * r + c] * v[c]).sum())
        };
        let dot = |a: &[f64; N], b: &[f64; N]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        self.chi_sq += dot(off, &weighed(off));
        for (i, a) in by {
            let a = weighed(a);
            self.gradient[*i] += dot(&a, off);
            for (j, b) in by {
                self.information[n * i + j] += dot(&a, b);
            }
        }
    }
}

/// Free numbers of a covariance, and the inverse over them with zeros elsewhere.
fn certainty(covariance: &[f64], n: usize) -> Option<Vec<f64>> {
    let free: Vec<usize> = (0..n).filter(|k| covariance[n * k + k] > 0.0).collect();
    let m = free.len();
    let own: Vec<f64> = (0..m * m)
        .map(|k| covariance[n * free[k / m] + free[k % m]])
        .collect();
    let inverse = Cholesky::of(&own, m)?.inverse();
    let mut all = vec![0.0; n * n];
    for (k, cell) in inverse.into_iter().enumerate() {
        all[n * free[k / m] + free[k % m]] = cell;
    }
    Some(all)
}

/// What all say, each objective by itself and of the others.
pub(super) struct Whole<'a> {
    pub(super) shared: &'a Shared,
    pub(super) singles: &'a [Single],
    pub(super) links: &'a [Link],
    order: Order,
    /// About which each camera's angle is told.
    pub(super) about: Mat2,
}

impl<'a> Whole<'a> {
    pub(super) fn new(
        shared: &'a Shared,
        singles: &'a [Single],
        links: &'a [Link],
    ) -> Option<Self> {
        let first = singles.first()?.optics.stage_from_pixel;
        Some(Self {
            shared,
            singles,
            links,
            order: Order {
                count: singles.len(),
            },
            about: first.nearest_orthogonal(),
        })
    }

    fn numbers(single: &Single) -> [f64; SINGLE] {
        let [x, y] = single.optics.centre_m;
        let [[a, b], [c, d]] = single.optics.stage_from_pixel.0;
        let [px, py] = single.first.x_m;
        let [bx, by, bt] = single.backlash;
        let [dx, dy] = single.drift;
        let turn = single.first.theta_rad;
        [bx, by, bt, a, b, c, d, x, y, px, py, turn, dx, dy]
    }

    /// Where the search begins: at what each says by itself.
    fn start(&self) -> Vec<f64> {
        let mut at = vec![0.0; self.order.all()];
        let count = self.singles.len() as f64;
        let middle = self.order.angle() + 1;
        for (o, single) in self.singles.iter().enumerate() {
            let numbers = Self::numbers(single);
            for (k, place) in self.order.single(o).into_iter().enumerate() {
                match place < 3 || place >= self.order.drift() {
                    true => at[place] += numbers[k] / count,
                    false => at[place] = numbers[k],
                }
            }
            at[middle] += single.optics.centre_m[0] / count;
            at[middle + 1] += single.optics.centre_m[1] / count;
        }
        at
    }

    pub(super) fn turns(&self) -> bool {
        self.singles.iter().any(|s| s.variance(3 + 4) > 0.0)
    }

    /// Numbers that no measurement has: those of axes that are not there. Without rotation only differences of centres have a meaning.
    fn held(&self) -> Vec<bool> {
        let mut held = vec![true; self.order.all()];
        for (o, single) in self.singles.iter().enumerate() {
            for (k, place) in self.order.single(o).into_iter().enumerate() {
                held[place] &= single.variance(k) <= 0.0;
            }
            if !self.turns() && o > 0 {
                let centre = self.order.stand(o) + 4;
                (held[centre], held[centre + 1]) = (false, false);
            }
        }
        held[self.order.angle()..self.order.drift()].fill(false);
        held
    }

    fn stand(&self, at: &[f64], objective: usize) -> Stand {
        let n = &at[self.order.stand(objective)..][..STAND];
        Stand {
            optics: Optics {
                stage_from_pixel: Mat2([[n[0], n[1]], [n[2], n[3]]]),
                centre_m: [n[4], n[5]],
            },
            pose: PlanarPose {
                x_m: [n[6], n[7]],
                theta_rad: n[8],
            },
        }
    }

    /// How long after the first objective's first view that of another was taken, s.
    pub(super) fn since_s(&self, objective: usize) -> f64 {
        self.singles[objective].time_s - self.singles[0].time_s
    }

    /// What a link shows: poses with what the stage has drifted since the first one.
    fn linked(&self, sums: &mut Sums, at: &[f64], link: &Link) -> Option<()> {
        let (order, both) = (self.order, [link.fixed, link.found]);
        let stands = both.map(|o| {
            let mut stand = self.stand(at, o);
            for k in 0..2 {
                stand.pose.x_m[k] += at[order.drift() + k] * self.since_s(o);
            }
            stand
        });
        let Off { off, by } = link.off(self.shared.kinematics, &stands)?;
        let mut columns: Vec<(usize, Seen)> = Vec::new();
        for (o, by) in both.into_iter().zip(by) {
            let drifts = [0, 1].map(|k| by[OPTICS + k].map(|v| v * self.since_s(o)));
            columns.extend((order.stand(o)..).zip(by));
            columns.extend((order.drift()..).zip(drifts));
        }
        let certainty = certainty(link.covariance.as_flattened(), 4)?;
        sums.add(&columns, &off, &certainty);
        Some(())
    }

    fn sums(&self, at: &[f64]) -> Option<Sums> {
        let order = self.order;
        let n = order.all();
        let mut sums = Sums::new(n);
        for (o, single) in self.singles.iter().enumerate() {
            let places = order.single(o);
            let numbers = Self::numbers(single);
            let off: [f64; SINGLE] = std::array::from_fn(|k| at[places[k]] - numbers[k]);
            let unit = |k: usize| std::array::from_fn(|r| f64::from(u8::from(r == k)));
            let by: Vec<(usize, [f64; SINGLE])> = places
                .iter()
                .enumerate()
                .map(|(k, p)| (*p, unit(k)))
                .collect();
            sums.add(&by, &off, &certainty(&single.covariance, SINGLE)?);
            self.of_camera(&mut sums, at, o);
        }
        // Each single fit was told that there is neither play nor drift; once is enough.
        let drift = [self.shared.drift_m_per_s; 2];
        let told = (0..3).zip(self.shared.backlash);
        for (k, sigma) in told.chain((order.drift()..).zip(drift)) {
            let again = (self.singles.len() - 1) as f64 / (sigma * sigma);
            sums.information[(n + 1) * k] -= again;
            sums.gradient[k] -= again * at[k];
        }
        for link in self.links {
            self.linked(&mut sums, at, link)?;
        }
        for (k, held) in self.held().into_iter().enumerate() {
            if held {
                for j in 0..n {
                    (sums.information[n * k + j], sums.information[n * j + k]) = (0.0, 0.0);
                }
                (sums.information[(n + 1) * k], sums.gradient[k]) = (1.0, 0.0);
            }
        }
        Some(sums)
    }

    /// That an objective has nearly the camera's angle, and looks nearly where all do.
    fn of_camera(&self, sums: &mut Sums, at: &[f64], o: usize) {
        let (order, shared) = (self.order, self.shared);
        let stand = self.stand(at, o);
        let (angle, by_map) = angle_beside(self.about, stand.optics.stage_from_pixel);
        let own = order.stand(o);
        let mut by: Vec<(usize, [f64; 1])> = (own..).zip(by_map.map(|b| [b])).collect();
        by.push((order.angle(), [-1.0]));
        let of_angle = shared.angle_rad.powi(-2);
        sums.add(&by, &[angle - at[order.angle()]], &[of_angle]);
        for k in 0..2 {
            let (centre, middle) = (own + 4 + k, order.angle() + 1 + k);
            let of_centre = shared.parcentric_m.powi(-2);
            let by = [(centre, [1.0]), (middle, [-1.0])];
            sums.add(&by, &[at[centre] - at[middle]], &[of_centre]);
        }
    }

    pub(super) fn solve(&self) -> Option<SetFit> {
        let (order, n) = (self.order, self.order.all());
        let mut at = self.start();
        for _ in 0..ROUNDS {
            let sums = self.sums(&at)?;
            let step = Cholesky::of(&sums.information, n)?.solve(&sums.gradient);
            let mut far = 0.0f64;
            for (k, step) in step.iter().enumerate() {
                at[k] -= step;
                far = far.max(step.abs() * sums.information[(n + 1) * k].sqrt());
            }
            if far < SETTLED {
                break;
            }
        }
        let sums = self.sums(&at)?;
        let covariance = Cholesky::of(&sums.information, n)?.inverse();
        let held = self.held();
        let wanted: Vec<usize> = (0..3)
            .chain((0..order.count).flat_map(|o| order.stand(o)..order.stand(o) + OPTICS))
            .collect();
        let cell = |i: usize, j: usize| match held[i] || held[j] {
            true => 0.0,
            false => covariance[n * i + j],
        };
        // What is known of a drift is hardly more than that there is none.
        let asked = held[..order.drift()].iter().filter(|h| !**h).count();
        let of_single = |s: &Single| (0..SINGLE - 2).filter(|k| s.variance(*k) > 0.0).count();
        let known: usize = self.singles.iter().map(|s| of_single(s) + 3).sum();
        Some(SetFit {
            backlash: [at[0], at[1], at[2]],
            optics: (0..order.count)
                .map(|o| self.stand(&at, o).optics)
                .collect(),
            covariance: wanted
                .iter()
                .flat_map(|i| wanted.iter().map(move |j| cell(*i, *j)))
                .collect(),
            chi_sq: sums.chi_sq,
            freedom: (known + 4 * self.links.len()).saturating_sub(asked),
            left_out: None,
        })
    }
}
