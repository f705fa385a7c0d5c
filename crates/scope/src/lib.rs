//! The instrument contract: units, frames, Camera, Stage, Nosepiece, Clock, limits, errors.
