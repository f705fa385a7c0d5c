//! Cells onto samples: bodies and their borders, halos, nuclei. Each layer is a minimum or maximum over cells, so their
//! order does not matter.

use super::cells::{Cell, Kind, REACH_UM};
use super::noise::{MOST, larger, lesser, norm, smoothstep};
use super::plan::SAMPLE_UM;
use std::array;
use std::ops::Range;

/// Distance, micrometres, from which a cell no longer counts as a neighbour.
const FAR: f32 = 11.0;

/// What the cells leave on every sample: of a band, a block or one sample.
#[derive(Default)]
pub(super) struct Layers<T> {
    /// Distance to the nearest and second nearest epithelial cell, in its own metric.
    pub(super) first: T,
    pub(super) second: T,
    /// Staining of the nearest epithelial cell's body.
    pub(super) eosin: T,
    pub(super) basophil: T,
    /// Hematoxylin of nuclei, and how much nucleus there is.
    pub(super) nucleus: T,
    pub(super) cover: T,
    /// Pale halos and vacuoles.
    pub(super) hole: T,
    /// Bodies of lymphocytes, red cells.
    pub(super) body: T,
    pub(super) blood: T,
}

impl<T> Layers<T> {
    /// The same layers of something else.
    #[inline(always)]
    pub(super) fn map<'a, U>(&'a self, f: impl Fn(&'a T) -> U) -> Layers<U> {
        Layers {
            first: f(&self.first),
            second: f(&self.second),
            eosin: f(&self.eosin),
            basophil: f(&self.basophil),
            nucleus: f(&self.nucleus),
            cover: f(&self.cover),
            hole: f(&self.hole),
            body: f(&self.body),
            blood: f(&self.blood),
        }
    }
}

impl Layers<Vec<f32>> {
    /// What no cell leaves on `n` samples.
    fn clear(&mut self, n: usize) {
        for (layer, value) in [
            (&mut self.first, FAR),
            (&mut self.second, FAR),
            (&mut self.eosin, 0.95),
            (&mut self.basophil, 0.05),
            (&mut self.nucleus, 0.0),
            (&mut self.cover, 0.0),
            (&mut self.hole, 0.0),
            (&mut self.body, 0.0),
            (&mut self.blood, 0.0),
        ] {
            layer.clear();
            layer.resize(n, value);
        }
    }
}

/// A rectangle of samples.
struct Area {
    columns: Range<usize>,
    rows: Range<usize>,
}

/// A cell seen from the first sample of a window.
struct Seen<'a> {
    cell: &'a Cell,
    /// From the cell to the window's first sample. Exact: places are multiples of 1/256 um.
    from: [f32; 2],
    /// The window's samples within the reach of the cell along both axes.
    area: Area,
}

impl<'a> Seen<'a> {
    /// The cell if any sample of the window is within `reach` micrometres of it along both axes.
    fn new(cell: &'a Cell, reach: f64, [i0, j0]: [i64; 2], [w, h]: [usize; 2]) -> Option<Self> {
        let span = |centre: f64, first: i64, n: usize| {
            let low = ((centre - reach) / SAMPLE_UM - 0.5).ceil() as i64 - first;
            let high = ((centre + reach) / SAMPLE_UM - 0.5).floor() as i64 + 1 - first;
            low.clamp(0, n as i64) as usize..high.clamp(0, n as i64) as usize
        };
        let (columns, rows) = (span(cell.u, i0, w), span(cell.v, j0, h));
        let from = |first: i64, centre: f64| ((first as f64 + 0.5) * SAMPLE_UM - centre) as f32;
        (!columns.is_empty() && !rows.is_empty()).then_some(Seen {
            cell,
            from: [from(i0, cell.u), from(j0, cell.v)],
            area: Area { columns, rows },
        })
    }

    /// From the cell to a column and to a row.
    #[inline(always)]
    fn dx(&self, column: usize) -> f32 {
        self.from[0] + column as f32 * SAMPLE_UM as f32
    }

    #[inline(always)]
    fn dy(&self, row: usize) -> f32 {
        self.from[1] + row as f32 * SAMPLE_UM as f32
    }

