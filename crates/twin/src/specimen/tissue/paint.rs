//! A window of samples: plan, cells, fibres and grain become amounts of stain, and those colour.

use super::cast::{Layers, cast};
use super::cells::{MARGIN_UM, cells_near};
use super::noise::{lattice, mix, smoothstep, strands};
use super::plan::{Plan, PlanGrid, SAMPLE_UM};
use super::stain;

/// Noise on every sample, about -1 to 1, standard deviation a half. Pitches in samples without common factors, so that
/// no lattice shows.
struct Grain {
    /// 0.5 um.
    fine: Vec<f32>,
    /// 1.25 um.
    grain: Vec<f32>,
    /// 2.75 um.
    clump: Vec<f32>,
    /// 7.25 um.
    patch: Vec<f32>,
    /// 17.75 um.
    edge: Vec<f32>,
}

/// Amounts of stain on a row of samples.
struct Stains {
    hematoxylin: Vec<f32>,
    eosin: Vec<f32>,
    blood: Vec<f32>,
}

/// Noise at one sample.
#[derive(Clone, Copy)]
struct Here {
    u: f32,
    v: f32,
    grain: f32,
    clump: f32,
    patch: f32,
    edge: f32,
    /// Unevenness of every border, micrometres.
    rough: f32,
    /// Unevenness of every staining, as a share.
    texture: f32,
}

/// The colours of samples `i0..i0 + w`, `j0..j0 + h` (columns right, rows down), red first.
pub(super) fn window(seed: u64, [i0, j0]: [i64; 2], [w, h]: [usize; 2]) -> Vec<u8> {
    let plan = PlanGrid::new(seed, [i0, j0], [w, h], MARGIN_UM);
    let cells = cells_near(seed, &plan, [i0, j0], [w, h]);
    let noise = |k: u64, pitch| lattice(seed.wrapping_add(100 + k), pitch, i0, j0, w, h);
    let grain = Grain {
        fine: noise(0, 2),
        grain: noise(1, 5),
        clump: noise(2, 11),
        patch: noise(3, 29),
        edge: noise(4, 71),
    };
    let layers = cast(&cells, [i0, j0], [w, h], &grain.grain, &grain.clump);

    let mut rgb = vec![0; 3 * w * h];
    let mut plans = vec![Plan::default(); w];
    let zeros = || vec![0.0; w];
    let mut stains = Stains {
        hematoxylin: zeros(),
        eosin: zeros(),
        blood: zeros(),
    };
    for (j, out) in rgb.chunks_exact_mut(3 * w).enumerate() {
        let row = j0 + j as i64;
        plan.row(i0, row, &mut plans);
        let v = ((row as f64 + 0.5) * SAMPLE_UM) as f32;
        for (i, p) in plans.iter().enumerate() {
            let s = j * w + i;
            let u = ((i0 + i as i64) as f64 * SAMPLE_UM + 0.5 * SAMPLE_UM) as f32;
            let [h, e, b] = amounts(seed, p, &grain.at(s, u, v), &layers, s);
            (stains.hematoxylin[i], stains.eosin[i], stains.blood[i]) = (h, e, b);
        }
        stain::colour_row(&stains.hematoxylin, &stains.eosin, &stains.blood, out);
    }
    rgb
}

impl Grain {
    #[inline(always)]
    fn at(&self, s: usize, u: f32, v: f32) -> Here {
        let [fine, grain, clump, patch, edge] = [
            &self.fine,
            &self.grain,
            &self.clump,
            &self.patch,
            &self.edge,
        ]
        .map(|layer| layer[s]);
        Here {
            u,
            v,
            grain,
            clump,
            patch,
            edge,
            rough: 2.2 * edge + 1.5 * patch + 0.7 * clump,
            texture: 0.16 * fine + 0.2 * grain + 0.16 * clump + 0.14 * patch,
        }
    }
}

