//! Single pairs of frames, as `register` sees them: no move can be made.

use crate::Outcome;
use crate::run::{Bench, Record, code};
use crate::scene::Scene;
use scopeservo_features::{Engine, GrayImage};
use scopeservo_registration::{Allow, Options, PictureVerdict, Prior, register_pictures};
use scopeservo_scope::Frame;
use scopeservo_twin::Truth;

/// Where the view's centre lies in the target, its sigma in px and the inliers; or why it is not told.
type Found = Result<([f64; 2], f64, usize), String>;

/// One look, with the program's defaults.
fn look(view: &Frame, target: &Frame) -> Outcome<Found> {
    let (engine, most) = (Engine::default(), 2000);
    let gray = |frame: &Frame| GrayImage::new(frame.width, frame.height, frame.luminance());
    let (view_image, target_image) = (gray(view)?, gray(target)?);
    let seen = engine.features(&view_image, most)?;
    let wanted = engine.features(&target_image, most)?;
    let (answer, verdict) = register_pictures(
        (&*engine, most),
        (&view_image, &seen),
        (&target_image, &wanted),
        &Prior::default(),
        &Options::default(),
        Allow::default(),
    )?;
    Ok(match verdict {
        PictureVerdict::Found { estimate, .. } => {
            let centre = estimate.target_from_view.apply(centre_px(view));
            Ok((centre, estimate.sigma_px, answer.inliers))
        }
        PictureVerdict::Suspect { .. } => Err("suspect".into()),
        PictureVerdict::Ambiguous { .. } => Err("ambiguous".into()),
        PictureVerdict::Mirrored { .. } => Err("mirrored".into()),
        PictureVerdict::NotFound(reason) => Err(code(&reason)?),
    })
}

/// Two frames of one scene, the slide put back in between.
pub(crate) fn pair(scene: &Scene, index: u64) -> Outcome<Record> {
    let bench = Bench::at_target(scene, true)?;
    let target = bench.scope.grab()?;
    bench.displace(scene, true)?;
    bench.focus_by_hand()?;
    let view = bench.scope.grab()?;
    let truth = |f: &Frame| {
        bench
            .twin
            .truth(f.sequence)
            .ok_or("the twin forgot a frame")
    };
    let right = pixel_of(&truth(&target)?, truth(&view)?.specimen(centre_px(&view)));
    let mut record = Record::of(scene, index);
    match look(&view, &target)? {
        Ok((centre, sigma_px, inliers)) => {
            let off_px = (centre[0] - right[0]).hypot(centre[1] - right[1]);
            let um_per_px = truth(&target)?.um_per_px;
            record.verdict = "found".into();
            record.true_um = Some(off_px * um_per_px);
            record.claimed_um = Some(sigma_px * um_per_px);
            record.inliers = Some(inliers);
            record.wrong = off_px > 2.0 + 3.0 * sigma_px;
        }
        Err(reason) => {
            record.verdict = "not_found".into();
            record.reason = reason;
        }
    }
    Ok(record)
}

fn centre_px(frame: &Frame) -> [f64; 2] {
    [frame.width, frame.height].map(|n| 0.5 * (n as f64 - 1.0))
}

/// The pixel that shows a specimen point.
fn pixel_of(truth: &Truth, s: [f64; 2]) -> [f64; 2] {
    let [[a, b, x], [c, d, y]] = truth.specimen_from_pixel;
    let det = a * d - b * c;
    let (u, v) = (s[0] - x, s[1] - y);
    [(d * u - b * v) / det, (a * v - c * u) / det]
}
