//! A look that nobody sees: what the first frame needs is there, and the frames are the same.

use scopeservo_scope::{Clock, VirtualClock};
use scopeservo_twin::specimen::{Patch, Specimen, SpecimenError, Tissue};
use scopeservo_twin::{Config, Twin};
use std::sync::{Arc, Mutex};

/// A level and the ends of a rectangle, um.
type Asked = (usize, [f64; 4]);

/// Tissue that tells what of it was asked for.
struct Told {
    tissue: Tissue,
    asked: Mutex<Vec<Asked>>,
}

impl Specimen for Told {
    fn finest_um(&self) -> f64 {
        self.tissue.finest_um()
    }
    fn levels(&self) -> usize {
        self.tissue.levels()
    }
    fn patch(
        &self,
        level: usize,
        x_um: [f64; 2],
        y_um: [f64; 2],
        margin: usize,
    ) -> Result<Patch, SpecimenError> {
        let ends = [x_um[0], x_um[1], y_um[0], y_um[1]];
        self.asked.lock().unwrap().push((level, ends));
        self.tissue.patch(level, x_um, y_um, margin)
    }
    fn extent_um(&self) -> Option<[f64; 4]> {
        None
    }
    fn describe(&self) -> String {
        self.tissue.describe()
    }
}

#[test]
fn what_the_first_frame_shows_has_grown_with_a_look_and_is_the_same_without() {
    let mut config = Config::realistic();
    (config.camera.width, config.camera.height) = (64, 48);
    let twin = || {
        let specimen = Arc::new(Told {
            tissue: Tissue::new(5),
            asked: Mutex::default(),
        });
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
        let twin = Twin::new(config.clone(), specimen.clone(), 5, clock).unwrap();
        (twin, specimen)
    };
    let (looked, specimen) = twin();
    looked.look().unwrap();
    let grown = std::mem::take(&mut *specimen.asked.lock().unwrap());
    assert!(!grown.is_empty());
    let frame = looked.camera().grab().unwrap();
    let needed = std::mem::take(&mut *specimen.asked.lock().unwrap());
    // The same but for what the stage trembles meanwhile.
    let same = |(a, b): (&Asked, &Asked)| {
        let ends = a.1.iter().zip(b.1);
        a.0 == b.0 && ends.into_iter().all(|(a, b)| (a - b).abs() < 0.1)
    };
    assert_eq!(needed.len(), grown.len());
    let nothing_new = needed.iter().zip(&grown).all(same);
    assert!(nothing_new, "{needed:?}: only {grown:?} has grown");
    let (other, _) = twin();
    assert_eq!(other.camera().grab().unwrap(), frame);
}
