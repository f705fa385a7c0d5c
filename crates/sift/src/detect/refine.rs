//! The fit from a sample to its extremum.

use fearless_simd::Simd;

use super::extremum::Extremum;
use super::neighbourhood::Neighbourhood;
use super::quadratic::Quadratic;
use super::response_threshold::ResponseThreshold;
use super::scan::{BORDER, Hit, LEAST_SHARE, Scan};
use crate::scale_space::WINDOW;

/// Moves of the quadratic fit to a neighbouring sample.
const MAX_MOVES: usize = 5;

/// Rows and columns that the moves may lead away; four more are looked at around the last place.
const REACH: usize = WINDOW - 4;

/// The fit moves on when it points further than this. A little over one half, or an extremum midway between two samples
/// would be sent back and forth.
const MOVE_BEYOND: f64 = 0.6;

/// Follows the quadratic fit from a sample to its extremum; `None` when it leads away, is too weak, lies on an edge or is below the
/// threshold.
#[expect(
    clippy::too_many_lines,
    reason = "a kernel: in parts, each with its arguments, the fit would be longer and no clearer"
)]
#[inline(always)]
pub(super) fn refine<S: Simd>(
    s: S,
    around: &Neighbourhood<'_>,
    scan: &Scan<'_>,
    start: Hit,
    threshold: &mut ResponseThreshold,
) -> Option<Extremum> {
    let Scan {
        options,
        ref thresholds,
        octave,
        ref layers,
        ..
    } = *scan;
    let (w, h) = around.levels.size;
    let Hit {
        mut layer,
        mut x,
        mut y,
    } = start;
    let mut value = 0.0;
    let mut moves = 0;
    let (fit, offset) = loop {
        let fit = Quadratic::of(&around.cube_at(layer, x, y));
        if moves == 0 {
            value = fit.value.abs() as f32;
            if value < LEAST_SHARE * threshold.weakest {
                return None;
            }
        }
        let offset = fit.offset()?;
        if offset.iter().all(|o| o.abs() <= MOVE_BEYOND) {
            break (fit, offset);
        }
        if moves == MAX_MOVES || offset.iter().any(|o| o.abs() > w.max(h) as f64) {
            return None;
        }
        moves += 1;
        let step = |from: usize, by: f64| {
            let by = if by.abs() > MOVE_BEYOND {
                by.round() as isize
            } else {
                0
            };
            from.checked_add_signed(by)
        };
        (x, y, layer) = (
            step(x, offset[0])?,
            step(y, offset[1])?,
            step(layer, offset[2])?,
        );
        let inside = (BORDER..w - BORDER).contains(&x) && (BORDER..h - BORDER).contains(&y);
        let near = x.abs_diff(start.x).max(y.abs_diff(start.y)) <= REACH;
        if !inside || !near || !layers.contains(&layer) {
            return None;
        }
    };
    let response = fit.peak(&offset).abs() as f32;
    if value < LEAST_SHARE * response {
        return None;
    }
    if response < thresholds[layer] || !fit.is_blob(f64::from(options.edge_ratio)) {
        return None;
    }
    if response < threshold.weakest {
        return None;
    }
    if moves == 0 {
        // Others that end here have come from elsewhere: only this one is counted.
        threshold.see(response);
    }
    let (mut px, mut py) = (x as f64 + offset[0], y as f64 + offset[1]);
    let mut ps = layer as f64 + offset[2];
    if let Some(again) = Quadratic::of(&around.cube_between(s, layer, px, py)).offset()
        && again[0].abs().max(again[1].abs()) < 0.25
        && (again[2] - offset[2]).abs() < 0.25
    {
        px += again[0];
        py += again[1];
        ps = layer as f64 + again[2];
    }
    Some(Extremum {
        octave,
        layer,
        x: px as f32,
        y: py as f32,
        sigma: options.sigma_at(ps as f32),
        response,
        bright: fit.value < 0.0,
        sample: (x, y),
        moved: moves > 0,
    })
}
