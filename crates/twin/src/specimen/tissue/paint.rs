//! A window of samples: plan, cells, fibres and grain become amounts of stain, and those colour.

use super::cells::{Cell, Kind, MARGIN_UM, REACH_UM, cells_near};
use super::noise::{lattice, mix, smoothstep, strands};
use super::plan::{PlanGrid, SAMPLE_UM};
use super::stain;

/// Distance, micrometres, from which a cell no longer counts as a neighbour.
const FAR: f32 = 11.0;

/// What the cells leave on every sample.
struct Layers {
    /// Distance to the nearest and second nearest epithelial cell, in its own metric.
    first: Vec<f32>,
    second: Vec<f32>,
    /// Staining of the nearest epithelial cell's body.
    eosin: Vec<f32>,
    basophil: Vec<f32>,
    /// Hematoxylin of nuclei, and how much nucleus there is.
    nucleus: Vec<f32>,
    cover: Vec<f32>,
    /// Pale halos and vacuoles.
    hole: Vec<f32>,
    /// Bodies of lymphocytes, red cells.
    body: Vec<f32>,
    blood: Vec<f32>,
}

/// The colours of samples `i0..i0 + w`, `j0..j0 + h` (columns right, rows down), red first.
pub(super) fn window(seed: u64, [i0, j0]: [i64; 2], [w, h]: [usize; 2]) -> Vec<u8> {
    let plan = PlanGrid::new(seed, [i0, j0], [w, h], MARGIN_UM);
    let cells = cells_near(seed, &plan, [i0, j0], [w, h]);
    let noise = |k: u64, pitch| lattice(seed.wrapping_add(100 + k), pitch, i0, j0, w, h);
    // Pitches without common factors, so that no lattice shows: 0.5, 1.25, 2.75, 7.25 and 18 um.
    let (fine, grain, clump, patch, edge) = (
        noise(0, 2),
        noise(1, 5),
        noise(2, 11),
        noise(3, 29),
        noise(4, 72),
    );
    let layers = cast(&cells, [i0, j0], [w, h], &grain, &clump);

    let mut rgb = vec![0; 3 * w * h];
    let mut rows: [Vec<f32>; 9] = std::array::from_fn(|_| vec![0.0; w]);
    for (j, out) in rgb.chunks_exact_mut(3 * w).enumerate() {
        let row = j0 + j as i64;
        let [
            depth,
            lumen,
            flow,
            inflamed,
            loose,
            vessel,
            fat,
            cleft,
            tone,
        ] = &mut rows;
        plan.row(i0, row, |p| p.depth, depth);
        plan.row(i0, row, |p| p.lumen, lumen);
        plan.row(i0, row, |p| p.flow, flow);
        plan.row(i0, row, |p| p.inflamed, inflamed);
        plan.row(i0, row, |p| p.loose, loose);
        plan.row(i0, row, |p| p.vessel, vessel);
        plan.row(i0, row, |p| p.fat, fat);
        plan.row(i0, row, |p| p.cleft, cleft);
        plan.row(i0, row, |p| p.tone, tone);
        let v = ((row as f64 + 0.5) * SAMPLE_UM) as f32;
        for (i, pixel) in out.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let s = j * w + i;
            let u = ((i0 + i as i64) as f64 * SAMPLE_UM + 0.5 * SAMPLE_UM) as f32;
            let rough = 2.2 * edge[s] + 1.5 * patch[s] + 0.7 * clump[s];
            let d = depth[i] + rough;
            let texture = 0.16 * fine[s] + 0.2 * grain[s] + 0.16 * clump[s] + 0.14 * patch[s];

            let mut eosin = 0.0;
            let mut hema = 0.0;
            let epithelium = smoothstep(-0.7, 0.7, d);
            if epithelium > 0.0 {
                let mature = smoothstep(28.0, 90.0, d);
                let border = layers.second[s] - layers.first[s];
                let inside = smoothstep(0.1, 1.5, border);
                let walls = mix(0.86 + 0.14 * inside, 0.5 + 0.5 * inside, mature);
                let body = layers.eosin[s] * walls * (1.0 + texture);
                eosin = epithelium * body * 1.12;
                hema = epithelium * layers.basophil[s] * (1.0 + 0.8 * grain[s] + 0.5 * clump[s]);
                // An open lumen, with a little secretion.
                let open = smoothstep(-0.6, 0.8, lumen[i] + 0.8 * rough);
                let secretion =
                    0.10 * smoothstep(0.3, 1.0, edge[s] + 0.5 * tone[i]) * (1.0 + clump[s]);
                eosin = mix(eosin, secretion, open);
                hema *= 1.0 - open;
            }
            if epithelium < 1.0 {
                let stroma = 1.0 - epithelium;
                let lax = loose[i].max(0.75 * inflamed[i]);
                let phase = flow[i] + 1.1 * patch[s] + 0.35 * clump[s];
                let bundle = strands(
                    seed,
                    phase * (1.0 / 6.5),
                    u * (1.0 / 41.0),
                    v * (1.0 / 43.0),
                );
                let fibre = strands(
                    seed ^ 0xF1B,
                    phase * (1.0 / 1.9),
                    u * (1.0 / 19.0),
                    v * (1.0 / 17.0),
                );
                let thick = 0.55 * bundle + 0.62 * fibre + 0.18 * grain[s];
                let strand = smoothstep(-0.55 + 0.75 * lax, 0.35 + 0.45 * lax, thick);
                let ground = mix(0.34, 0.05, lax);
                let dense = (ground + (0.72 - 0.12 * lax) * strand) * (1.0 + 0.8 * texture);
                // Around vessels a denser, smoother wall; inside them plasma or nothing.
                let ves = vessel[i] + 0.5 * rough;
                let wall = smoothstep(-5.5, -3.0, ves);
                let inside = smoothstep(-0.5, 0.4, ves);
                let mut e = mix(dense, 0.62 * (1.0 + texture), wall);
                e = mix(e, 0.05, inside);
                // Fat cells: a thin wall around nothing.
                let f = fat[i] + 0.25 * rough;
                e = mix(e, e.max(0.4), smoothstep(-1.6, -0.4, f));
                e *= 1.0 - 0.97 * smoothstep(0.0, 0.7, f);
                // Nests shrink from the stroma here and there.
                let shrunk = 5.0 * smoothstep(0.25, 0.9, tone[i] + 0.5 * edge[s]);
                e *= 1.0
                    - 0.9
                        * smoothstep(-shrunk - 0.6, -shrunk + 0.6, d)
                        * smoothstep(0.4, 1.2, shrunk);
                eosin += stroma * e;
            }
            // Bodies of free cells, then nuclei, halos, blood.
            let body = layers.body[s];
            eosin = mix(eosin, eosin.max(0.42 + 0.3 * texture), body);
            hema += 0.12 * body;
            let clear = 1.0 - 0.92 * layers.hole[s];
            eosin *= clear * (1.0 - 0.45 * layers.cover[s]);
            hema = hema * clear + layers.nucleus[s];
            let blood = layers.blood[s] * (1.0 + 0.4 * texture);
            let glass = smoothstep(0.4, -0.8, cleft[i] + 0.9 * rough);
            let strength = glass * (1.0 + 0.13 * tone[i]);
            *pixel = stain::colour(
                (hema * strength).max(0.0),
                (eosin * strength * 1.15).max(0.0),
                (blood * strength).max(0.0),
            );
        }
    }
    rgb
}

