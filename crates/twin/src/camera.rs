//! The twin's camera: when it exposes, what it sees meanwhile, and what it makes of it.

use crate::affine::Affine;
use crate::inner::{Inner, State};
use crate::optics::{View, depth_of_field_um, principal_point};
use crate::render::{blend, instants, render};
use crate::scene::{Planes, Scene};
use crate::sensor::Exposure;
use crate::slide::Effects;
use crate::specimen::Specimen;
use scopeservo_scope::{Camera, CameraInfo, Frame, ScopeError, Timestamp};
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

pub(crate) struct TwinCamera(pub(crate) Arc<Inner>);

/// One frame on its way: when, and what is wrong with it.
struct Slot {
    sequence: u64,
    start: Duration,
    period: Duration,
    exposure: Duration,
    late_by: Duration,
    torn: bool,
}

/// Rows that are exposed at nearly the same time.
struct Band {
    rows: Range<usize>,
    views: Vec<View>,
    smear_px: f64,
}

/// A camera that is silent is given up after this.
const SILENCE: Duration = Duration::from_secs(2);

/// A focus that moves by less than this share of the depth of field during an exposure is seen as that of its middle.
const LEVEL: f64 = 0.25;
/// Instants of an exposure that are looked at, at the most.
const MOST_INSTANTS: usize = 16;

/// Into how many bands a frame is cut whose rows see the image move unevenly.
const BANDS: usize = 8;

/// The map of a view whose rows are exposed one after the other: it goes from what the first row sees to what the last one does.
fn sheared(view: &View, ends: &[View; 2], rows: &Range<usize>, width: usize) -> Affine {
    let (y0, y1) = (rows.start as f64, rows.end as f64);
    let middle = [0.5 * (width as f64 - 1.0), 0.5 * (y0 + y1)];
    let [a, b] = [0, 1].map(|i| ends[i].specimen_from_pixel.apply(middle));
    let per_row = [0, 1].map(|k| (b[k] - a[k]) / (y1 - y0));
    let mut map = view.specimen_from_pixel;
    for (line, per_row) in map.0.iter_mut().zip(per_row) {
        line[1] += per_row;
        line[2] -= per_row * middle[1];
    }
    map
}

impl TwinCamera {
    /// Time from one frame to the next.
    fn period(&self, exposure: Duration) -> Duration {
        let camera = &self.0.config.camera;
        let readout = Duration::from_secs_f64(camera.readout_ms * 1e-3);
        (exposure + readout).max(Duration::from_secs_f64(1.0 / camera.frames_per_s))
    }

    /// Takes the first slot that begins now or later, behind those that are lost.
    fn take_slot(&self) -> Slot {
        let mut state = self.0.state();
        let exposure = state.exposure;
        let period = self.period(exposure);
        let now = self.0.clock.now().since(Timestamp::default());
        let lost = std::mem::take(&mut state.drop_frames);
        let first = now.as_nanos().div_ceil(period.as_nanos()) as u64;
        // 64 bits of nanoseconds are 584 years.
        let start = Duration::from_nanos((first + u64::from(lost)) * period.as_nanos() as u64);
        let sequence = state.next_sequence + u64::from(lost);
        state.next_sequence = sequence + 1;
        let late = state.late_frames > 0;
        state.late_frames = state.late_frames.saturating_sub(1);
        Slot {
            sequence,
            start,
            period,
            exposure,
            late_by: if late { state.late_by } else { Duration::ZERO },
            torn: std::mem::take(&mut state.torn),
        }
    }

    /// What each band of rows sees: one band but on a sensor that is read row by row while its image moves otherwise than evenly.
    fn bands(&self, state: &State, start: f64, exposure: f64) -> Vec<Band> {
        let camera = &self.0.config.camera;
        let rolls = self.rolls();
        let row = |y: usize| start + rolls * y as f64 / camera.height as f64;
        let count = if rolls > 0.0 && self.is_uneven(state, start, start + rolls) {
            BANDS.min(camera.height)
        } else {
            1
        };
        let edge = |i: usize| i * camera.height / count;
        (0..count)
            .map(|i| {
                let rows = edge(i)..edge(i + 1);
                let times = [row(rows.start), row(rows.end)];
                let (views, smear_px) = self.views(state, &rows, times, exposure);
                Band {
                    rows,
                    views,
                    smear_px,
                }
            })
            .collect()
    }

