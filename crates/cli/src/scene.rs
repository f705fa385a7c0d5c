//! Where the demo's target lies and how far the slide is displaced: drawn from the seed, judged on the specimen itself.

use crate::error::CliError;
use rand::{RngExt, SeedableRng};
use scopeservo_twin::specimen::{Specimen, texture_share};

/// Size of the 400x view on the specimen, um, a little more than it is.
pub(crate) const TARGET_FIELD_UM: [f64; 2] = [330.0, 245.0];
/// How far the target's centre may lie from the view's for the whole target to be in the 100x view, at any rotation up
/// to 6 degrees and with the objectives' offsets.
const REACH_UM: [f64; 2] = [480.0, 340.0];
/// The least displacement drawn.
const LEAST_SHIFT_UM: f64 = 100.0;
/// The largest rotation drawn, degrees.
const MAX_TURN_DEG: f64 = 6.0;
/// A place with structure in this share of its blocks is tissue.
const ENOUGH_TEXTURE: f64 = 0.6;
const TRIES: usize = 400;

/// What happens to the slide.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Scene {
    /// The target's centre on the specimen, um.
    pub(crate) target_um: [f64; 2],
    /// Where the view's centre lies from the target's when the slide is back, um on the specimen.
    pub(crate) start_um: [f64; 2],
    /// How far the slide is turned about the target's centre, degrees.
    pub(crate) turn_deg: f64,
}

/// Draws a scene. Where no place has enough texture, the best place seen is taken: the run will say what it finds there.
pub(crate) fn draw(
    specimen: &dyn Specimen,
    seed: u64,
    start_um: Option<[f64; 2]>,
    turn_deg: Option<f64>,
) -> Result<Scene, CliError> {
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    let [x0, x1, y0, y1] = match specimen.extent_um() {
        Some(extent) => room(extent)?,
        None => [-4000.0, 4000.0, -4000.0, 4000.0],
    };
    let turn_deg = turn_deg.unwrap_or_else(|| rng.random_range(-MAX_TURN_DEG..=MAX_TURN_DEG));
    let mut best: Option<(f64, Scene)> = None;
    for _ in 0..TRIES {
        let target_um = [rng.random_range(x0..=x1), rng.random_range(y0..=y1)];
        let shift = start_um.unwrap_or_else(|| {
            [
                rng.random_range(-REACH_UM[0]..=REACH_UM[0]),
                rng.random_range(-REACH_UM[1]..=REACH_UM[1]),
            ]
        });
        if start_um.is_none() && f64::hypot(shift[0], shift[1]) < LEAST_SHIFT_UM {
            continue;
        }
        let scene = Scene {
            target_um,
            start_um: shift,
            turn_deg,
        };
        let start = [target_um[0] + shift[0], target_um[1] + shift[1]];
        let inside = start[0] >= x0 && start[0] <= x1 && start[1] >= y0 && start[1] <= y1;
        if start_um.is_none() && !inside {
            continue;
        }
        let at_target = texture_share(specimen, target_um, TARGET_FIELD_UM)?;
        // A start that was asked for is taken as it is.
        let texture = match start_um {
            Some(_) => at_target,
            None => at_target.min(texture_share(specimen, start, TARGET_FIELD_UM)?),
        };
        if best.as_ref().is_none_or(|(t, _)| texture > *t) {
            best = Some((texture, scene));
        }
        if texture >= ENOUGH_TEXTURE {
            break;
        }
    }
    best.map(|(_, scene)| scene).ok_or_else(|| {
        CliError::Usage(format!(
            "the specimen is too small to displace by {LEAST_SHIFT_UM} um; give a larger image, or a displacement with --start-um"
        ))
    })
}

/// Where the centre of a 400x view may lie for the view to be inside.
fn room(extent: [f64; 4]) -> Result<[f64; 4], CliError> {
    let half = TARGET_FIELD_UM.map(|v| v / 2.0);
    let room = [
        extent[0] + half[0],
        extent[1] - half[0],
        extent[2] + half[1],
        extent[3] - half[1],
    ];
    if room[0] > room[1] || room[2] > room[3] {
        return Err(CliError::Usage(format!(
            "the specimen is {:.0} x {:.0} um, smaller than the 400x view of {:.0} x {:.0} um; give a larger image, or check --um-per-px",
            extent[1] - extent[0],
            extent[3] - extent[2],
            TARGET_FIELD_UM[0],
            TARGET_FIELD_UM[1]
        )));
    }
    Ok(room)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_twin::specimen::Tissue;
    use std::path::Path;

    #[test]
    fn drawn_scenes_keep_their_promise_and_repeat() {
        let tissue = Tissue::new(3);
        for seed in 0..3 {
            let scene = draw(&tissue, seed, None, None).unwrap();
            assert!(f64::hypot(scene.start_um[0], scene.start_um[1]) >= LEAST_SHIFT_UM);
            assert!(
                scene.start_um[0].abs() <= REACH_UM[0] && scene.start_um[1].abs() <= REACH_UM[1]
            );
            assert!(scene.turn_deg.abs() <= MAX_TURN_DEG);
            assert_eq!(scene, draw(&tissue, seed, None, None).unwrap());
        }
    }

    #[test]
    fn the_fields_are_those_of_the_simulated_microscope() {
        let config = scopeservo_twin::Config::realistic();
        let size = [config.camera.width as f64, config.camera.height as f64];
        let field = |k: usize| {
            let o = &config.optics[k];
            let scale = [o.kx_px_per_m, o.ky_px_per_m].map(f64::abs);
            [0, 1].map(|i| 1e6 * size[i] / scale[i])
        };
        let (wide, narrow) = (field(0), field(config.optics.len() - 1));
        let (s, c) = MAX_TURN_DEG.to_radians().sin_cos();
        for i in 0..2 {
            let more = TARGET_FIELD_UM[i] - narrow[i];
            assert!((0.0..5.0).contains(&more), "{more}");
            // The turned target, 15 um of parcentric offset and 3 um of seat must fit in.
            let half = (c * narrow[i] + s * narrow[1 - i]) / 2.0;
            assert!(REACH_UM[i] + half + 20.0 <= wide[i] / 2.0);
        }
    }

    #[test]
    fn a_specimen_smaller_than_the_view_is_refused() {
        assert!(room([-100.0, 100.0, -100.0, 100.0]).is_err());
        assert!(room([-500.0, 500.0, -500.0, 500.0]).is_ok());
    }

    #[test]
    fn the_readme_says_what_is_drawn() {
        let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../README.md");
        let text = std::fs::read_to_string(page).unwrap().replace('\n', " ");
        let [width, height] = TARGET_FIELD_UM;
        for said in [
            format!(
                "displaced by at least {LEAST_SHIFT_UM} um and turned by up to {MAX_TURN_DEG} degrees"
            ),
            format!(
                "the 400x view, {width} x {height} um, and a second one at least {LEAST_SHIFT_UM} um beside it"
            ),
        ] {
            assert!(text.contains(&said), "{said}");
        }
    }
}
