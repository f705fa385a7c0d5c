//! Questions to whoever sits at the terminal.

use scopeservo_scope::{AskImmersion, Immersion, Objective};
use std::io::{BufRead, IsTerminal};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

/// How often one who waits for an answer looks whether it is still wanted.
const LOOK: Duration = Duration::from_millis(50);

/// Lines typed at the terminal. One reader for all questions: one that was given up would otherwise eat the answer to the next.
fn typed() -> &'static Mutex<Receiver<String>> {
    static TYPED: OnceLock<Mutex<Receiver<String>>> = OnceLock::new();
    TYPED.get_or_init(|| {
        let (tell, lines) = mpsc::channel();
        std::thread::spawn(move || {
            for line in std::io::stdin().lock().lines() {
                let Ok(line) = line else { return };
                if tell.send(line).is_err() {
                    return;
                }
            }
        });
        Mutex::new(lines)
    })
}

/// Asks to turn the nosepiece.
pub(crate) fn to_turn(objective: &Objective, wanted: &dyn Fn() -> bool) -> bool {
    let id = &objective.id;
    if !std::io::stdin().is_terminal() {
        tell!(
            "scopeservo: the objective {id} is needed, and nobody is there to turn the nosepiece: run this in a terminal"
        );
        return false;
    }
    let question = format!("Turn the nosepiece to {id}, then press Enter. Type n to end.");
    let again = format!("Press Enter when {id} is in, or type n to end.");
    is_agreed(&question, &again, Enter::Agrees, wanted)
}

/// Asks whether the specimen is ready for another medium. What it was `made_ready` for before the command is agreed to once.
pub(crate) fn about_immersion(made_ready: Option<Immersion>) -> AskImmersion {
    let is_used = AtomicBool::new(false);
    Arc::new(move |change, wanted| {
        let (id, to, from) = (&change.objective, change.to, change.from_words());
        if made_ready == Some(to) && !is_used.swap(true, Ordering::SeqCst) {
            let word = to.word();
            tell!("scopeservo: {id} comes, which works in {to}, as --immersion {word} says");
            return true;
        }
        if !std::io::stdin().is_terminal() {
            return false;
        }
        let question = format!(
            "{id} works in {to}, and on the specimen there is {from}. Nothing moves before you agree. Make the specimen and the objective \
             ready for {to}, then type y and press Enter. Type n to end."
        );
        let again = format!("Type y when all is ready for {to}, or n to end.");
        is_agreed(&question, &again, Enter::IsNoAnswer, wanted)
    })
}

/// What Enter alone means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Enter {
    Agrees,
    IsNoAnswer,
}

fn is_agreed(question: &str, again: &str, enter: Enter, wanted: &dyn Fn() -> bool) -> bool {
    let lines = typed().lock().unwrap_or_else(PoisonError::into_inner);
    // What was typed before the question is no answer to it.
    while lines.try_recv().is_ok() {}
    tell!("{question}");
    while wanted() {
        match lines.recv_timeout(LOOK) {
            Ok(line) => match line.trim().to_ascii_lowercase().as_str() {
                "" if enter == Enter::Agrees => return true,
                "y" | "yes" => return true,
                "n" | "no" | "q" => return false,
                _ => tell!("{again}"),
            },
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return false,
        }
    }
    false
}
