//! A world of numbers: a stage with play and scatter, optics, and what registrations of its views would say. Its equations are its own.

use scopeservo_geometry::{Mat2, SplitMix64, Vec2};
use scopeservo_scope::Kinematics;
use scopeservo_servo::PlanarPose;
use scopeservo_servo::joint::{
    JointFit, Known, Link, Optics, Pair, PathOptions, Priors, Role, Taken, View, fit, next_view,
    partners,
};

/// The paper's hexapod, its +-0.15 um and +-3 urad taken as standard deviations.
pub(crate) const HEXAPOD: [f64; 3] = [0.15e-6, 0.15e-6, 3e-6];
/// Registration noise: centre px, angle rad.
pub(crate) const NOISE: [f64; 2] = [0.03, 2e-4];

/// The same of the first view of one objective in that of another, whose pixels are larger; and of the logarithm of the scale.
const LINK_NOISE: [f64; 4] = [0.1, 0.1, 3e-4, 5e-4];

/// Seconds from view to view.
const VIEW_S: f64 = 0.5;

pub(crate) struct World {
    pub(crate) kinematics: Kinematics,
    pub(crate) turns: bool,
    pub(crate) optics: Optics,
    pub(crate) backlash: [f64; 3],
    pub(crate) scatter: [f64; 3],
    /// x and y, m/s.
    pub(crate) drift: [f64; 2],
    /// For how long it has drifted when the first view is taken, s.
    pub(crate) began_s: f64,
    pub(crate) reach: [f64; 3],
    /// How far from the first view there is something to see, m.
    pub(crate) extent_m: f64,
    rng: SplitMix64,
    /// An axis that is not asked elsewhere stays as it stands; else it arrives anew with each move of another.
    pub(crate) sticks: bool,
    /// Where each axis was asked to go, and how far beside it scattered.
    asked: [f64; 3],
    scattered: [f64; 3],
    /// Where the play has left each axis, before it scatters.
    contact: [f64; 3],
    truly: Vec<[f64; 3]>,
}

pub(crate) struct Run {
    pub(crate) taken: Vec<Taken>,
    pub(crate) pairs: Vec<Pair>,
    pub(crate) fit: Option<JointFit>,
}

/// The paper's map at 400x.
pub(crate) fn paper_400x() -> Optics {
    let (s, c) = 0.5722f64.to_radians().sin_cos();
    let r_ec = Mat2([[-s, -c], [-c, s]]);
    Optics {
        stage_from_pixel: r_ec * Mat2::diagonal(-1.0 / 1_953_155.0, -1.0 / 1_981_235.0),
        centre_m: [124.91e-3, 0.1166e-3],
    }
}

impl World {
    pub(crate) fn hexapod(seed: u64) -> Self {
        Self {
            kinematics: Kinematics::MovesMicroscope,
            turns: true,
            optics: paper_400x(),
            backlash: [0.0; 3],
            scatter: HEXAPOD,
            drift: [0.0; 2],
            began_s: 0.0,
            reach: [17e-3, 16e-3, 21f64.to_radians()],
            extent_m: 1.0,
            rng: SplitMix64::new(seed),
            sticks: false,
            asked: [f64::NAN; 3],
            scattered: [0.0; 3],
            contact: [0.0; 3],
            truly: Vec::new(),
        }
    }

    pub(crate) fn priors(&self) -> Priors {
        let [x, y, turn] = self.scatter;
        Priors {
            kinematics: self.kinematics,
            arrival: [Some(x), Some(y), self.turns.then_some(turn)],
            drift_m_per_s: 10e-9,
            coupled: None,
            sure: false,
            backlash: [30e-6, 30e-6, 1e-4],
            lever_m: 0.3,
            parcentric_m: 15e-6,
        }
    }

