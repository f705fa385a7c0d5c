//! From the middle of the image outwards: where the next cells should lie is known from those before, to much less than half a period.

use super::cells::{Cell, Flat, corner_px};
use super::fit::{GridFit, Node, fit_grid, fit_roughly};
use super::light::Light;
use super::model::Model;
use super::types::NoGrid;
use scopeservo_features::GrayImage;
use scopeservo_geometry::{Mat2, Vec2};

/// The first look takes in what lies within so many periods of the image's centre, each next one so much more.
const FIRST: f64 = 1.8;
const MORE: f64 = 1.5;
/// A cell is as bright and has as much contrast as most others, to so many standard deviations of them; and to a share, where they are all
/// alike.
const ALIKE: f64 = 4.0;
const LEAST: [f64; 3] = [0.005, 0.02, 0.02];
/// What lies farther from where it should than this is no cell of the grid, periods.
const OFF: f64 = 0.35;
/// Where fewer cells lie in the image than this, windows one period wide are laid half a period apart: none of the image is wasted.
const FEW: f64 = 100.0;
/// Looks at the whole image: each knows the map, and the light, from the one before.
const WHOLE: usize = 3;

/// What was seen of a grid.
pub(super) struct Seen {
    pub(super) fit: Option<GridFit>,
    /// Cells that lie in the image whole.
    pub(super) in_view: usize,
}

/// Where windows are laid, and what of each is news.
#[derive(Clone, Copy)]
struct Windows {
    step: f64,
    share: f64,
}

/// Looks at the grid with these two periods, px.
pub(super) fn look_from(image: &GrayImage, basis: Mat2, needed: usize) -> Result<Seen, NoGrid> {
    let mean = image.data().iter().map(|v| f64::from(*v)).sum::<f64>() / image.data().len() as f64;
    if mean.is_nan() || mean <= 0.0 {
        return Err(NoGrid::NothingRepeats);
    }
    let corner_px = corner_px(image.width(), image.height());
    let mut light = Light::even(mean, corner_px);
    let mut flat = Flat::new(image, &light);
    let windows = match image.data().len() as f64 / basis.det().abs() < FEW {
        true => Windows {
            step: 0.5,
            share: 0.25,
        },
        false => Windows {
            step: 1.0,
            share: 1.0,
        },
    };
    let mut model =
        begin(&flat, basis, corner_px).ok_or(NoGrid::TooFewNodes { found: 0, needed })?;
    let pitch_px = basis.det().abs().sqrt();
    let mut radius_px = FIRST * pitch_px;
    while radius_px < corner_px {
        let nodes = nodes_of(&model, &cells(&flat, &model, windows.step, radius_px));
        // Too few so far: those farther out may say more.
        model = fit_roughly(model, &nodes, windows.share).unwrap_or(model);
        radius_px *= MORE;
    }
    let mut seen = Seen {
        fit: None,
        in_view: 0,
    };
    for look in 1..=WHOLE {
        let cells = cells(&flat, &model, windows.step, corner_px);
        let nodes = nodes_of(&model, &cells);
        seen = Seen {
            fit: fit_grid(model, &nodes, windows.share),
            in_view: (windows.share * cells.len() as f64).round() as usize,
        };
        let Some(fit) = &seen.fit else { break };
        model = fit.model;
        if look == WHOLE {
            break;
        }
        let means = cells.iter().map(|(n, cell)| {
            let p = model.seen(*n);
            (p, cell.mean * light.at(p))
        });
        if let Some(better) = Light::through(&means.collect::<Vec<_>>(), windows.share, corner_px) {
            flat = Flat::new(image, &better);
            light = better;
        }
    }
    Ok(seen)
}

/// Where the grid lies about the image's centre: by the waves of all cells around it.
fn begin(flat: &Flat, basis: Mat2, corner_px: f64) -> Option<Model> {
    let model = Model::affine(basis, [0.0; 2], corner_px);
    let around = cells(flat, &model, 0.5, FIRST * basis.det().abs().sqrt());
    let sum = |k: usize, i: usize| around.iter().map(|(_, cell)| cell.waves[k][i]).sum();
    let waves = [0, 1].map(|k| [0, 1].map(|i| sum(k, i)));
    if around.is_empty() {
        return None;
    }
    let off = Cell { mean: 1.0, waves }.off();
    Some(Model {
        offset_px: basis * off,
        ..model
    })
}

/// The windows, `step` periods apart, within a radius of the image's centre that lie in it whole, row by row.
fn cells(flat: &Flat, model: &Model, step: f64, radius_px: f64) -> Vec<(Vec2, Cell)> {
    let Some(inverse) = model.pixel_from_lattice.inverse() else {
        return Vec::new();
    };
    let middle = inverse * model.offset_px.map(|v| -v);
    // A little farther, for what distortion brings in.
    let reach = |k: usize| {
        let [a, b] = inverse.0[k];
        let r = 1.2 * radius_px * a.hypot(b);
        ((middle[k] - r) / step).floor() as i64..=((middle[k] + r) / step).ceil() as i64
    };
    let all = reach(1).flat_map(|j| reach(0).map(move |i| [i, j].map(|v| step * v as f64)));
    let within = all.filter(|n| {
        let [x, y] = model.seen(*n);
        x.hypot(y) <= radius_px && flat.holds(model, *n)
    });
    within
        .filter_map(|n| Some((n, flat.cell(model, n)?)))
        .collect()
}

/// Those that look like most others: what is covered in part is moved by what covers it.
fn nodes_of(model: &Model, cells: &[(Vec2, Cell)]) -> Vec<Node> {
    let looks = |cell: &Cell| {
        let [a, b] = cell.amplitudes();
        [cell.mean, a, b]
    };
    let middle = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or_default()
    };
    let of_all = |k: usize| cells.iter().map(move |(_, cell)| looks(cell)[k]);
    let usual = [0, 1, 2].map(|k| {
        let median = middle(of_all(k).collect());
        let spread = middle(of_all(k).map(|v| (v - median).abs()).collect()) / 0.6745;
        (median, ALIKE * spread.max(LEAST[k] * median))
    });
    let like_most = |cell: &Cell| {
        let looks = looks(cell).into_iter().zip(usual);
        looks
            .into_iter()
            .all(|(v, (median, most))| (v - median).abs() <= most)
            && cell.off().iter().all(|o| o.abs() <= OFF)
    };
    let nodes = cells.iter().filter(|(_, cell)| like_most(cell));
    nodes
        .map(|(n, cell)| {
            let (p, off) = (model.seen(*n), model.local(*n) * cell.off());
            Node {
                n: *n,
                p_px: [p[0] + off[0], p[1] + off[1]],
            }
        })
        .collect()
}