    /// From the first row's exposure to the last one's, s.
    fn rolls(&self) -> f64 {
        let camera = &self.0.config.camera;
        match camera.rolling {
            true => camera.readout_ms * 1e-3,
            false => 0.0,
        }
    }

    /// Whether the image moves by more than a quarter of a pixel otherwise than evenly between two moments, or its focus does at all.
    fn is_uneven(&self, state: &State, from: f64, to: f64) -> bool {
        let camera = &self.0.config.camera;
        let middle = principal_point(camera.width, camera.height);
        let at = |share: f64| self.0.view(state, from + share * (to - from));
        let (first, last) = (at(0.0), at(1.0));
        if self.depths(&[&first, &at(0.5), &last]) >= LEVEL {
            return true;
        }
        let ends = [&first, &last].map(|v| v.specimen_from_pixel.apply(middle));
        (1..2 * BANDS).any(|i| {
            let share = i as f64 / (2 * BANDS) as f64;
            let here = at(share).specimen_from_pixel.apply(middle);
            let off = |k: usize| here[k] - (1.0 - share) * ends[0][k] - share * ends[1][k];
            off(0).hypot(off(1)) > 0.25 * first.um_per_px()
        })
    }

    /// How far the focus moves from view to view, in depths of field.
    fn depths(&self, views: &[&View]) -> f64 {
        let optics = &self.0.config.optics[views[0].objective];
        // While the nosepiece turns there is no light.
        let way = |v: &[&View]| match v[0].objective == v[1].objective {
            true => (v[1].defocus_um - v[0].defocus_um).abs(),
            false => 0.0,
        };
        let all: f64 = views.windows(2).map(way).sum();
        all / depth_of_field_um(optics.numerical_aperture)
    }

    /// The views of one exposure of some rows, which begins with the first at `times[0]` and would with the one after the last at `times[1]`:
    /// what to blend, and how far the image moves between two of them.
    fn views(
        &self,
        state: &State,
        rows: &Range<usize>,
        times: [f64; 2],
        exposure: f64,
    ) -> (Vec<View>, f64) {
        let camera = &self.0.config.camera;
        let at = |share: f64| {
            let [first, last] = times.map(|t| t + share * exposure);
            let mut view = self.0.view(state, 0.5 * (first + last));
            if first < last {
                let ends = [first, last].map(|t| self.0.view(state, t));
                view.specimen_from_pixel = sheared(&view, &ends, rows, camera.width);
            }
            view
        };
        let three = [at(0.0), at(0.5), at(1.0)];
        let (lateral, gap_px) = instants(&three, camera.width, camera.height);
        // What passes through the focus is seen sharp for a moment: the instants lie no farther apart than the depth of field.
        let [first, middle, last] = &three;
        let depths = self.depths(&[first, middle, last]);
        let count = match depths < LEVEL {
            true => lateral,
            false => lateral.max((depths.ceil() as usize).clamp(3, MOST_INSTANTS)),
        };
        if count == 1 {
            let [_, middle, _] = three;
            return (vec![middle], 0.0);
        }
        let views = (0..count)
            .map(|i| at((i as f64 + 0.5) / count as f64))
            .collect();
        // A third of the gap, as a standard deviation, closes it without widening the smear much.
        let gap_px = gap_px * lateral as f64 / count as f64;
        (views, if gap_px > 1.0 { gap_px / 3.0 } else { 0.0 })
    }

    /// What the window lets through, with the hair that drifts past it.
    fn window(&self, state: &State, now: f64) -> Arc<Vec<f32>> {
        match &state.hair {
            None => state.window.clone(),
            Some((hair, since)) => self.0.sensor.behind(&state.window, hair, now - since),
        }
    }

    /// Looks where the microscope stands now and shows nobody: what the specimen makes up when it is first looked at is there afterwards.
    /// Frames and their numbers stay as they were.
    pub(crate) fn look(&self) -> Result<(), ScopeError> {
        let now = self.0.now();
        let (specimen, effects, view) = {
            let state = self.0.state();
            let view = self.0.view(&state, now);
            (state.specimen.clone(), state.slide.effects.clone(), view)
        };
        self.rendered(&*specimen, &effects, &[view], 0.0).map(drop)
    }