    fn go(&mut self, pose: &PlanarPose) {
        let asked = [pose.x_m[0], pose.x_m[1], pose.theta_rad];
        for (k, asked) in asked.into_iter().enumerate() {
            let half = self.backlash[k] / 2.0;
            self.contact[k] = self.contact[k].clamp(asked - half, asked + half);
            let redrawn = self.scatter[k] * self.rng.normal();
            if asked != self.asked[k] || !self.sticks {
                (self.asked[k], self.scattered[k]) = (asked, redrawn);
            }
        }
    }

    fn look(&mut self, pose: &PlanarPose) {
        self.go(pose);
        let axes = if self.turns { 3 } else { 2 };
        let mut truly = self.contact;
        for (k, truly) in truly.iter_mut().enumerate().take(axes) {
            *truly += self.scattered[k];
        }
        let time_s = self.began_s + VIEW_S * self.truly.len() as f64;
        for (truly, drift) in truly.iter_mut().zip(self.drift) {
            *truly += drift * time_s;
        }
        self.truly.push(truly);
    }

    /// The specimen point of a pixel, seen from the centre, in a view.
    fn specimen(&self, view: usize, p: Vec2) -> Vec2 {
        let [x, y, th] = self.truly[view];
        let c = self.optics.stage_from_pixel * p;
        let c = [0, 1].map(|k| c[k] + self.optics.centre_m[k]);
        match self.kinematics {
            Kinematics::MovesMicroscope => {
                let turned = Mat2::rotation(th) * c;
                [turned[0] + x, turned[1] + y]
            }
            Kinematics::SpecimenRotationOnTop => Mat2::rotation(-th) * [c[0] - x, c[1] - y],
            Kinematics::SpecimenXyOnTop => {
                let turned = Mat2::rotation(-th) * c;
                [turned[0] - x, turned[1] - y]
            }
        }
    }

    /// The pixel, from the centre, at which a view sees a specimen point.
    fn pixel(&self, view: usize, s: Vec2) -> Vec2 {
        let [x, y, th] = self.truly[view];
        let c = match self.kinematics {
            Kinematics::MovesMicroscope => Mat2::rotation(-th) * [s[0] - x, s[1] - y],
            Kinematics::SpecimenRotationOnTop => {
                let turned = Mat2::rotation(th) * s;
                [turned[0] + x, turned[1] + y]
            }
            Kinematics::SpecimenXyOnTop => Mat2::rotation(th) * [s[0] + x, s[1] + y],
        };
        let seen = [0, 1].map(|k| c[k] - self.optics.centre_m[k]);
        self.optics.stage_from_pixel.inverse().unwrap() * seen
    }

    /// What a registration says of two views; `None` where they do not overlap.
    pub(crate) fn pair(&mut self, fixed: usize, found: usize) -> Option<Pair> {
        let centre = |view: usize| self.specimen(view, [0.0; 2]);
        let (first, here) = (centre(0), centre(found));
        if f64::hypot(here[0] - first[0], here[1] - first[1]) > self.extent_m {
            return None;
        }
        let see = |p: Vec2| self.pixel(fixed, self.specimen(found, p));
        let (o, x, y) = (see([0.0; 2]), see([1e3, 0.0]), see([0.0, 1e3]));
        if o[0].abs() > 0.75 * 640.0 || o[1].abs() > 0.75 * 480.0 {
            return None;
        }
        let linear = Mat2([[x[0] - o[0], y[0] - o[0]], [x[1] - o[1], y[1] - o[1]]]);
        let [sigma_px, sigma_rad] = NOISE;
        let centre_px = o.map(|v| v + sigma_px * self.rng.normal());
        let angle_rad = linear.rotation_angle().unwrap() + sigma_rad * self.rng.normal();
        let mut covariance = [[0.0; 3]; 3];
        (covariance[0][0], covariance[1][1]) = (sigma_px.powi(2), sigma_px.powi(2));
        covariance[2][2] = sigma_rad.powi(2);
        Some(Pair {
            fixed,
            found,
            centre_px,
            angle_rad,
            covariance,
        })
    }

