//! The architecture, from 1 mm down to 20 um: epithelial nests and glands, stroma between them, vessels, fat, clefts.
//!
//! Nests are the cells of a warped Voronoi diagram with some neighbours merged. Everything is smooth, so that it can be
//! evaluated every [`PITCH`] samples and interpolated.

use super::noise::{Dice, gradient, hash, norm, smoothstep, unit};

/// Samples between two evaluations of the plan: 4 um.
pub(super) const PITCH: i64 = 16;
/// Distance of the finest samples, micrometres.
pub(super) const SAMPLE_UM: f64 = 0.25;
/// Distance of two evaluations, micrometres.
const STEP_UM: f64 = PITCH as f64 * SAMPLE_UM;
/// Distance of nest centres, micrometres.
const NEST_UM: f64 = 225.0;

/// The tissue at one place. Lengths in micrometres.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Plan {
    /// Depth inside the epithelium; negative in the stroma.
    pub(super) depth: f32,
    /// Depth inside a gland's lumen; negative outside.
    pub(super) lumen: f32,
    /// A potential whose contours the fibres follow.
    pub(super) flow: f32,
    /// 1 where a gland, 0 where a solid nest.
    pub(super) gland: f32,
    /// Lymphocytes in the stroma, 0 to 1.
    pub(super) inflamed: f32,
    /// Wide gaps between fibres, 0 to 1.
    pub(super) loose: f32,
    /// Depth inside a vessel's lumen; negative outside, in the wall down to about -5.
    pub(super) vessel: f32,
    /// Depth inside a fat cell.
    pub(super) fat: f32,
    /// Half width of the cleft of blank glass that runs along the zeros of `crack`; negative where it is closed.
    pub(super) cleft: f32,
    /// Distance to the middle of the cleft, with a sign so that it can be interpolated across.
    pub(super) crack: f32,
    /// Slow variation of staining, about -1 to 1.
    pub(super) tone: f32,
}

impl Plan {
    /// Field by field between two plans.
    #[inline(always)]
    pub(super) fn mix(a: &Plan, b: &Plan, t: f32) -> Plan {
        let m = |x: f32, y: f32| x + (y - x) * t;
        Plan {
            depth: m(a.depth, b.depth),
            lumen: m(a.lumen, b.lumen),
            flow: m(a.flow, b.flow),
            gland: m(a.gland, b.gland),
            inflamed: m(a.inflamed, b.inflamed),
            loose: m(a.loose, b.loose),
            vessel: m(a.vessel, b.vessel),
            fat: m(a.fat, b.fat),
            cleft: m(a.cleft, b.cleft),
            crack: m(a.crack, b.crack),
            tone: m(a.tone, b.tone),
        }
    }
}

/// The plan on a grid that covers a window and what reaches into it.
pub(super) struct PlanGrid {
    /// Grid node of the first entry.
    i0: i64,
    j0: i64,
    columns: usize,
    nodes: Vec<Plan>,
}

impl PlanGrid {
    /// Covers samples `i0..i0 + w`, `j0..j0 + h` and `margin_um` around.
    pub(super) fn new(seed: u64, [i0, j0]: [i64; 2], [w, h]: [usize; 2], margin_um: f64) -> Self {
        let m = (margin_um / SAMPLE_UM).ceil() as i64;
        let (a0, a1) = (
            (i0 - m).div_euclid(PITCH),
            (i0 + w as i64 + m).div_euclid(PITCH) + 1,
        );
        let (b0, b1) = (
            (j0 - m).div_euclid(PITCH),
            (j0 + h as i64 + m).div_euclid(PITCH) + 1,
        );
        let span = [a0, a1, b0, b1].map(|k| k as f64 * STEP_UM);
        let (vessels, fat) = (vessels_near(seed, span), fat_near(seed, span));
        let nodes = (b0..=b1)
            .flat_map(|b| (a0..=a1).map(move |a| (a as f64 * STEP_UM, b as f64 * STEP_UM)))
            .map(|(u, v)| {
                let mut plan = nests(seed, u, v);
                for disc in &vessels {
                    plan.vessel = plan.vessel.max(disc.depth(u, v));
                }
                for disc in &fat {
                    plan.fat = plan.fat.max(disc.depth(u, v));
                }
                plan
            })
            .collect();
        Self {
            i0: a0,
            j0: b0,
            columns: (a1 - a0 + 1) as usize,
            nodes,
        }
    }

    /// The plan at a place, micrometres.
    pub(super) fn at(&self, u: f64, v: f64) -> Plan {
        let (x, y) = (u / STEP_UM, v / STEP_UM);
        let (i, j) = (x.floor(), y.floor());
        let (tx, ty) = ((x - i) as f32, (y - j) as f32);
        let at = (j as i64 - self.j0) as usize * self.columns + (i as i64 - self.i0) as usize;
        let n = &self.nodes;
        let upper = Plan::mix(&n[at], &n[at + 1], tx);
        let lower = Plan::mix(&n[at + self.columns], &n[at + self.columns + 1], tx);
        Plan::mix(&upper, &lower, ty)
    }