    /// The reached samples of a row that may lie within a box along the cell's axes, given by its ends.
    fn within(&self, row: usize, along: [f32; 2], across: [f32; 2]) -> Range<usize> {
        let [c, s] = self.cell.axis;
        let dy = self.dy(row);
        let (mut low, mut high) = (f32::NEG_INFINITY, f32::INFINITY);
        // Where dx * slope + offset lies between the ends.
        for ([from, to], slope, offset) in [(along, c, dy * s), (across, -s, dy * c)] {
            if slope.abs() > 0.05 {
                let (a, b) = ((from - offset) / slope, (to - offset) / slope);
                (low, high) = (low.max(a.min(b)), high.min(a.max(b)));
            }
        }
        // A sample more at either end makes up for rounding.
        let column = |dx: f32| (dx - self.from[0]) * (1.0 / SAMPLE_UM as f32);
        let Range { start, end } = self.area.columns;
        let first = ((column(low) - 1.0) as usize).clamp(start, end);
        first..((column(high) + 2.0) as usize).clamp(first, end)
    }
}

/// What all cells leave on a window, whose columns are a multiple of [`SIDE`].
pub(super) fn cast(
    cells: &[Cell],
    origin: [i64; 2],
    size: [usize; 2],
    grain: &[f32],
    clump: &[f32],
    layers: &mut Layers<Vec<f32>>,
) {
    layers.clear(size[0] * size[1]);
    cast_bodies(cells, origin, size, layers);
    for cell in cells {
        if cell.kind != Kind::Fibroblast && cell.kind != Kind::Epithelial || cell.hole > 0.0 {
            cast_disc(cell, origin, size, clump, layers);
        }
        if cell.nucleus[0] > 0.0 {
            cast_nucleus(cell, origin, size, grain, clump, layers);
        }
    }
}

/// Side of the squares of samples for which it is decided whether a cell is near enough to matter.
const SIDE: usize = 8;
/// A cell farther than the nearest by more than this is no neighbour: [`paint`](super::paint) looks at differences of up
/// to 1.5.
const NEIGHBOUR: f32 = 1.6;

/// Nearest and second nearest cell: the borders of a Voronoi diagram in which every cell has its own metric.
fn cast_bodies(cells: &[Cell], origin: [i64; 2], size: [usize; 2], layers: &mut Layers<Vec<f32>>) {
    let bodies: Vec<Body> = cells
        .iter()
        .filter(|cell| cell.kind == Kind::Epithelial)
        .filter_map(|cell| Body::new(cell, origin, size))
        .collect();
    let across = size[0].div_ceil(SIDE);
    // No sample of a square is farther than this from its nearest cell.
    let mut near = vec![FAR; across * size[1].div_ceil(SIDE)];
    for body in &bodies {
        body.squares(|x, y, area| {
            let whole = area.columns.len() == SIDE.min(size[0] - x * SIDE)
                && area.rows.len() == SIDE.min(size[1] - y * SIDE);
            if whole {
                let near = &mut near[y * across + x];
                *near = near.min(body.centre(x, y) + body.radius);
            }
        });
    }
    for body in &bodies {
        body.squares(|x, y, area| {
            let nearest = body.centre(x, y) - body.radius;
            if nearest < FAR.min(near[y * across + x] + NEIGHBOUR) {
                body.cast(&area, size[0], layers);
            }
        });
    }
}

/// An epithelial cell's body and its metric.
struct Body<'a> {
    seen: Seen<'a>,
    long: f32,
    wide: f32,
    /// No sample of a square is farther than this from its centre.
    radius: f32,
}

impl<'a> Body<'a> {
    fn new(cell: &'a Cell, origin: [i64; 2], size: [usize; 2]) -> Option<Self> {
        let reach = (f64::from(FAR) * f64::from(cell.stretch.sqrt())).min(REACH_UM);
        let mut body = Body {
            seen: Seen::new(cell, reach, origin, size)?,
            long: 1.0 / cell.stretch.sqrt(),
            wide: cell.stretch.sqrt(),
            radius: 0.0,
        };
        let half = 0.5 * (SIDE - 1) as f32 * SAMPLE_UM as f32;
        // A little more makes up for rounding.
        body.radius = body.distance(half, half).max(body.distance(half, -half)) + 0.01;
        Some(body)
    }

