//! The localizer that the options ask for.

use super::{CorrelationLocalizer, FeatureLocalizer, Localizer};
use crate::VisionOptions;

/// Asks the localizer that the options say.
pub(crate) fn with_localizer<T>(
    vision: &VisionOptions,
    ask: impl FnOnce(&dyn Localizer) -> T,
) -> T {
    match vision.correlation {
        true => ask(&CorrelationLocalizer { vision }),
        false => ask(&FeatureLocalizer { vision }),
    }
}
