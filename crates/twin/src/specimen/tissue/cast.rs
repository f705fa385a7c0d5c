//! Cells onto samples: bodies and their borders, halos, nuclei. Each layer is a minimum or maximum over cells, so their
//! order does not matter.

use super::cells::{Cell, Kind, REACH_UM};
use super::noise::{norm, smoothstep};
use super::plan::SAMPLE_UM;

/// Distance, micrometres, from which a cell no longer counts as a neighbour.
const FAR: f32 = 11.0;

/// What the cells leave on every sample.
pub(super) struct Layers {
    /// Distance to the nearest and second nearest epithelial cell, in its own metric.
    pub(super) first: Vec<f32>,
    pub(super) second: Vec<f32>,
    /// Staining of the nearest epithelial cell's body.
    pub(super) eosin: Vec<f32>,
    pub(super) basophil: Vec<f32>,
    /// Hematoxylin of nuclei, and how much nucleus there is.
    pub(super) nucleus: Vec<f32>,
    pub(super) cover: Vec<f32>,
    /// Pale halos and vacuoles.
    pub(super) hole: Vec<f32>,
    /// Bodies of lymphocytes, red cells.
    pub(super) body: Vec<f32>,
    pub(super) blood: Vec<f32>,
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

/// What all cells leave on a window.
pub(super) fn cast(
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
        cell.nucleus[0] + 0.9
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
            let q = norm((dx * c + dy * s) / root, (dy * c - dx * s) * root) + 0.5 * clump[at];
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
    let shift = norm(cell.offset[0], cell.offset[1]);
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
            let along = x * (1.0 / a);
            let e = if cell.kind == Kind::Fibroblast {
                // A bent spindle: a lens between two parabolas.
                (y - cell.bend * a * along * along).abs() * (1.0 / b) + along * along
            } else {
                norm(along, y * (1.0 / b))
            };
            let e = e + 0.12 * clump[at];
            if e > 1.0 + soft {
                continue;
            }
            let cover = smoothstep(1.0 + soft, 1.0 - soft, e);
            let rim = smoothstep(0.6, 0.92, e);
            let chromatin = cell.chromatin * (0.7 * grain[at] + 0.4 * clump[at]);
            let [nx, ny, nr] = cell.nucleolus;
            let spot = if nr > 0.0 {
                smoothstep(nr + 0.3, nr - 0.3, norm(x - nx, y - ny))
            } else {
                0.0
            };
            let shade = 0.82 + cell.rim * (rim - 0.3) + chromatin + 0.55 * spot;
            let amount = cell.hematoxylin * shade.max(0.42);
            layers.nucleus[at] = layers.nucleus[at].max(cover * amount);
            layers.cover[at] = layers.cover[at].max(cover);
        }
    }
}