    /// Length of a vector in the cell's metric.
    #[inline(always)]
    fn distance(&self, dx: f32, dy: f32) -> f32 {
        let [c, s] = self.seen.cell.axis;
        let along = (dx * c + dy * s) * self.long;
        let across = (dy * c - dx * s) * self.wide;
        (along * along + across * across).sqrt()
    }

    /// Distance of the middle of a square.
    #[inline(always)]
    fn centre(&self, x: usize, y: usize) -> f32 {
        let half = 0.5 * (SIDE - 1) as f32 * SAMPLE_UM as f32;
        self.distance(self.seen.dx(x * SIDE) + half, self.seen.dy(y * SIDE) + half)
    }

    /// Every square that the cell may reach, by column and row, and the samples of it within reach.
    #[inline(always)]
    fn squares(&self, mut f: impl FnMut(usize, usize, Area)) {
        let Area { columns, rows } = &self.seen.area;
        let part = |k: usize, whole: &Range<usize>| {
            whole.start.max(k * SIDE)..whole.end.min((k + 1) * SIDE)
        };
        for y in rows.start / SIDE..rows.end.div_ceil(SIDE) {
            for x in columns.start / SIDE..columns.end.div_ceil(SIDE) {
                f(
                    x,
                    y,
                    Area {
                        columns: part(x, columns),
                        rows: part(y, rows),
                    },
                );
            }
        }
    }

    /// Onto the samples of one square that are within reach.
    fn cast(&self, area: &Area, width: usize, layers: &mut Layers<Vec<f32>>) {
        let cell = self.seen.cell;
        let from = area.columns.start / SIDE * SIDE;
        for row in area.rows.clone() {
            let (dx, dy) = (self.seen.dx(from), self.seen.dy(row));
            let mut q: [f32; SIDE] =
                array::from_fn(|k| self.distance(dx + k as f32 * SAMPLE_UM as f32, dy));
            if area.columns.len() < SIDE {
                for (k, q) in q.iter_mut().enumerate() {
                    *q = if area.columns.contains(&(from + k)) {
                        *q
                    } else {
                        FAR
                    };
                }
            }
            let at = (row * width + from) / SIDE;
            let first = &mut layers.first.as_chunks_mut::<SIDE>().0[at];
            let second = &mut layers.second.as_chunks_mut::<SIDE>().0[at];
            let eosin = &mut layers.eosin.as_chunks_mut::<SIDE>().0[at];
            let basophil = &mut layers.basophil.as_chunks_mut::<SIDE>().0[at];
            for k in 0..SIDE {
                let (f, q) = (first[k], q[k]);
                second[k] = lesser(second[k], larger(f, q));
                first[k] = lesser(f, q);
                eosin[k] = if q < f { cell.eosin } else { eosin[k] };
                basophil[k] = if q < f { cell.basophil } else { basophil[k] };
            }
        }
    }
}

/// Vacuole, body of a lymphocyte or red cell.
fn cast_disc(
    cell: &Cell,
    origin: [i64; 2],
    size: [usize; 2],
    clump: &[f32],
    layers: &mut Layers<Vec<f32>>,
) {
    let radius = if cell.kind == Kind::Lymphocyte {
        cell.nucleus[0] + 0.9
    } else {
        cell.hole
    };
    let reach = f64::from(radius) * 1.3 + 1.0;
    let Some(seen) = Seen::new(cell, reach, origin, size) else {
        return;
    };
    let [c, s] = cell.axis;
    let root = cell.stretch.sqrt();
    let layer = match cell.kind {
        Kind::Epithelial => &mut layers.hole,
        Kind::RedCell => &mut layers.blood,
        _ => &mut layers.body,
    };
    let most = radius + 0.45 + 0.5 * MOST;
    let (along, across) = (most * root, most / root);
    for row in seen.area.rows.clone() {
        let dy = seen.dy(row);
        let columns = seen.within(row, [-along, along], [-across, across]);
        let dx0 = seen.dx(columns.start);
        let span = row * size[0] + columns.start..row * size[0] + columns.end;
        let samples = layer[span.clone()].iter_mut().zip(&clump[span]);
        for (k, (layer, clump)) in samples.enumerate() {
            let dx = dx0 + k as f32 * SAMPLE_UM as f32;
            let q = norm((dx * c + dy * s) / root, (dy * c - dx * s) * root) + 0.5 * clump;
            let disc = smoothstep(radius + 0.45, radius - 0.45, q);
            // Red cells are thinner in the middle.
            let thick = if cell.kind == Kind::RedCell {
                cell.eosin * (0.55 + 0.25 * lesser(q / radius, 1.0))
            } else {
                1.0
            };
            *layer = larger(*layer, disc * thick);
        }
    }
}

