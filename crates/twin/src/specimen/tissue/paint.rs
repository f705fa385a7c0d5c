//! A window of samples: plan, cells, fibres and grain become amounts of stain, and those colour.

use super::cast::{Layers, cast};
use super::cells::{Cell, MARGIN_UM, cells_near};
use super::grid::{PlanGrid, Plans};
use super::noise::{Lattice, MOST, Strands, larger, lesser, mix, smoothstep};
use super::plan::{PITCH, Plan, SAMPLE_UM};
use super::stain;

/// Samples of a row that are painted together: those between two nodes of the plan. What is the same for all of them is
/// decided once, and the rest is computed several samples at a time.
const BLOCK: usize = PITCH as usize;
/// Rows painted together: what a band needs stays in the processor's cache.
const BAND: usize = 16;

/// More than `rough` is anywhere, and more than `phase` adds to the flow.
const MOST_ROUGH: f32 = (2.2 + 1.5 + 0.7) * MOST;
const MOST_SHIFT: f32 = (0.8 + 0.5 + 0.12) * MOST;

type Block = [f32; BLOCK];

/// A block of numbers from those of its samples.
#[inline(always)]
fn each(f: impl Fn(usize) -> f32) -> Block {
    let mut block = [0.0; BLOCK];
    for (k, out) in block.iter_mut().enumerate() {
        *out = f(k);
    }
    block
}

/// Noise about -1 to 1, standard deviation a half: of a window, a band, a block or one sample. Pitches in samples
/// without common factors, so that no lattice shows.
struct Grain<T> {
    /// 0.5 um.
    fine: T,
    /// 1.25 um.
    grain: T,
    /// 2.75 um.
    clump: T,
    /// 7.25 um.
    patch: T,
    /// 17.75 um.
    edge: T,
}

/// Amounts of stain on a row of samples.
struct Stains {
    hematoxylin: Vec<f32>,
    eosin: Vec<f32>,
    blood: Vec<f32>,
}

/// Everything that a window is painted from. Its columns are whole blocks.
struct Painter {
    plan: PlanGrid,
    cells: Vec<Cell>,
    grain: Grain<Lattice>,
    bundles: Strands,
    fibres: Strands,
    /// First sample, column and row.
    origin: [i64; 2],
    width: usize,
}

/// Room for what a band is painted from.
struct Work {
    grain: Grain<Vec<f32>>,
    layers: Layers<Vec<f32>>,
    /// The plan where a row crosses the columns of its grid.
    nodes: Vec<Plan>,
    stains: Stains,
}

/// What is known of a block of samples.
struct Here<'a> {
    /// The plan at the nodes to the left and right.
    ends: [&'a Plan; 2],
    grain: Grain<&'a Block>,
    layers: Layers<&'a Block>,
    /// Unevenness of every border, micrometres.
    rough: Block,
    /// Unevenness of every staining, as a share.
    texture: Block,
}

/// The colours of samples `i0..i0 + w`, `j0..j0 + h` (columns right, rows down), red first.
pub(super) fn window(plans: &Plans, [i0, j0]: [i64; 2], [w, h]: [usize; 2]) -> Vec<u8> {
    let skipped = i0.rem_euclid(PITCH) as usize;
    let width = (skipped + w).next_multiple_of(BLOCK);
    let painter = Painter::new(plans, [i0 - skipped as i64, j0], [width, h]);
    let mut rgb = vec![0; 3 * w * h];
    let zeros = |rows: usize| vec![0.0; width * rows];
    let mut work = Work {
        grain: painter.grain.map(|_| zeros(BAND)),
        layers: Layers::default(),
        nodes: vec![Plan::default(); width / BLOCK + 1],
        stains: Stains {
            hematoxylin: zeros(1),
            eosin: zeros(1),
            blood: zeros(1),
        },
    };
    for (band, out) in rgb.chunks_mut(3 * w * BAND).enumerate() {
        painter.band(band * BAND, skipped, w, &mut work, out);
    }
    rgb
}

impl Painter {
    fn new(plans: &Plans, origin: [i64; 2], [w, h]: [usize; 2]) -> Self {
        let seed = plans.seed;
        let plan = PlanGrid::new(plans, origin, [w, h], MARGIN_UM);
        let noise = |k: u64, pitch| Lattice::new(seed.wrapping_add(100 + k), pitch, origin, [w, h]);
        let um = |first: i64, n: usize| {
            (first..first + n as i64).map(|k| ((k as f64 + 0.5) * SAMPLE_UM) as f32)
        };
        let strands = |seed, waves| {
            let [least, most] = plan.flows(origin, [w, h]);
            Strands::new(
                seed,
                waves,
                [least - MOST_SHIFT, most + MOST_SHIFT],
                um(origin[0], w),
                um(origin[1], h),
            )
        };
        Self {
            cells: cells_near(seed, &plan, origin, [w, h]),
            grain: Grain {
                fine: noise(0, 2),
                grain: noise(1, 5),
                clump: noise(2, 11),
                patch: noise(3, 29),
                edge: noise(4, 71),
            },
            bundles: strands(seed, [6.5, 41.0, 43.0]),
            fibres: strands(seed ^ 0xF1B, [2.1, 23.0, 19.0]),
            plan,
            origin,
            width: w,
        }
    }

