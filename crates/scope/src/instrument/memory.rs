//! What an instrument remembers of images: where objectives are in focus, and what lies on the camera.

use super::Instrument;
use crate::{FlatField, Length, ObjectiveId};
use std::collections::BTreeMap;
use std::sync::Arc;

impl Instrument {
    /// Tells at which z of the stage an objective is in focus. The differences between objectives predict where the next one
    /// will be.
    pub fn focus_found(&self, id: &ObjectiveId, z: Length) {
        self.gate.knowledge().focus().insert(id.clone(), z);
    }

    /// Where each objective was last in focus.
    pub fn focus_positions(&self) -> BTreeMap<ObjectiveId, Length> {
        self.gate.knowledge().focus().clone()
    }

    /// Takes back what [`Instrument::focus_found`] told: it was another objective.
    pub fn forget_focus(&self, id: &ObjectiveId) {
        self.gate.knowledge().focus().remove(id);
    }

    /// What lies on the camera, as far as it was seen: every procedure divides it out of what it sees.
    pub fn flat_field(&self) -> Option<Arc<FlatField>> {
        let kept = self.flat_field.lock();
        kept.unwrap_or_else(|e| e.into_inner()).clone()
    }

    /// Keeps what lies on the camera, as it was seen now or before; tells what was kept until then.
    pub fn set_flat_field(&self, seen: Option<Arc<FlatField>>) -> Option<Arc<FlatField>> {
        let kept = self.flat_field.lock();
        std::mem::replace(&mut *kept.unwrap_or_else(|e| e.into_inner()), seen)
    }
}