    /// Direction of the steepest rise of a field, as (cos, sin); (1, 0) where it is flat.
    pub(super) fn rise(&self, u: f64, v: f64, field: impl Fn(&Plan) -> f32) -> [f32; 2] {
        let e = 2.0;
        let gx = field(&self.at(u + e, v)) - field(&self.at(u - e, v));
        let gy = field(&self.at(u, v + e)) - field(&self.at(u, v - e));
        let n = norm(gx, gy);
        if n < 1e-6 {
            [1.0, 0.0]
        } else {
            [gx / n, gy / n]
        }
    }

    /// The plans of a row of samples where it crosses the grid's columns, from sample column `i0` on, a multiple of
    /// [`PITCH`].
    pub(super) fn row(&self, i0: i64, j: i64, out: &mut [Plan]) {
        let (b, ty) = (
            j.div_euclid(PITCH),
            (j.rem_euclid(PITCH) as f32 + 0.5) / PITCH as f32,
        );
        let at = (b - self.j0) as usize * self.columns + (i0.div_euclid(PITCH) - self.i0) as usize;
        let (upper, lower) = (&self.nodes[at..], &self.nodes[at + self.columns..]);
        for (out, (a, b)) in out.iter_mut().zip(upper.iter().zip(lower)) {
            *out = Plan::mix(a, b, ty);
        }
    }

    /// The least and the largest `flow` at the nodes around a window.
    pub(super) fn flows(&self, [i0, j0]: [i64; 2], [w, h]: [usize; 2]) -> [f32; 2] {
        let around = |first: i64, n: usize, from: i64| {
            let last = (first + n as i64).div_euclid(PITCH) + 1;
            (first.div_euclid(PITCH) - from) as usize..=(last - from) as usize
        };
        let (columns, rows) = (around(i0, w, self.i0), around(j0, h, self.j0));
        let mut ends = [f32::INFINITY, f32::NEG_INFINITY];
        for line in self
            .nodes
            .chunks_exact(self.columns)
            .skip(*rows.start())
            .take(rows.count())
        {
            for plan in &line[columns.clone()] {
                ends = [ends[0].min(plan.flow), ends[1].max(plan.flow)];
            }
        }
        ends
    }
}

/// Nests, glands, stroma and clefts: everything but the discs laid over them.
fn nests(seed: u64, u: f64, v: f64) -> Plan {
    let n = |k: u64, wave: f64| gradient(seed.wrapping_add(k), wave, u, v);
    // Domain warp: the Voronoi cells lose their straight edges.
    let wu = 70.0 * n(1, 310.0) + 26.0 * n(2, 110.0) + 9.0 * n(3, 41.0);
    let wv = 70.0 * n(4, 290.0) + 26.0 * n(5, 103.0) + 9.0 * n(6, 43.0);
    let (x, y) = ((u + f64::from(wu)) / NEST_UM, (v + f64::from(wv)) / NEST_UM);
    let (ci, cj) = (x.floor() as i64, y.floor() as i64);
    let mut sites = [(f32::INFINITY, 0_u32); 25];
    for (k, site) in sites.iter_mut().enumerate() {
        let (i, j) = (ci + k as i64 % 5 - 2, cj + k as i64 / 5 - 2);
        let h = hash(seed ^ 0xA11CE, i, j);
        let (px, py) = (
            0.12 + 0.76 * unit(h),
            0.12 + 0.76 * unit(h.wrapping_mul(0x9E37_79B1)),
        );
        let (dx, dy) = ((x - i as f64) as f32 - px, (y - j as f64) as f32 - py);
        *site = (NEST_UM as f32 * norm(dx, dy), group(seed, i, j));
    }
    let nearest = sites
        .iter()
        .fold(sites[0], |a, &b| if b.0 < a.0 { b } else { a });
    // Smooth minima round the corners where three nests meet.
    let smooth_min = |same: bool| {
        const K: f32 = 13.0;
        let sum: f32 = sites
            .iter()
            .filter(|s| (s.1 == nearest.1) == same)
            .map(|s| (-(s.0 - nearest.0) / K).exp())
            .sum();
        nearest.0 - K * sum.max(1e-30).ln()
    };
    let half_gap = 0.5 * (smooth_min(false) - smooth_min(true)).min(260.0);
    let septum = 5.0 + 30.0 * smoothstep(-0.35, 0.6, n(7, 370.0)) + 5.0 * n(8, 60.0);
    let stroma = nearest.1 == STROMA;
    let depth = if stroma {
        -half_gap - septum
    } else {
        half_gap - septum
    };

    let mut kind = Dice::new(seed ^ 0x61A9D, i64::from(nearest.1), 3);
    let is_gland = kind.chance(0.4);
    let wall = kind.range(19.0, 34.0);
    let lumen = if is_gland && !stroma {
        // Bridges of epithelium cross the wider lumens.
        let bridge = 62.0 * (n(31, 120.0) + 0.15 * n(32, 45.0)).abs() - 9.0;
        (depth - wall - 7.0 * n(9, 48.0)).min(bridge)
    } else {
        -60.0
    };
    let flow = 0.55 * depth + 60.0 * n(10, 170.0) + 17.0 * n(11, 55.0) + 5.0 * n(12, 23.0);
    let crack = (n(13, 420.0) + 0.22 * n(14, 130.0) + 0.05 * n(19, 30.0)) * 300.0;
    Plan {
        depth,
        lumen,
        flow,
        gland: if is_gland { 1.0 } else { 0.0 },
        inflamed: smoothstep(-0.05, 0.5, n(15, 460.0) + 0.3 * n(20, 90.0)),
        loose: smoothstep(-0.35, 0.45, n(16, 330.0) + 0.35 * n(21, 80.0)),
        vessel: -40.0,
        fat: -40.0,
        cleft: 38.0 * (n(17, 520.0) - 0.24),
        crack,
        tone: n(18, 800.0) + 0.5 * n(22, 210.0),
    }
}

