//! What a session, its jobs and their handles share.

use crate::control::Control;
use crate::lease::Leases;
use crate::line::Line;
use crate::{Bus, Journal, JournalError, Questions, StationEvent};
use scopeservo_scope::{Instrument, ScopeError};
use std::sync::Arc;

/// The parts of a session that its jobs work with, each on a thread of its own.
pub(crate) struct Shared {
    pub(crate) scope: Arc<Instrument>,
    pub(crate) bus: Bus,
    pub(crate) questions: Questions,
    pub(crate) journal: Arc<dyn Journal>,
    pub(crate) leases: Leases,
    pub(crate) line: Line,
}

impl Shared {
    /// Stops one job, or everything. What moves for it is stopped from here too, should its thread hang in a device.
    pub(crate) fn stop(&self, one: Option<&Arc<Control>>) -> Result<(), ScopeError> {
        // No job begins meanwhile: it would be stopped in place of the one that is meant.
        let (_stopping, jobs) = self.line.stopping();
        let is_meant = |job: &Arc<Control>| one.is_none_or(|one| Arc::ptr_eq(one, job));
        for job in jobs.iter().filter(|job| is_meant(job)) {
            job.cancel.cancel();
        }
        let told = match one.is_none() || jobs.first().is_some_and(is_meant) {
            true => self.scope.gate().stop(),
            false => return Ok(()),
        };
        self.questions.cancel_all();
        for job in jobs.iter().filter(|job| is_meant(job)) {
            job.wake();
        }
        told
    }

    /// Tells that something could not be kept.
    pub(crate) fn not_kept(&self, job: &Control, error: &JournalError) {
        let (id, why) = (job.info.id, error.to_string());
        self.bus.station(StationEvent::NotKept { id, why });
    }
}