    /// Paints the rows of a band, from row `first` of the window, leaving out the `skipped` columns on the left.
    fn band(&self, first: usize, skipped: usize, w: usize, work: &mut Work, out: &mut [u8]) {
        let rows = out.len() / (3 * w);
        let origin = [self.origin[0], self.origin[1] + first as i64];
        let Work {
            grain,
            layers,
            nodes,
            stains,
        } = work;
        let n = self.width * rows;
        self.grain.fine.rows(first, &mut grain.fine[..n]);
        self.grain.grain.rows(first, &mut grain.grain[..n]);
        self.grain.clump.rows(first, &mut grain.clump[..n]);
        self.grain.patch.rows(first, &mut grain.patch[..n]);
        self.grain.edge.rows(first, &mut grain.edge[..n]);
        let size = [self.width, rows];
        cast(
            &self.cells,
            origin,
            size,
            &grain.grain,
            &grain.clump,
            layers,
        );
        for (j, out) in out.chunks_exact_mut(3 * w).enumerate() {
            self.plan.row(origin[0], origin[1] + j as i64, nodes);
            for (b, ends) in nodes.windows(2).enumerate() {
                let at = j * (self.width / BLOCK) + b;
                let here = Here::new(
                    [&ends[0], &ends[1]],
                    grain.map(|v| &v.as_chunks().0[at]),
                    layers.map(|v| &v.as_chunks().0[at]),
                );
                let [h, e, blood] = self.amounts(&here, b * BLOCK, first + j);
                let span = b * BLOCK..(b + 1) * BLOCK;
                stains.hematoxylin[span.clone()].copy_from_slice(&h);
                stains.eosin[span.clone()].copy_from_slice(&e);
                stains.blood[span].copy_from_slice(&blood);
            }
            let seen = skipped..skipped + w;
            stain::colour_row(
                &stains.hematoxylin[seen.clone()],
                &stains.eosin[seen.clone()],
                &stains.blood[seen],
                out,
            );
        }
    }

    /// Hematoxylin, eosin and blood of a block, none negative.
    fn amounts(&self, here: &Here, column: usize, row: usize) -> [Block; 3] {
        let glass = each(|k| {
            let p = here.plan(k);
            smoothstep(0.4, -0.8, p.cleft - p.crack.abs() + 0.9 * here.rough[k])
        });
        if glass == [0.0; BLOCK] {
            return [[0.0; BLOCK]; 3];
        }
        let inside = each(|k| smoothstep(-0.7, 0.7, here.depth(k)));
        let open = each(|k| smoothstep(-0.6, 0.8, here.plan(k).lumen + 0.8 * here.rough[k]));
        let (mut hema, mut eosin) = ([0.0; BLOCK], [0.0; BLOCK]);
        if inside != [0.0; BLOCK] {
            for k in 0..BLOCK {
                let [h, e] = epithelium(here, k);
                hema[k] = inside[k] * h * (1.0 - open[k]);
                eosin[k] = inside[k] * mix(e, secretion(here, k), open[k]);
            }
        }
        if inside != [1.0; BLOCK] {
            let phase = each(|k| here.phase(k));
            let bundle = self.bundles.block(&phase, column, row);
            let fibre = self.fibres.block(&phase, column, row);
            let stroma = stroma(here, &bundle, &fibre);
            for k in 0..BLOCK {
                eosin[k] += (1.0 - inside[k]) * stroma[k];
            }
        }
        let mut blood = [0.0; BLOCK];
        for k in 0..BLOCK {
            // Bodies of free cells, halos, nuclei, blood.
            let layers = here.layers.map(|l| l[k]);
            let texture = here.texture[k];
            let clear = 1.0 - 0.92 * layers.hole;
            let e = mix(
                eosin[k],
                larger(eosin[k], 0.34 + 0.3 * texture),
                layers.body,
            );
            let e = e * (clear * (1.0 - 0.45 * layers.cover));
            let h = (hema[k] + 0.12 * layers.body) * clear + layers.nucleus * (1.0 - open[k]);
            let b = layers.blood * (1.0 + 0.4 * texture);
            let strength = glass[k] * (1.0 + 0.13 * here.plan(k).tone);
            [hema[k], eosin[k], blood[k]] =
                [h, 1.12 * e, b].map(|amount| larger(amount * strength, 0.0));
        }
        [hema, eosin, blood]
    }
}

impl<T> Grain<T> {
    #[inline(always)]
    fn map<'a, U>(&'a self, f: impl Fn(&'a T) -> U) -> Grain<U> {
        Grain {
            fine: f(&self.fine),
            grain: f(&self.grain),
            clump: f(&self.clump),
            patch: f(&self.patch),
            edge: f(&self.edge),
        }
    }
}