/// Rectangle of samples within `reach` micrometres of a cell, clipped to the window: columns, rows, and the distance of
/// its first sample from the cell. Distances are exact: places are multiples of 1/256 um.
fn reach_of(
    cell: &Cell,
    reach: f64,
    [i0, j0]: [i64; 2],
    [w, h]: [usize; 2],
) -> Option<([usize; 4], [f32; 2])> {
    let span = |centre: f64, first: i64, n: usize| {
        let low = ((centre - reach) / SAMPLE_UM - 0.5).ceil() as i64 - first;
        let high = ((centre + reach) / SAMPLE_UM - 0.5).floor() as i64 + 1 - first;
        (
            low.clamp(0, n as i64) as usize,
            high.clamp(0, n as i64) as usize,
        )
    };
    let ((x0, x1), (y0, y1)) = (span(cell.u, i0, w), span(cell.v, j0, h));
    let from =
        |first: i64, k: usize, centre: f64| ((first + k as i64) as f64 + 0.5) * SAMPLE_UM - centre;
    let start = [from(i0, x0, cell.u) as f32, from(j0, y0, cell.v) as f32];
    (x0 < x1 && y0 < y1).then_some(([x0, x1, y0, y1], start))
}

fn cast(
    cells: &[Cell],
    origin: [i64; 2],
    size: [usize; 2],
    grain: &[f32],
    clump: &[f32],
) -> Layers {
    let n = size[0] * size[1];
    let mut layers = Layers {
        first: vec![FAR; n],
        second: vec![FAR; n],
        eosin: vec![0.95; n],
        basophil: vec![0.05; n],
        nucleus: vec![0.0; n],
        cover: vec![0.0; n],
        hole: vec![0.0; n],
        body: vec![0.0; n],
        blood: vec![0.0; n],
    };
    for cell in cells {
        if cell.kind == Kind::Epithelial {
            cast_body(cell, origin, size, &mut layers);
        }
        if cell.kind != Kind::Fibroblast && cell.kind != Kind::Epithelial || cell.hole > 0.0 {
            cast_disc(cell, origin, size, clump, &mut layers);
        }
        if cell.nucleus[0] > 0.0 {
            cast_nucleus(cell, origin, size, grain, clump, &mut layers);
        }
    }
    layers
}

