//! Bands of rows: the levels of an octave made on all threads, with the extrema that are found on the way.

use rayon::prelude::*;

use crate::Simd;
use crate::detect::{Extremum, ResponseThreshold, Scan, Scanner};
use crate::scale_space::{Chain, Plane, Scratch};
use crate::simd::at_level;

/// Fewer rows than this are not worth a thread: its overlap with the neighbours would be most of the work.
const LEAST_ROWS: usize = 64;

/// What a thread needs to make its rows of an octave.
#[derive(Debug, Default)]
pub(super) struct Band {
    scratch: Scratch,
    scanner: Scanner,
}

/// Makes the levels of `chain`, band by band on all threads, with what is kept of them in `planes`, and looks for extrema on the
/// way. Returns the bands that were needed.
pub(super) fn run<'a>(
    simd: Simd,
    chain: &Chain<'_>,
    planes: Vec<&mut Plane>,
    bands: &'a mut Vec<Band>,
    scan: Option<&Scan<'_>>,
) -> &'a mut [Band] {
    let (w, h) = chain.size;
    let count = rayon::current_num_threads().min(h / LEAST_ROWS).max(1);
    let rows = h.div_ceil(count).next_multiple_of(2);
    let mut parts: Vec<Vec<&mut [f32]>> = Vec::new();
    parts.resize_with(h.div_ceil(rows), Vec::new);
    for (plane, kept) in planes.into_iter().zip(&chain.kept) {
        plane.resize(kept.count(w), kept.count(h));
        plane.pitch = if kept.halved { 2 } else { 1 };
        let rows = plane.data.chunks_mut(kept.count(rows) * kept.count(w));
        for (part, rows) in parts.iter_mut().zip(rows) {
            part.push(rows);
        }
    }
    if bands.len() < parts.len() {
        bands.resize_with(parts.len(), Band::default);
    }
    let bands = &mut bands[..parts.len()];
    let work = |(i, (band, mut planes)): (usize, (&mut Band, Vec<&mut [f32]>))| {
        let rows = i * rows..((i + 1) * rows).min(h);
        let Band { scratch, scanner } = band;
        if let Some(scan) = scan {
            scanner.begin(scan);
        }
        for columns in Chain::tiles(w) {
            at_level!(simd, s => chain.sweep(
                s,
                rows.clone(),
                columns,
                scratch,
                &mut planes,
                #[inline(always)]
                |levels, y| {
                    if let Some(scan) = scan {
                        scanner.visit(s, scan, levels, y);
                    }
                },
            ));
        }
    };
    bands.par_iter_mut().zip(parts).enumerate().for_each(work);
    bands
}

/// Adds what the bands of an octave have found and may be strong enough; what two samples have led to comes twice.
pub(super) fn gather(
    bands: &mut [Band],
    found: &mut Vec<Extremum>,
    threshold: &mut ResponseThreshold,
) {
    let mut weakest = 0.0_f32;
    for band in bands.iter_mut() {
        weakest = weakest.max(band.scanner.found().1);
    }
    for band in bands {
        for e in band.scanner.found().0 {
            if e.response < weakest {
                continue;
            }
            found.push(*e);
            if !e.moved {
                threshold.see(e.response);
            }
        }
    }
}
