//! Wishes to stop: one for the whole instrument, and one for each piece of work on it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A wish to stop, shared between threads: Ctrl-C, a button, a watchdog. Once made it stays; who works again takes another
/// [`CancelToken::child`].
#[derive(Debug, Clone, Default)]
pub struct CancelToken(Arc<Wish>);

#[derive(Debug, Default)]
struct Wish {
    asked: AtomicBool,
    parent: Option<CancelToken>,
}

impl CancelToken {
    /// Not cancelled yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// A token of its own for a part of the work: it is cancelled with this one, and this one is not cancelled with it.
    #[must_use]
    pub fn child(&self) -> Self {
        Self(Arc::new(Wish {
            asked: AtomicBool::new(false),
            parent: Some(self.clone()),
        }))
    }

    /// Asks for a stop. The running move is stopped and the procedure returns [`ScopeError::Interrupted`](crate::ScopeError::Interrupted).
    pub fn cancel(&self) {
        self.0.asked.store(true, Ordering::SeqCst);
    }

    /// Whether a stop was asked for.
    pub fn is_cancelled(&self) -> bool {
        let parent = || self.0.parent.as_ref().is_some_and(Self::is_cancelled);
        self.0.asked.load(Ordering::SeqCst) || parent()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_child_is_cancelled_with_its_parent_and_not_the_other_way_round() {
        let whole = CancelToken::new();
        let (first, second) = (whole.child(), whole.child());
        first.cancel();
        assert!(first.is_cancelled() && !second.is_cancelled() && !whole.is_cancelled());
        whole.cancel();
        assert!(second.is_cancelled() && second.child().is_cancelled());
    }
}