    /// The light of a frame, band by band.
    fn light(
        &self,
        specimen: &dyn Specimen,
        effects: &Effects,
        bands: &[Band],
    ) -> Result<Planes, ScopeError> {
        let width = self.0.config.camera.width;
        let mut whole: Option<Planes> = None;
        for band in bands {
            let light = self.rendered(specimen, effects, &band.views, band.smear_px)?;
            let Some(whole) = &mut whole else {
                whole = Some(light);
                continue;
            };
            let pixels = band.rows.start * width..band.rows.end * width;
            for (to, from) in whole.iter_mut().zip(&light) {
                to[pixels.clone()].copy_from_slice(&from[pixels.clone()]);
            }
        }
        Ok(whole.unwrap_or_default())
    }

    fn rendered(
        &self,
        specimen: &dyn Specimen,
        effects: &Effects,
        views: &[View],
        smear_px: f64,
    ) -> Result<Planes, ScopeError> {
        let camera = &self.0.config.camera;
        let mut rendered = Vec::with_capacity(views.len());
        for view in views {
            let scene = Scene {
                specimen,
                effects,
                optics: &self.0.config.optics[view.objective],
                width: camera.width,
                height: camera.height,
            };
            let planes = render(&scene, view, smear_px).map_err(|e| ScopeError::Device {
                device: "camera",
                detail: format!("the simulated specimen could not be read: {e}"),
            })?;
            rendered.push(planes);
        }
        Ok(blend(rendered).unwrap_or_default())
    }
}

impl Camera for TwinCamera {
    fn info(&self) -> &CameraInfo {
        &self.0.camera_info
    }

    fn exposure(&self) -> Result<Duration, ScopeError> {
        Ok(self.0.plugged("camera")?.exposure)
    }

    fn set_exposure(&self, exposure: Duration) -> Result<Duration, ScopeError> {
        self.0.camera_info.check_exposure(exposure)?;
        self.0.plugged("camera")?.exposure = exposure;
        Ok(exposure)
    }

    fn grab(&self) -> Result<Frame, ScopeError> {
        if self.0.plugged("camera")?.shown.silent {
            self.0.clock.sleep(SILENCE);
            return Err(ScopeError::Timeout {
                device: "camera",
                seconds: SILENCE.as_secs_f64(),
            });
        }
        let slot = self.take_slot();
        let camera = &self.0.config.camera;
        let readout = Duration::from_secs_f64(camera.readout_ms * 1e-3);
        let ready = slot.start + slot.exposure + readout + slot.late_by;
        let now = self.0.clock.now().since(Timestamp::default());
        self.0.clock.sleep(ready.saturating_sub(now));

        let (start, exposure) = (slot.start.as_secs_f64(), slot.exposure.as_secs_f64());
        let middle_of_it = start + 0.5 * (self.rolls() + exposure);
        let (specimen, effects, window, level, place, middle, bands, older) = {
            let mut state = self.0.state();
            let middle = self.0.view(&state, middle_of_it);
            let truth = self.0.truth(&middle, Some(slot.sequence));
            state.truths.insert(slot.sequence, truth);
            let older = slot
                .torn
                .then(|| self.bands(&state, start - slot.period.as_secs_f64(), exposure));
            (
                state.specimen.clone(),
                state.slide.effects.clone(),
                self.window(&state, middle_of_it),
                state.light * state.adapted.factor(start),
                state.stage.reported(middle_of_it),
                middle,
                self.bands(&state, start, exposure),
                older,
            )
        };
        let mut light = self.light(&*specimen, &effects, &bands)?;
        if let Some(older) = older {
            let below = self.light(&*specimen, &effects, &older)?;
            let half = camera.width * (camera.height / 2);
            for (l, b) in light.iter_mut().zip(&below) {
                l[half..].copy_from_slice(&b[half..]);
            }
        }
        let samples = self.0.sensor.develop(
            &light,
            &self.0.config.optics[middle.objective],
            &Exposure {
                // Half the light is as dark as half the exposure.
                ms: exposure * 1e3 * level,
                lit: middle.lit,
                sequence: slot.sequence,
                window: &window,
                place: &place,
            },
        );
        let mut state = self.0.state();
        state.adapted.see(camera, &samples, start);
        let taken = Frame {
            width: camera.width,
            height: camera.height,
            channels: camera.channels,
            bit_depth: camera.bit_depth,
            samples,
            sequence: slot.sequence,
            exposure_start: Timestamp::from_start(slot.start),
            exposure: slot.exposure,
        };
        Ok(state.shown.show(taken))
    }
}