fn cast_nucleus(
    cell: &Cell,
    origin: [i64; 2],
    size: [usize; 2],
    grain: &[f32],
    clump: &[f32],
    layers: &mut Layers<Vec<f32>>,
) {
    let [a, b] = cell.nucleus;
    let [ox, oy] = cell.offset;
    let shift = norm(ox, oy);
    let reach = f64::from(a * 1.35 + 0.8 + shift).min(REACH_UM);
    let Some(seen) = Seen::new(cell, reach, origin, size) else {
        return;
    };
    let [c, s] = cell.axis;
    let [nx, ny, nr] = cell.nucleolus;
    let soft = 0.45 / b;
    let (along, across) = extent(cell, 1.0 + soft);
    for row in seen.area.rows.clone() {
        let dy = seen.dy(row) - oy;
        let columns = seen.within(row, along, across);
        let dx0 = seen.dx(columns.start);
        let span = row * size[0] + columns.start..row * size[0] + columns.end;
        let noise = grain[span.clone()].iter().zip(&clump[span.clone()]);
        let nucleus = &mut layers.nucleus[span.clone()];
        let samples = nucleus.iter_mut().zip(&mut layers.cover[span]).zip(noise);
        for (k, ((nucleus, covered), (grain, clump))) in samples.enumerate() {
            let dx = dx0 + k as f32 * SAMPLE_UM as f32 - ox;
            let (x, y) = (dx * c + dy * s, dy * c - dx * s);
            let along = x * (1.0 / a);
            let e = if cell.kind == Kind::Fibroblast {
                // A bent spindle: a lens between two parabolas.
                (y - cell.bend * a * along * along).abs() * (1.0 / b) + along * along
            } else {
                norm(along, y * (1.0 / b))
            };
            let e = e + 0.12 * clump;
            let cover = smoothstep(1.0 + soft, 1.0 - soft, e);
            let rim = smoothstep(0.6, 0.92, e);
            let chromatin = cell.chromatin * (0.7 * grain + 0.4 * clump);
            let spot = if nr > 0.0 {
                smoothstep(nr + 0.3, nr - 0.3, norm(x - nx, y - ny))
            } else {
                0.0
            };
            let shade = 0.82 + cell.rim * (rim - 0.3) + chromatin + 0.55 * spot;
            let amount = cell.hematoxylin * larger(shade, 0.42);
            *nucleus = larger(*nucleus, cover * amount);
            *covered = larger(*covered, cover);
        }
    }
}

/// How far along and across its axis from a cell's place its nucleus can reach, up to where its shape falls to `edge`.
fn extent(cell: &Cell, edge: f32) -> ([f32; 2], [f32; 2]) {
    let ([a, b], [c, s], [ox, oy]) = (cell.nucleus, cell.axis, cell.offset);
    let most = edge + 0.12 * MOST;
    let (along, across, bent) = if cell.kind == Kind::Fibroblast {
        (a * most.sqrt(), b * most, cell.bend * a * most)
    } else {
        (a * most, b * most, 0.0)
    };
    let (x, y) = (ox * c + oy * s, oy * c - ox * s);
    (
        [x - along, x + along],
        [y - across + bent.min(0.0), y + across + bent.max(0.0)],
    )
}