impl<'a> Here<'a> {
    #[inline(always)]
    fn new(ends: [&'a Plan; 2], grain: Grain<&'a Block>, layers: Layers<&'a Block>) -> Self {
        Here {
            ends,
            rough: each(|k| 2.2 * grain.edge[k] + 1.5 * grain.patch[k] + 0.7 * grain.clump[k]),
            texture: each(|k| {
                0.16 * grain.fine[k]
                    + 0.2 * grain.grain[k]
                    + 0.16 * grain.clump[k]
                    + 0.14 * grain.patch[k]
            }),
            grain,
            layers,
        }
    }

    /// The plan at sample `k`.
    #[inline(always)]
    fn plan(&self, k: usize) -> Plan {
        let [left, right] = self.ends;
        Plan::mix(left, right, (k as f32 + 0.5) / BLOCK as f32)
    }

    /// Whether a depth, roughened by a share of the unevenness of borders, may exceed a bound anywhere in the block.
    #[inline(always)]
    fn may_exceed(&self, depth: impl Fn(&Plan) -> f32, bound: f32, share: f32) -> bool {
        let [left, right] = self.ends;
        depth(left).max(depth(right)) + share * MOST_ROUGH > bound
    }

    #[inline(always)]
    fn depth(&self, k: usize) -> f32 {
        self.plan(k).depth + self.rough[k]
    }

    /// Where among the fibres sample `k` lies.
    #[inline(always)]
    fn phase(&self, k: usize) -> f32 {
        let grain = &self.grain;
        self.plan(k).flow + 0.8 * grain.edge[k] + 0.5 * grain.patch[k] + 0.12 * grain.clump[k]
    }
}

/// An open lumen holds a little secretion.
#[inline(always)]
fn secretion(here: &Here, k: usize) -> f32 {
    let grain = &here.grain;
    0.10 * smoothstep(0.3, 1.0, grain.edge[k] + 0.5 * here.plan(k).tone) * (1.0 + grain.clump[k])
}

/// Hematoxylin and eosin of cell bodies. Borders are pale lines, wider where cells are mature.
#[inline(always)]
fn epithelium(here: &Here, k: usize) -> [f32; 2] {
    let layers = here.layers.map(|l| l[k]);
    let mature = smoothstep(15.0, 70.0, here.depth(k)) * (1.0 - here.plan(k).gland);
    let body = smoothstep(0.1, 1.5, layers.second - layers.first);
    let walls = mix(0.78 + 0.22 * body, 0.45 + 0.55 * body, mature);
    let eosin = layers.eosin * walls * (1.0 + here.texture[k]);
    let hema = layers.basophil * (1.0 + 0.8 * here.grain.grain[k] + 0.5 * here.grain.clump[k]);
    [hema, eosin]
}

/// Eosin of fibres, vessel walls and fat cells.
#[inline(always)]
fn stroma(here: &Here, bundle: &Block, fibre: &Block) -> Block {
    let mut eosin = each(|k| fibres(here, k, bundle[k], fibre[k]));
    if here.may_exceed(|p| p.vessel, -5.5, 0.5) {
        eosin = each(|k| {
            // Around vessels a denser, smoother wall; inside them plasma or nothing.
            let vessel = here.plan(k).vessel + 0.5 * here.rough[k];
            let wall = 0.62 * (1.0 + here.texture[k]);
            let eosin = mix(eosin[k], wall, smoothstep(-5.5, -3.0, vessel));
            mix(eosin, 0.05, smoothstep(-0.5, 0.4, vessel))
        });
    }
    if here.may_exceed(|p| p.fat, -1.6, 0.25) {
        eosin = each(|k| {
            // Fat cells: a thin wall around nothing.
            let fat = here.plan(k).fat + 0.25 * here.rough[k];
            let wall = larger(eosin[k], 0.4);
            let eosin = mix(eosin[k], wall, smoothstep(-1.6, -0.4, fat));
            eosin * (1.0 - 0.97 * smoothstep(0.0, 0.7, fat))
        });
    }
    each(|k| {
        // Nests shrink from the stroma here and there.
        let shrunk = 5.0 * smoothstep(0.25, 0.9, here.plan(k).tone + 0.5 * here.grain.edge[k]);
        let gap = smoothstep(-0.6, 0.6, here.depth(k) + shrunk) * smoothstep(0.4, 1.2, shrunk);
        eosin[k] * (1.0 - 0.9 * gap)
    })
}

/// Eosin of fibres. Dense collagen is split by clear lines, loose tissue is drawn by dark ones.
#[inline(always)]
fn fibres(here: &Here, k: usize, bundle: f32, fibre: f32) -> f32 {
    let p = here.plan(k);
    let lax = larger(p.loose, 0.75 * p.inflamed);
    let split = 1.0 - lesser(4.5 * bundle.abs(), 1.0);
    let thread = 1.0 - lesser(3.2 * fibre.abs(), 1.0);
    let thick = 0.66 + 0.16 * bundle + 0.17 * fibre - 0.42 * split;
    let thin = 0.09 + 0.42 * thread * (0.75 + 0.5 * bundle) + 0.42 * smoothstep(0.25, 0.6, bundle);
    mix(thick, thin, lax) * (1.0 + 0.9 * here.texture[k])
}