/// Nearest and second nearest cell: the borders of a Voronoi diagram in which every cell has its own metric.
fn cast_body(cell: &Cell, origin: [i64; 2], size: [usize; 2], layers: &mut Layers) {
    let reach = (f64::from(FAR) * f64::from(cell.stretch.sqrt())).min(REACH_UM);
    let Some(([x0, x1, y0, y1], [dx0, dy0])) = reach_of(cell, reach, origin, size) else {
        return;
    };
    let [c, s] = cell.axis;
    let (long, wide) = (1.0 / cell.stretch.sqrt(), cell.stretch.sqrt());
    for row in y0..y1 {
        let dy = dy0 + (row - y0) as f32 * SAMPLE_UM as f32;
        let span = row * size[0] + x0..row * size[0] + x1;
        let first = &mut layers.first[span.clone()];
        let second = &mut layers.second[span.clone()];
        let eosin = &mut layers.eosin[span.clone()];
        let basophil = &mut layers.basophil[span];
        for (k, (((f, g), e), b)) in first
            .iter_mut()
            .zip(second)
            .zip(eosin)
            .zip(basophil)
            .enumerate()
        {
            let dx = dx0 + k as f32 * SAMPLE_UM as f32;
            let along = (dx * c + dy * s) * long;
            let across = (dy * c - dx * s) * wide;
            let q = (along * along + across * across).sqrt();
            let nearer = q < *f;
            *g = g.min(f.max(q));
            *e = if nearer { cell.eosin } else { *e };
            *b = if nearer { cell.basophil } else { *b };
            *f = f.min(q);
        }
    }
}

/// Vacuole, body of a lymphocyte or red cell.
fn cast_disc(cell: &Cell, origin: [i64; 2], size: [usize; 2], clump: &[f32], layers: &mut Layers) {
    let radius = if cell.kind == Kind::Lymphocyte {
        cell.nucleus[0] + 1.3
    } else {
        cell.hole
    };
    let reach = f64::from(radius) * 1.3 + 1.0;
    let Some(([x0, x1, y0, y1], [dx0, dy0])) = reach_of(cell, reach, origin, size) else {
        return;
    };
    let [c, s] = cell.axis;
    let root = cell.stretch.sqrt();
    for row in y0..y1 {
        let dy = dy0 + (row - y0) as f32 * SAMPLE_UM as f32;
        for column in x0..x1 {
            let dx = dx0 + (column - x0) as f32 * SAMPLE_UM as f32;
            let at = row * size[0] + column;
            let q = ((dx * c + dy * s) / root).hypot((dy * c - dx * s) * root) + 0.5 * clump[at];
            let disc = smoothstep(radius + 0.45, radius - 0.45, q);
            let layer = match cell.kind {
                Kind::Epithelial => &mut layers.hole[at],
                Kind::RedCell => &mut layers.blood[at],
                _ => &mut layers.body[at],
            };
            // Red cells are thinner in the middle.
            let thick = if cell.kind == Kind::RedCell {
                cell.eosin * (0.55 + 0.25 * (q / radius).min(1.0))
            } else {
                1.0
            };
            *layer = layer.max(disc * thick);
        }
    }
}

fn cast_nucleus(
    cell: &Cell,
    origin: [i64; 2],
    size: [usize; 2],
    grain: &[f32],
    clump: &[f32],
    layers: &mut Layers,
) {
    let [a, b] = cell.nucleus;
    let shift = cell.offset[0].hypot(cell.offset[1]);
    let reach = f64::from(a * 1.35 + 0.8 + shift).min(REACH_UM);
    let Some(([x0, x1, y0, y1], [dx0, dy0])) = reach_of(cell, reach, origin, size) else {
        return;
    };
    let [c, s] = cell.axis;
    let soft = 0.45 / b;
    for row in y0..y1 {
        let dy = dy0 + (row - y0) as f32 * SAMPLE_UM as f32 - cell.offset[1];
        for column in x0..x1 {
            let dx = dx0 + (column - x0) as f32 * SAMPLE_UM as f32 - cell.offset[0];
            let at = row * size[0] + column;
            let (x, y) = (dx * c + dy * s, dy * c - dx * s);
            let e = ((x / a) * (x / a) + (y / b) * (y / b)).sqrt() + 0.11 * clump[at];
            if e > 1.0 + soft {
                continue;
            }
            let cover = smoothstep(1.0 + soft, 1.0 - soft, e);
            let rim = smoothstep(0.6, 0.92, e);
            let chromatin = cell.chromatin * (0.55 * grain[at] + 0.5 * clump[at]);
            let [nx, ny, nr] = cell.nucleolus;
            let spot = if nr > 0.0 {
                smoothstep(nr + 0.3, nr - 0.3, (x - nx).hypot(y - ny))
            } else {
                0.0
            };
            let amount =
                cell.hematoxylin * (0.82 + cell.rim * (rim - 0.3) + chromatin + 0.55 * spot);
            layers.nucleus[at] = layers.nucleus[at].max(cover * amount);
            layers.cover[at] = layers.cover[at].max(cover);
        }
    }
}