/// The group of the nests without epithelium.
const STROMA: u32 = 0;

/// Nests of one group are merged. Some take the group of their left or upper neighbour, some are stroma.
fn group(seed: u64, i: i64, j: i64) -> u32 {
    let own = |i: i64, j: i64| {
        let h = hash(seed ^ 0x90C0DE, i, j);
        if unit(h) < 0.13 { STROMA } else { h | 1 }
    };
    match hash(seed ^ 0x3E66E, i, j) % 20 {
        0..=4 => own(i - 1, j),
        5..=9 => own(i, j - 1),
        _ => own(i, j),
    }
}

/// A round thing laid over the plan, slightly elliptic.
struct Disc {
    u: f64,
    v: f64,
    radius: f32,
    /// Axis of the ellipse (cos, sin) and its stretch.
    axis: [f32; 2],
    stretch: f32,
}

impl Disc {
    /// Depth inside, about micrometres.
    fn depth(&self, u: f64, v: f64) -> f32 {
        let (dx, dy) = ((u - self.u) as f32, (v - self.v) as f32);
        let along = (dx * self.axis[0] + dy * self.axis[1]) / self.stretch;
        let across = (dy * self.axis[0] - dx * self.axis[1]) * self.stretch;
        (self.radius - norm(along, across)).max(-40.0)
    }
}

/// Places of a jittered grid of `pitch_um` from which a disc of up to `reach_um` can touch the span.
fn places(span: [f64; 4], pitch_um: f64, reach_um: f64) -> impl Iterator<Item = (i64, i64)> {
    let low = |x: f64| ((x - reach_um) / pitch_um).floor() as i64 - 1;
    let high = |x: f64| ((x + reach_um) / pitch_um).floor() as i64;
    let (i0, i1, j0, j1) = (low(span[0]), high(span[1]), low(span[2]), high(span[3]));
    (j0..=j1).flat_map(move |j| (i0..=i1).map(move |i| (i, j)))
}

fn vessels_near(seed: u64, span: [f64; 4]) -> Vec<Disc> {
    const PITCH_UM: f64 = 95.0;
    let mut found = Vec::new();
    for (i, j) in places(span, PITCH_UM, 90.0) {
        let mut dice = Dice::new(seed ^ 0x7E55E1, i, j);
        let u = (i as f64 + f64::from(dice.next())) * PITCH_UM;
        let v = (j as f64 + f64::from(dice.next())) * PITCH_UM;
        let wanted = 6.0 + 34.0 * dice.next().powi(3);
        let here = nests(seed, u, v);
        let radius = wanted.min(0.75 * -here.depth);
        if radius < 5.5 || here.cleft - here.crack.abs() > -30.0 {
            continue;
        }
        let angle = dice.range(0.0, std::f32::consts::PI);
        found.push(Disc {
            u,
            v,
            radius,
            axis: [angle.cos(), angle.sin()],
            stretch: dice.range(1.0, 1.45),
        });
    }
    found
}

fn fat_near(seed: u64, span: [f64; 4]) -> Vec<Disc> {
    const PITCH_UM: f64 = 52.0;
    let mut found = Vec::new();
    for (i, j) in places(span, PITCH_UM, 80.0) {
        let mut dice = Dice::new(seed ^ 0xFA7, i, j);
        let u = (i as f64 + 0.2 + 0.6 * f64::from(dice.next())) * PITCH_UM;
        let v = (j as f64 + 0.2 + 0.6 * f64::from(dice.next())) * PITCH_UM;
        if gradient(seed.wrapping_add(30), 600.0, u, v) < 0.12 {
            continue;
        }
        let radius = dice.range(15.0, 29.0).min(-0.8 * nests(seed, u, v).depth);
        if radius < 10.0 {
            continue;
        }
        let angle = dice.range(0.0, std::f32::consts::PI);
        found.push(Disc {
            u,
            v,
            radius,
            axis: [angle.cos(), angle.sin()],
            stretch: dice.range(1.0, 1.18),
        });
    }
    found
}
