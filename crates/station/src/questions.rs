//! Questions to people: news with an answer. Whoever stands at the microscope may answer, from any thread and front end, owner or not.

use crate::bus::Bus;
use crate::{Question, QuestionId, QuestionKind, Refusal, StationEvent, lock};
use scopeservo_scope::{AskImmersion, Objective};
use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

/// How often one who waits for an answer looks whether it is still wanted.
const LOOK: Duration = Duration::from_millis(20);

/// Asks somebody to bring an objective into the beam, and waits while the second argument says that the answer is wanted: what a
/// nosepiece that is turned by hand is opened with.
pub type Ask = Arc<dyn Fn(&Objective, &dyn Fn() -> bool) -> bool + Send + Sync>;

/// The open questions of a session. Clones are the same.
#[derive(Clone)]
pub struct Questions {
    bus: Bus,
    desk: Arc<(Mutex<Desk>, Condvar)>,
}

#[derive(Default)]
struct Desk {
    asked: u64,
    open: BTreeMap<QuestionId, (Question, Option<Reply>)>,
}

#[derive(Clone, Copy)]
enum Reply {
    Said(bool),
    Cancelled,
}

impl Questions {
    /// Questions that are told on this bus: made before the session, as an instrument may need them to be opened.
    pub fn new(bus: Bus) -> Self {
        Self {
            bus,
            desk: Arc::default(),
        }
    }

    /// Asks, and waits for the answer while it is wanted. `None` when it was not wanted any more, or a stop came.
    pub fn ask(&self, kind: QuestionKind, wanted: &dyn Fn() -> bool) -> Option<bool> {
        let question = {
            let mut desk = lock(&self.desk.0);
            let id = QuestionId(desk.asked);
            desk.asked += 1;
            let job = self.bus.job();
            let question = Question { id, job, kind };
            desk.open.insert(id, (question.clone(), None));
            question
        };
        let id = question.id;
        self.bus.station(StationEvent::Asked { question });
        let reply = loop {
            let unanswered = |desk: &mut Desk| matches!(desk.open.get(&id), Some((_, None)));
            let waited = self
                .desk
                .1
                .wait_timeout_while(lock(&self.desk.0), LOOK, unanswered);
            let desk = waited.unwrap_or_else(PoisonError::into_inner).0;
            let reply = desk.open.get(&id).and_then(|(_, reply)| *reply);
            drop(desk);
            match reply {
                Some(reply) => break reply,
                None if !wanted() => break Reply::Cancelled,
                None => {}
            }
        };
        lock(&self.desk.0).open.remove(&id);
        match reply {
            Reply::Said(yes) => {
                self.bus.station(StationEvent::Answered { id, yes });
                Some(yes)
            }
            Reply::Cancelled => {
                self.bus.station(StationEvent::QuestionCancelled { id });
                None
            }
        }
    }

    /// Answers. The first answer counts.
    ///
    /// # Errors
    /// [`Refusal::NoSuchQuestion`].
    pub fn answer(&self, id: QuestionId, yes: bool) -> Result<(), Refusal> {
        let mut desk = lock(&self.desk.0);
        match desk.open.get_mut(&id) {
            Some((_, reply @ None)) => {
                *reply = Some(Reply::Said(yes));
                self.desk.1.notify_all();
                Ok(())
            }
            _ => Err(Refusal::NoSuchQuestion { id }),
        }
    }

    /// Those that wait for an answer.
    pub fn open(&self) -> Vec<Question> {
        let desk = lock(&self.desk.0);
        let open = desk.open.values().filter(|(_, reply)| reply.is_none());
        open.map(|(question, _)| question.clone()).collect()
    }

    pub(crate) fn cancel_all(&self) {
        for (_, reply) in lock(&self.desk.0).open.values_mut() {
            reply.get_or_insert(Reply::Cancelled);
        }
        self.desk.1.notify_all();
    }

    /// What an instrument asks with before an objective comes that works in another medium.
    pub fn immersion_asker(&self) -> AskImmersion {
        let questions = self.clone();
        Arc::new(move |change, wanted| {
            let change = change.clone();
            questions.ask(QuestionKind::ChangeImmersion { change }, wanted) == Some(true)
        })
    }

    /// What a nosepiece that is turned by hand asks with.
    pub fn asker(&self) -> Ask {
        let questions = self.clone();
        Arc::new(move |objective, wanted| {
            let objective = objective.id.clone();
            questions.ask(QuestionKind::TurnNosepiece { objective }, wanted) == Some(true)
        })
    }
}
