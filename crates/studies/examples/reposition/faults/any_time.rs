//! What may break at any time of a run.

use scopeservo_geometry::SplitMix64;
use scopeservo_scope::Axis;
use scopeservo_twin::{StageFault, Twin};

/// What breaks a run at random, or does not.
type Breaks = fn(&Twin, &mut SplitMix64);

/// What may break at any time.
pub(super) struct Kind {
    pub(super) name: &'static str,
    /// Whether the run must arrive all the same.
    pub(super) arrives: bool,
    pub(super) what: Breaks,
}

/// One in spite of which the run must arrive.
const fn harmless(name: &'static str, what: Breaks) -> Kind {
    Kind {
        name,
        arrives: true,
        what,
    }
}

/// One that may keep it from arriving.
const fn fault(name: &'static str, what: Breaks) -> Kind {
    Kind {
        name,
        arrives: false,
        what,
    }
}

fn stands(twin: &Twin, axis: Axis) {
    twin.fault(StageFault::StuckAxis { axis, stuck: true });
}

fn wall(twin: &Twin, axis: Axis, beyond: f64) {
    let at = twin.truth_now().stage.si(axis).unwrap_or(0.0);
    let between = Some([at - beyond, at + beyond]);
    twin.fault(StageFault::Wall { axis, between });
}

fn slips(twin: &Twin, axis: Axis, si: f64) {
    twin.fault(StageFault::LostSteps { axis, si });
}

fn frames_late(twin: &Twin) {
    let (count, delay_s) = (3, 0.3);
    twin.fault(StageFault::LateFrames { count, delay_s });
}

fn turns_no_more(twin: &Twin) {
    let now = twin.truth_now().objective;
    let said = twin.config().optics.iter().position(|o| o.id.0 == now);
    twin.fault(StageFault::InBeam(said));
}

fn moved_by_hand(twin: &Twin, rng: &mut SplitMix64) {
    let far_m = 40e-6 * (1.0 + rng.uniform());
    let (y, x) = (std::f64::consts::TAU * rng.uniform()).sin_cos();
    slips(twin, Axis::X, far_m * x);
    slips(twin, Axis::Y, far_m * y);
}

fn z_slips(twin: &Twin, rng: &mut SplitMix64) {
    let si = if rng.uniform() < 0.5 { -20e-6 } else { 20e-6 };
    slips(twin, Axis::Z, si);
}

fn has_play(twin: &Twin, axis: Axis, si: f64) {
    twin.fault(StageFault::Backlash { axis, si });
}

fn drifts(twin: &Twin) {
    let um_per_s = [2.0, 0.0, 0.0];
    twin.fault(StageFault::Drift { um_per_s });
}

pub(super) const KINDS: [Kind; 19] = [
    harmless("nothing", |_, _| {}),
    harmless("three frames lost", |t, _| {
        t.fault(StageFault::DropFrames(3))
    }),
    harmless("three frames 0.3 s late", |t, _| frames_late(t)),
    harmless("a torn frame", |t, _| t.fault(StageFault::TornFrame)),
    fault("camera silent", |t, _| {
        t.fault(StageFault::SilentCamera(true))
    }),
    fault("camera frozen", |t, _| {
        t.fault(StageFault::FrozenCamera(true))
    }),
    fault("images 3 late", |t, _| t.fault(StageFault::StaleFrames(3))),
    fault("plug pulled", |t, _| t.fault(StageFault::Unplugged(true))),
    fault("x stands", |t, _| stands(t, Axis::X)),
    fault("z stands", |t, _| stands(t, Axis::Z)),
    fault("rotation stands", |t, _| stands(t, Axis::Rz)),
    fault("x at a limit switch", |t, _| wall(t, Axis::X, 5e-6)),
    fault("z at a limit switch", |t, _| wall(t, Axis::Z, 5e-6)),
    fault("rotation at a limit switch", |t, _| wall(t, Axis::Rz, 1e-4)),
    fault("nosepiece turns no more", |t, _| turns_no_more(t)),
    fault("moved by hand, 40 to 80 um", moved_by_hand),
    fault("z slips by 20 um", z_slips),
    fault("play of 8 um in x", |t, _| has_play(t, Axis::X, 8e-6)),
    fault("drift of 2 um/s", |t, _| drifts(t)),
];
