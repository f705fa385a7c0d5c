//! Least squares of the map over the cells that were seen, without those that lie elsewhere than all others.

use super::model::{DISTORTION, KEYSTONE, Model, UNKNOWNS};
use super::types::Term;
use scopeservo_geometry::{Cholesky, Vec2};

/// Cells farther from where they should be than so many standard deviations are left out.
const FAR: f64 = 4.0;
/// But no cell so near, px.
const NEAR_PX: f64 = 0.01;
/// A number is seen when it is this many standard deviations from nothing; two numbers together when chi squared says as much.
const SIGMAS: f64 = 3.0;
const CHI_SQ_OF_TWO: f64 = 11.8;
/// With fewer cells distortion and tilt are not asked for.
const ENOUGH: f64 = 16.0;
const ROUNDS: usize = 8;

/// A cell that was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Node {
    /// Which; windows that overlap lie half a period apart.
    pub(super) n: Vec2,
    /// Where, px from the image's centre.
    pub(super) p_px: Vec2,
}

impl Node {
    fn residual(&self, model: &Model) -> Vec2 {
        let seen = model.seen(self.n);
        [self.p_px[0] - seen[0], self.p_px[1] - seen[1]]
    }
}

/// The map and how well it is known.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct GridFit {
    pub(super) model: Model,
    pub(super) covariance: [[f64; 6]; 6],
    pub(super) distortion: Term,
    pub(super) keystone: [Term; 2],
    /// Cells used: windows times their share.
    pub(super) nodes: usize,
    pub(super) sigma_px: f64,
}

/// With distortion and tilt where they are seen. Of each node a `share` is news: windows that overlap see the same noise.
pub(super) fn fit_grid(start: Model, nodes: &[Node], share: f64) -> Option<GridFit> {
    let affine: Vec<usize> = (0..6).collect();
    if share * (nodes.len() as f64) < ENOUGH {
        return Some(solve(start, nodes, share, &affine)?.told([Term::default(); 3]));
    }
    let all: Vec<usize> = (0..UNKNOWNS).collect();
    let whole = solve(start, nodes, share, &all)?;
    // Each as it is known beside the other.
    let keystone = KEYSTONE.map(|k| whole.term(k));
    let tilted = whole.chi_sq(KEYSTONE)? > CHI_SQ_OF_TWO;
    let upright = match tilted {
        true => whole,
        false => solve(start, nodes, share, &all[..=DISTORTION])?,
    };
    let distortion = upright.term(DISTORTION);
    let terms = [
        distortion,
        Term {
            seen: tilted,
            ..keystone[0]
        },
        Term {
            seen: tilted,
            ..keystone[1]
        },
    ];
    let kept = match (distortion.seen, tilted) {
        (true, _) => return Some(upright.told(terms)),
        (false, true) => all.into_iter().filter(|k| *k != DISTORTION).collect(),
        (false, false) => affine,
    };
    Some(solve(start, nodes, share, &kept)?.told(terms))
}

/// The same for the way there: distortion once there are cells enough.
pub(super) fn fit_roughly(start: Model, nodes: &[Node], share: f64) -> Option<Model> {
    let unknowns = if share * (nodes.len() as f64) < ENOUGH {
        6
    } else {
        DISTORTION + 1
    };
    let unknowns: Vec<usize> = (0..unknowns).collect();
    solve(start, nodes, share, &unknowns).map(|solved| solved.model)
}

struct Solved {
    model: Model,
    /// Those that were solved for, and their covariance, row by row.
    unknowns: Vec<usize>,
    covariance: Vec<f64>,
    nodes: usize,
    sigma_px: f64,
}

