//! The architecture, from 1 mm down to 20 um: epithelial nests and glands, stroma between them, vessels, fat, clefts.
//!
//! Nests are the cells of a warped Voronoi diagram with some neighbours merged. Everything is smooth, so that it can be
//! evaluated every [`PITCH`] samples and interpolated.

use super::noise::{Corners, Dice, floor_i64, gradient, hash, norm, smoothstep, unit};
use std::ops::Range;

/// Samples between two evaluations of the plan: 4 um.
pub(super) const PITCH: i64 = 16;
/// Distance of the finest samples, micrometres.
pub(super) const SAMPLE_UM: f64 = 0.25;
/// Distance of two evaluations, micrometres.
pub(super) const STEP_UM: f64 = PITCH as f64 * SAMPLE_UM;
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

/// The plan at the nodes `columns`, `rows` of its grid, row by row.
pub(super) fn plans(seed: u64, columns: Range<i64>, rows: Range<i64>) -> Vec<Plan> {
    let ends = [columns.start, columns.end - 1, rows.start, rows.end - 1];
    let span = ends.map(|k| k as f64 * STEP_UM);
    let mut nests = Nests::new(seed);
    let vessels = vessels_near(&mut nests, span);
    let fat = fat_near(&mut nests, span);
    rows.flat_map(|b| columns.clone().map(move |a| (a, b)))
        .map(|(a, b)| {
            let (u, v) = (a as f64 * STEP_UM, b as f64 * STEP_UM);
            let mut plan = nests.at(u, v);
            for disc in &vessels {
                plan.vessel = plan.vessel.max(disc.depth(u, v));
            }
            for disc in &fat {
                plan.fat = plan.fat.max(disc.depth(u, v));
            }
            plan
        })
        .collect()
}

/// The sites of the Voronoi cells around a place.
struct Sites {
    /// Column and row of the square of the jittered grid that the place lies in.
    square: [i64; 2],
    /// Where each site lies in its own square, and its group.
    x: [f32; 25],
    y: [f32; 25],
    group: [u32; 25],
}

impl Sites {
    fn around(seed: u64, [ci, cj]: [i64; 2]) -> Self {
        let mut sites = Self {
            square: [ci, cj],
            x: [0.0; 25],
            y: [0.0; 25],
            group: [STROMA; 25],
        };
        for k in 0..25 {
            let (i, j) = (ci + k as i64 % 5 - 2, cj + k as i64 / 5 - 2);
            let h = hash(seed ^ 0xA11CE, i, j);
            sites.x[k] = 0.12 + 0.76 * unit(h);
            sites.y[k] = 0.12 + 0.76 * unit(h.wrapping_mul(0x9E37_79B1));
            sites.group[k] = group(seed, i, j);
        }
        sites
    }
    /// Half the way from the border between the groups to a place, in units of the squares, and the group there.
    fn half_gap(&self, x: f64, y: f64) -> (f32, u32) {
        let [ci, cj] = self.square;
        let from = |x: f64, c: i64| [-2, -1, 0, 1, 2].map(|k| (x - (c + k) as f64) as f32);
        let (xs, ys) = (from(x, ci), from(y, cj));
        let sites: [(f32, u32); 25] = std::array::from_fn(|k| {
            let (dx, dy) = (xs[k % 5] - self.x[k], ys[k / 5] - self.y[k]);
            (NEST_UM as f32 * norm(dx, dy), self.group[k])
        });
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
        (half_gap, nearest.1)
    }
}

/// Nests, glands, stroma and clefts: everything but the discs laid over them. Keeps what neighbouring places share.
struct Nests {
    seed: u64,
    /// Of every noise, by its number.
    corners: [Corners; 33],
    sites: Sites,
}

impl Nests {
    fn new(seed: u64) -> Self {
        Self {
            seed,
            corners: [Corners::default(); 33],
            sites: Sites::around(seed, [0, 0]),
        }
    }

    fn at(&mut self, u: f64, v: f64) -> Plan {
        let Self {
            seed,
            corners,
            sites,
        } = self;
        let seed = *seed;
        let mut n = |k: usize, wave: f64| {
            gradient(seed.wrapping_add(k as u64), wave, u, v, &mut corners[k])
        };
        // Domain warp: the Voronoi cells lose their straight edges.
        let wu = 70.0 * n(1, 310.0) + 26.0 * n(2, 110.0) + 9.0 * n(3, 41.0);
        let wv = 70.0 * n(4, 290.0) + 26.0 * n(5, 103.0) + 9.0 * n(6, 43.0);
        let (x, y) = ((u + f64::from(wu)) / NEST_UM, (v + f64::from(wv)) / NEST_UM);
        let square = [floor_i64(x), floor_i64(y)];
        if sites.square != square {
            *sites = Sites::around(seed, square);
        }
        let (half_gap, group) = sites.half_gap(x, y);
        let septum = 5.0 + 30.0 * smoothstep(-0.35, 0.6, n(7, 370.0)) + 5.0 * n(8, 60.0);
        let stroma = group == STROMA;
        let depth = if stroma {
            -half_gap - septum
        } else {
            half_gap - septum
        };

        let mut kind = Dice::new(seed ^ 0x61A9D, i64::from(group), 3);
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

fn vessels_near(nests: &mut Nests, span: [f64; 4]) -> Vec<Disc> {
    const PITCH_UM: f64 = 95.0;
    let mut found = Vec::new();
    for (i, j) in places(span, PITCH_UM, 90.0) {
        let mut dice = Dice::new(nests.seed ^ 0x7E55E1, i, j);
        let u = (i as f64 + f64::from(dice.next())) * PITCH_UM;
        let v = (j as f64 + f64::from(dice.next())) * PITCH_UM;
        let wanted = 6.0 + 34.0 * dice.next().powi(3);
        let here = nests.at(u, v);
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

fn fat_near(nests: &mut Nests, span: [f64; 4]) -> Vec<Disc> {
    const PITCH_UM: f64 = 52.0;
    let mut found = Vec::new();
    for (i, j) in places(span, PITCH_UM, 80.0) {
        let mut dice = Dice::new(nests.seed ^ 0xFA7, i, j);
        let u = (i as f64 + 0.2 + 0.6 * f64::from(dice.next())) * PITCH_UM;
        let v = (j as f64 + 0.2 + 0.6 * f64::from(dice.next())) * PITCH_UM;
        if gradient(
            nests.seed.wrapping_add(30),
            600.0,
            u,
            v,
            &mut nests.corners[30],
        ) < 0.12
        {
            continue;
        }
        let radius = dice.range(15.0, 29.0).min(-0.8 * nests.at(u, v).depth);
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
