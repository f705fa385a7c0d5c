//! Images of a simulated run, for looking at: three objectives, five defoci, events.
//!
//! ```text
//! cargo run --release -p scopeservo-twin --example views -- FOLDER [SLIDE [UM_PER_PX]]
//! ```

use scopeservo_scope::{Axis, Clock, ObjectiveId, StagePose, VirtualClock};
use scopeservo_twin::{Config, FileSpecimen, Specimen, SpecimenEvent, Tissue, Twin};
use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let folder = PathBuf::from(args.next().ok_or("give a folder for the images")?);
    std::fs::create_dir_all(&folder)?;
    let specimen: Arc<dyn Specimen> = match args.next() {
        Some(path) => {
            let um_per_px = args.next().map(|v| v.parse()).transpose()?;
            Arc::new(FileSpecimen::open(path.as_ref(), um_per_px)?)
        }
        None => Arc::new(Tissue::new(1)),
    };

    let clock = Arc::new(VirtualClock::new());
    let twin = Twin::new(Config::realistic(), specimen, 1, clock.clone())?;
    let (stage, camera, nosepiece) = (twin.stage(), twin.camera(), twin.nosepiece());
    let grab = |name: &str| -> Result<(), Box<dyn Error>> {
        let frame = camera.grab()?;
        let (w, h) = (frame.width as u32, frame.height as u32);
        let picture = image::RgbImage::from_raw(w, h, frame.rgb8()).ok_or("a frame of odd size")?;
        picture.save(folder.join(name))?;
        Ok(())
    };
    twin.centre_specimen([0.0, 0.0], 0.0);
    for objective in ["10x", "20x", "40x"] {
        nosepiece.start_change(&ObjectiveId(objective.into()))?;
        clock.sleep(Duration::from_secs(3));
        for defocus in [-30.0, -4.0, 0.0, 4.0, 30.0] {
            let at = stage.position()?.si(Axis::Z).ok_or("no z")?;
            let z = at + (defocus - twin.truth_now().defocus_um) * 1e-6;
            stage.start_move(&StagePose::default().with_si(Axis::Z, z))?;
            clock.sleep(Duration::from_secs(1));
            grab(&format!("{objective}_{defocus:+.0}um.png"))?;
            if defocus == 0.0 {
                stage.start_move(&StagePose::default().with_si(Axis::X, 1e-3))?;
                grab(&format!("{objective}_moving.png"))?;
                clock.sleep(Duration::from_secs(1));
                stage.start_move(&StagePose::default().with_si(Axis::X, 0.0))?;
                clock.sleep(Duration::from_secs(1));
            }
        }
    }
    let at = stage.position()?.si(Axis::Z).ok_or("no z")?;
    let z = at - twin.truth_now().defocus_um * 1e-6;
    stage.start_move(&StagePose::default().with_si(Axis::Z, z))?;
    clock.sleep(Duration::from_secs(1));
    let centre_um = twin.truth_now().centre_um;
    twin.inject(SpecimenEvent::Bubble {
        centre_um: [centre_um[0] + 60.0, centre_um[1]],
        radius_um: 50.0,
    });
    twin.inject(SpecimenEvent::Occlusion {
        centre_um: [centre_um[0] - 60.0, centre_um[1] + 40.0],
        size_um: [60.0, 60.0],
        rgb: [20, 20, 25],
    });
    grab("40x_bubble_and_occlusion.png")?;
    twin.inject(SpecimenEvent::Bleach { factor: 0.5 });
    grab("40x_bleached.png")?;
    twin.inject(SpecimenEvent::counterstain());
    grab("40x_restained.png")?;
    Ok(())
}