/// Hematoxylin, eosin and blood of sample `s`, none negative.
#[inline(always)]
fn amounts(seed: u64, p: &Plan, here: &Here, layers: &Layers, s: usize) -> [f32; 3] {
    let glass = smoothstep(0.4, -0.8, p.cleft - p.crack.abs() + 0.9 * here.rough);
    if glass == 0.0 {
        return [0.0; 3];
    }
    let depth = p.depth + here.rough;
    let inside = smoothstep(-0.7, 0.7, depth);
    let open = smoothstep(-0.6, 0.8, p.lumen + 0.8 * here.rough);
    let (mut hema, mut eosin) = (0.0, 0.0);
    if inside > 0.0 {
        let [h, e] = epithelium(p, here, depth, layers, s);
        // An open lumen holds a little secretion.
        let secretion = 0.10 * smoothstep(0.3, 1.0, here.edge + 0.5 * p.tone) * (1.0 + here.clump);
        hema = inside * h * (1.0 - open);
        eosin = inside * mix(e, secretion, open);
    }
    if inside < 1.0 {
        eosin += (1.0 - inside) * stroma(seed, p, here, depth);
    }
    // Bodies of free cells, halos, nuclei, blood.
    let body = layers.body[s];
    let clear = 1.0 - 0.92 * layers.hole[s];
    eosin = mix(eosin, eosin.max(0.34 + 0.3 * here.texture), body);
    eosin *= clear * (1.0 - 0.45 * layers.cover[s]);
    hema = (hema + 0.12 * body) * clear + layers.nucleus[s] * (1.0 - open);
    let blood = layers.blood[s] * (1.0 + 0.4 * here.texture);
    let strength = glass * (1.0 + 0.13 * p.tone);
    [hema, 1.12 * eosin, blood].map(|amount| (amount * strength).max(0.0))
}

/// Hematoxylin and eosin of cell bodies. Borders are pale lines, wider where cells are mature.
#[inline(always)]
fn epithelium(p: &Plan, here: &Here, depth: f32, layers: &Layers, s: usize) -> [f32; 2] {
    let mature = smoothstep(15.0, 70.0, depth) * (1.0 - p.gland);
    let body = smoothstep(0.1, 1.5, layers.second[s] - layers.first[s]);
    let walls = mix(0.78 + 0.22 * body, 0.45 + 0.55 * body, mature);
    let eosin = layers.eosin[s] * walls * (1.0 + here.texture);
    let hema = layers.basophil[s] * (1.0 + 0.8 * here.grain + 0.5 * here.clump);
    [hema, eosin]
}

/// Eosin of fibres, vessel walls and fat cells.
#[inline(always)]
fn stroma(seed: u64, p: &Plan, here: &Here, depth: f32) -> f32 {
    let lax = p.loose.max(0.75 * p.inflamed);
    let phase = p.flow + 0.8 * here.edge + 0.5 * here.patch + 0.12 * here.clump;
    let (u, v) = (here.u, here.v);
    let bundle = strands(
        seed,
        phase * (1.0 / 6.5),
        u * (1.0 / 41.0),
        v * (1.0 / 43.0),
    );
    let fibre = strands(
        seed ^ 0xF1B,
        phase * (1.0 / 2.1),
        u * (1.0 / 23.0),
        v * (1.0 / 19.0),
    );
    // Dense collagen is split by clear lines, loose tissue is drawn by dark ones.
    let split = 1.0 - (4.5 * bundle.abs()).min(1.0);
    let thread = 1.0 - (3.2 * fibre.abs()).min(1.0);
    let thick = 0.66 + 0.16 * bundle + 0.17 * fibre - 0.42 * split;
    let thin = 0.09 + 0.42 * thread * (0.75 + 0.5 * bundle) + 0.42 * smoothstep(0.25, 0.6, bundle);
    let mut eosin = mix(thick, thin, lax) * (1.0 + 0.9 * here.texture);
    // Around vessels a denser, smoother wall; inside them plasma or nothing.
    let vessel = p.vessel + 0.5 * here.rough;
    eosin = mix(
        eosin,
        0.62 * (1.0 + here.texture),
        smoothstep(-5.5, -3.0, vessel),
    );
    eosin = mix(eosin, 0.05, smoothstep(-0.5, 0.4, vessel));
    // Fat cells: a thin wall around nothing.
    let fat = p.fat + 0.25 * here.rough;
    eosin = mix(eosin, eosin.max(0.4), smoothstep(-1.6, -0.4, fat));
    eosin *= 1.0 - 0.97 * smoothstep(0.0, 0.7, fat);
    // Nests shrink from the stroma here and there.
    let shrunk = 5.0 * smoothstep(0.25, 0.9, p.tone + 0.5 * here.edge);
    let gap = smoothstep(-0.6, 0.6, depth + shrunk) * smoothstep(0.4, 1.2, shrunk);
    eosin * (1.0 - 0.9 * gap)
}
