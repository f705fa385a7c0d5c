//! What an instrument remembers of images: where objectives are in focus, and what lies on the camera.

use super::Instrument;
use crate::{FlatField, Length, ObjectiveId};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A focus that lies so much farther from the specimen than before is that of another slide, m: seats and drifts change it by less.
const SAME_SLIDE_M: f64 = 10e-6;

impl Instrument {
    /// Tells at which z of the stage an objective is in focus. The differences between objectives predict where the next one
    /// will be.
    ///
    /// Where it lies farther from the specimen than before, a thicker slide may be in, which lifts the focus of all: the others count as so much
    /// farther, too, until they are focused. Where it lies nearer they stay as far as they were.
    pub fn focus_found(&self, id: &ObjectiveId, z: Length) {
        let side = self.gate.positive_z();
        let mut focus = self.gate.knowledge().focus();
        if let Some(before) = focus.insert(id.clone(), z) {
            let farther = side.nearer_by(before.m(), z.m());
            if farther > SAME_SLIDE_M {
                for (_, other) in focus.iter_mut().filter(|(other, _)| *other != id) {
                    *other = Length::from_m(side.away(other.m(), farther));
                }
            }
        }
        drop(focus);
        self.gate.knowledge().parfocal().last = Some(id.clone());
    }

    /// Tells how much higher the second of two objectives is in focus than the first, from an earlier session. Alone it says no height: another
    /// specimen lies elsewhere, and shifts all objectives alike.
    pub fn parfocal_known(&self, [from, to]: [&ObjectiveId; 2], offset: Length) {
        let mut parfocal = self.gate.knowledge().parfocal();
        parfocal.offsets.insert([from.clone(), to.clone()], offset);
    }

    /// Where an objective that was not in focus yet is expected to be: as much higher or lower than the one that was focused last, as it was in an
    /// earlier session. `None` where that is not known. Nothing goes there by itself: a sweep looks there first, inside its own bounds.
    pub fn predicted_focus(&self, id: &ObjectiveId) -> Option<Length> {
        let parfocal = self.gate.knowledge().parfocal();
        let last = parfocal.last.as_ref()?;
        let here = self.gate.knowledge().focus().get(last)?.m();
        let of = |from: &ObjectiveId, to: &ObjectiveId| {
            let known = parfocal.offsets.get(&[from.clone(), to.clone()]);
            known.map(|offset| offset.m())
        };
        let firsts = || parfocal.offsets.keys().map(|[first, _]| first);
        let offset = of(last, id)
            .or_else(|| Some(-of(id, last)?))
            .or_else(|| firsts().find_map(|first| Some(of(first, id)? - of(first, last)?)));
        Some(Length::from_m(here + offset?))
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