/// Gauss and Newton, each round without the cells that the last one found far off.
fn solve(start: Model, nodes: &[Node], share: f64, unknowns: &[usize]) -> Option<Solved> {
    let mut model = start;
    for k in 0..UNKNOWNS {
        if !unknowns.contains(&k) {
            model = without(model, k);
        }
    }
    let mut used: Vec<Node> = nodes.to_vec();
    let count = unknowns.len();
    for round in 0.. {
        if 2 * used.len() <= count {
            return None;
        }
        let (information, right) = normal(&model, &used, unknowns);
        let information = Cholesky::of(&information, count)?;
        for (k, step) in unknowns.iter().zip(information.solve(&right)) {
            model = model.moved(*k, step);
        }
        let off = |node: &Node| {
            let [x, y] = node.residual(&model);
            f64::hypot(x, y)
        };
        // Half of the distances of a normal scatter are below 1.177 of its standard deviation.
        let mut sorted: Vec<f64> = nodes.iter().map(off).collect();
        sorted.sort_by(f64::total_cmp);
        let most = (FAR * sorted[sorted.len() / 2] / 1.177).max(NEAR_PX);
        let kept: Vec<Node> = nodes.iter().filter(|n| off(n) <= most).copied().collect();
        let settled = kept.len() == used.len();
        used = kept;
        if round >= 3 && (settled || round >= ROUNDS) {
            break;
        }
    }
    let independent = share * used.len() as f64;
    let freedom = 2.0 * independent - count as f64;
    if freedom < 1.0 {
        return None;
    }
    let sum_sq: f64 = used
        .iter()
        .map(|node| node.residual(&model).iter().map(|v| v * v).sum::<f64>())
        .sum();
    let variance = share * sum_sq / freedom;
    let (information, _) = normal(&model, &used, unknowns);
    let inverse = Cholesky::of(&information, count)?.inverse();
    Some(Solved {
        model,
        unknowns: unknowns.to_vec(),
        covariance: inverse.into_iter().map(|v| v * variance / share).collect(),
        nodes: independent.round() as usize,
        sigma_px: variance.sqrt(),
    })
}

fn without(model: Model, unknown: usize) -> Model {
    match unknown {
        DISTORTION => model.moved(unknown, -model.distortion),
        k if k > DISTORTION => model.moved(k, -model.keystone[k - KEYSTONE[0]]),
        _ => model,
    }
}

/// `J^T J` row by row, and `J^T r`.
fn normal(model: &Model, nodes: &[Node], unknowns: &[usize]) -> (Vec<f64>, Vec<f64>) {
    let count = unknowns.len();
    let (mut information, mut right) = (vec![0.0; count * count], vec![0.0; count]);
    // The map is linear in the first six, and nearly so in the others.
    let step = |k: usize| if k < DISTORTION { 1e-3 } else { 1e-5 };
    for node in nodes {
        let (n, r) = (node.n, node.residual(model));
        let rows: Vec<Vec2> = unknowns
            .iter()
            .map(|&k| {
                let [a, b] = [step(k), -step(k)].map(|by| model.moved(k, by).seen(n));
                [0, 1].map(|i| (a[i] - b[i]) / (2.0 * step(k)))
            })
            .collect();
        for (i, a) in rows.iter().enumerate() {
            right[i] += a[0] * r[0] + a[1] * r[1];
            for (j, b) in rows.iter().enumerate() {
                information[i * count + j] += a[0] * b[0] + a[1] * b[1];
            }
        }
    }
    (information, right)
}

impl Solved {
    fn value(&self, unknown: usize) -> f64 {
        match unknown {
            DISTORTION => self.model.distortion,
            k => self.model.keystone[k - KEYSTONE[0]],
        }
    }

    fn covariance_of(&self, a: usize, b: usize) -> f64 {
        let at = |k: usize| self.unknowns.iter().position(|u| *u == k);
        match (at(a), at(b)) {
            (Some(i), Some(j)) => self.covariance[i * self.unknowns.len() + j],
            _ => 0.0,
        }
    }

    fn term(&self, unknown: usize) -> Term {
        let (value, sigma) = (
            self.value(unknown),
            self.covariance_of(unknown, unknown).sqrt(),
        );
        Term {
            value,
            sigma,
            seen: value.abs() > SIGMAS * sigma,
        }
    }

    fn chi_sq(&self, [a, b]: [usize; 2]) -> Option<f64> {
        let c = |i, j| self.covariance_of(i, j);
        let inverse =
            scopeservo_geometry::cholesky_inverse(&[[c(a, a), c(a, b)], [c(b, a), c(b, b)]])?;
        let v = [self.value(a), self.value(b)];
        let all = (0..2).flat_map(|i| (0..2).map(move |j| (i, j)));
        Some(all.map(|(i, j)| v[i] * inverse[i][j] * v[j]).sum())
    }

    fn told(self, [distortion, along_x, along_y]: [Term; 3]) -> GridFit {
        let covariance = std::array::from_fn(|i| std::array::from_fn(|j| self.covariance_of(i, j)));
        GridFit {
            model: self.model,
            covariance,
            distortion,
            keystone: [along_x, along_y],
            nodes: self.nodes,
            sigma_px: self.sigma_px,
        }
    }
}
