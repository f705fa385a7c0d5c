//! What the library knows of an instrument that was opened.

use scopeservo_library::{
    CalibrationSets as _, Cameras as _, Database, LibraryError, Nosepieces as _,
};
use scopeservo_scope::{Instrument, Length, ObjectiveId};
use scopeservo_servo::{Parcentric, SwitchingReport};
use scopeservo_setup::Config;
use std::sync::Arc;

/// Is told what of it cannot be read: the rest counts all the same.
pub(crate) type Warn<'a> = &'a mut dyn FnMut(LibraryError);

/// What came of it; what went wrong is told.
pub(crate) fn or_warn<T>(what: Result<T, LibraryError>, warn: Warn<'_>) -> Option<T> {
    what.map_err(warn).ok()
}

/// The instrument learns what lay on the camera when it was seen last.
pub(crate) fn shadows(config: &Config, library: &Database, scope: &Instrument, warn: Warn<'_>) {
    let info = scope.camera().info();
    let seen = library.shadows(&config.name, [info.width, info.height]);
    scope.set_flat_field(or_warn(seen, warn).flatten().map(Arc::new));
}

/// Where objectives look beside each other, by calibrations that were made together.
pub(crate) fn parcentric(config: &Config, library: &Database, warn: Warn<'_>) -> Vec<Parcentric> {
    let set = or_warn(library.calibration_set(&config.name), warn);
    set.flatten().map_or(Vec::new(), |kept| kept.set.parcentric)
}

/// What was kept of the nosepiece, of objectives that it carries; the instrument learns how high they focus beside each other.
pub(crate) fn switchings(
    config: &Config,
    library: &Database,
    scope: &Instrument,
    warn: Warn<'_>,
) -> Vec<SwitchingReport> {
    let kept = or_warn(library.switchings(&config.name), &mut *warn);
    let kept = kept.into_iter().flatten();
    let all = kept.filter_map(|kept| Some(or_warn(kept, &mut *warn)?.switching));
    let there = |id: &ObjectiveId| scope.objective(id).is_ok();
    let all: Vec<_> = all.filter(|s| there(&s.from) && there(&s.to)).collect();
    for SwitchingReport {
        from, to, focus, ..
    } in &all
    {
        if let Some(focus) = focus {
            scope.parfocal_known([from, to], Length::from_um(focus.offset_um.value));
        }
    }
    all
}