    /// What the registration of another objective's first view says in that of this one; `None` where its middle is not in there.
    pub(crate) fn link(&mut self, other: &World, both: [usize; 2]) -> Option<Link> {
        let see = |p: Vec2| self.pixel(0, other.specimen(0, p));
        let (o, x, y) = (see([0.0; 2]), see([100.0, 0.0]), see([0.0, 100.0]));
        if o[0].abs() > 320.0 || o[1].abs() > 240.0 {
            return None;
        }
        let column = |v: Vec2| [0, 1].map(|k| (v[k] - o[k]) / 100.0);
        let [[a, c], [b, d]] = [column(x), column(y)];
        let angle_rad = f64::atan2(c - b, a + d);
        let scale = 0.5 * (a * d - b * c).abs().ln();
        let truly = [o[0], o[1], angle_rad, scale];
        let seen = [0, 1, 2, 3].map(|k| truly[k] + LINK_NOISE[k] * self.rng.normal());
        let mut covariance = [[0.0; 4]; 4];
        for (k, row) in covariance.iter_mut().enumerate() {
            row[k] = LINK_NOISE[k].powi(2);
        }
        let [fixed, found] = both;
        Some(Link {
            fixed,
            found,
            seen,
            covariance,
        })
    }

    pub(crate) fn allowed(&self) -> impl Fn(&PlanarPose) -> bool + use<> {
        let [x, y, turn] = self.reach;
        move |p| p.x_m[0].abs() <= x && p.x_m[1].abs() <= y && p.theta_rad.abs() <= turn
    }

    /// A whole calibration from a pose.
    pub(crate) fn calibrate(&mut self, options: &PathOptions, start: PlanarPose) -> Run {
        let (mut taken, mut pairs) = (Vec::<Taken>::new(), Vec::new());
        let mut known = None;
        let allowed = self.allowed();
        self.contact = [start.x_m[0], start.x_m[1], start.theta_rad];
        loop {
            let so_far = taken.clone();
            let state = Known {
                kinematics: self.kinematics,
                turns: self.turns,
                image_size_px: [640, 480],
                nominal_m_per_px: 0.5e-6,
                start,
                optics: 0,
                taken: &so_far,
                fit: known.as_ref(),
            };
            let Some(next) = next_view(options, &state, &allowed) else {
                break;
            };
            if let Some(via) = &next.via {
                assert!(allowed(via));
                self.go(via);
            }
            assert!(allowed(&next.pose));
            self.look(&next.pose);
            let index = taken.len();
            let others = partners(options, &state, &next.pose);
            let seen: Vec<Pair> = others.iter().filter_map(|k| self.pair(*k, index)).collect();
            taken.push(Taken {
                role: next.role,
                asked: next.pose,
                view: View {
                    optics: 0,
                    reported: next.pose,
                    approach: next.approach,
                    time_s: VIEW_S * index as f64,
                    arrived: next.arrived,
                },
                found: index == 0 || !seen.is_empty(),
            });
            pairs.extend(seen);
            // Along an arm and while it sweeps the path learns nothing new of what it needs.
            if !matches!(next.role, Role::Arm { .. } | Role::Sweep { index: 0..7 }) {
                known = self.solve(&taken, &pairs);
            }
        }
        let fit = self.solve(&taken, &pairs);
        Run { taken, pairs, fit }
    }

    /// The instrument's true numbers less those of a fit, in the order of its covariance.
    pub(crate) fn off(&self, fit: &JointFit) -> Vec<f64> {
        let numbers = |backlash: [f64; 3], optics: &Optics| {
            let map = optics.stage_from_pixel.0;
            [&backlash[..], &map[0], &map[1], &optics.centre_m].concat()
        };
        let truth = numbers(self.backlash, &self.optics);
        let found = numbers(fit.instrument.backlash, &fit.instrument.optics[0]);
        truth.iter().zip(found).map(|(a, b)| a - b).collect()
    }

    pub(crate) fn solve(&self, taken: &[Taken], pairs: &[Pair]) -> Option<JointFit> {
        let views: Vec<View> = taken.iter().map(|t| t.view).collect();
        fit(&self.priors(), &views, pairs)
    }
}
