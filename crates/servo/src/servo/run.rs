//! The loop as a procedure.

use super::state::Servo;
use crate::procedure::{Procedure, Progress};
use crate::{ServoEnd, ServoError, ServoTask, Sink};
use scopeservo_scope::Instrument;

/// A loop together with its task, as a procedure: the loop's state is stored, its task is borrowed.
pub struct ServoRun<'a> {
    servo: &'a mut Servo,
    task: ServoTask<'a>,
}

impl Servo {
    /// This loop as a [`Procedure`].
    pub fn on<'a>(&'a mut self, task: &ServoTask<'a>) -> ServoRun<'a> {
        ServoRun {
            servo: self,
            task: *task,
        }
    }
}

impl Procedure for ServoRun<'_> {
    type Output = ServoEnd;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<ServoEnd>, ServoError> {
        self.servo.step(&self.task, scope, sink)
    }
}
