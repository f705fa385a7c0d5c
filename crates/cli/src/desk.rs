//! The instrument that the user described, opened so that Ctrl-C stops it.

use crate::answer::Answer;
use crate::args::InstrumentArgs;
use crate::error::CliError;
use scopeservo_library::{Cameras as _, Folder};
use scopeservo_scope::{CancelToken, Instrument, Objective, ObjectiveId};
use scopeservo_setup::{Config, Consent, Opened, open};
use std::io::{BufRead, IsTerminal};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};
use std::time::Duration;

/// What a command works at.
pub(crate) struct Desk {
    pub(crate) config: Config,
    pub(crate) library: Folder,
    pub(crate) scope: Arc<Instrument>,
    pub(crate) drivers: Vec<(String, String)>,
}

/// What Ctrl-C stops; nothing until an instrument is there.
#[derive(Clone, Default)]
pub(crate) struct Reins(Arc<Mutex<Weak<Instrument>>>);

impl Reins {
    /// From now on it stops this one.
    pub(crate) fn hold(&self, scope: &Arc<Instrument>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Arc::downgrade(scope);
    }

    fn held(&self) -> Option<Arc<Instrument>> {
        let held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        held.upgrade()
    }
}

/// So many times somebody asks who will not wait for what is being opened.
const IMPATIENT: u32 = 3;

/// From now on Ctrl-C cancels, and stops what moves.
pub(crate) fn rein_in(cancel: &CancelToken, answer: &Answer) -> Reins {
    let reins = Reins::default();
    let (wish, held, leaving) = (cancel.clone(), reins.clone(), answer.clone());
    let mut asked = 0;
    answer.on_interrupt(move || {
        asked += 1;
        let scope = held.held();
        if wish.is_cancelled() {
            match &scope {
                // Asked twice: the instrument was told to stop, and nobody waits any longer.
                Some(_) => leaving.leave(CliError::Left),
                None if asked >= IMPATIENT => leaving.leave(CliError::Left),
                // It may be homing, and only who homes can stop that.
                None => {
                    tell!(
                        "scopeservo: stopping; wait for the instrument, or press Ctrl-C once more to leave it as it is"
                    );
                    return;
                }
            }
        }
        wish.cancel();
        if scope.is_none() {
            tell!("scopeservo: stopping as soon as the instrument is open");
        }
        // From here too, should the working thread hang in a device.
        if let Some(scope) = scope
            && let Err(error) = scope.gate().stop()
        {
            tell!("scopeservo: the instrument did not take the stop: {error}");
        }
    });
    reins
}

impl Desk {
    pub(crate) fn open(args: &InstrumentArgs, answer: &Answer) -> Result<Self, CliError> {
        let config = Config::read(&args.description.config)?;
        let library = Folder::new(config.resolve(&config.data_folder));
        let cancel = CancelToken::new();
        let reins = rein_in(&cancel, answer);
        let consent = Consent {
            home: args.home,
            ask: Arc::new(ask),
        };
        let Opened {
            instrument,
            drivers,
            ..
        } = open(&config, &consent, cancel)?;
        let scope = Arc::new(instrument);
        reins.hold(&scope);
        // What lay on the camera when it was seen last.
        let info = scope.camera().info();
        let seen = library.shadows(&config.name, [info.width, info.height]);
        scope.set_flat_field(answer.or_warn(seen).flatten().map(Arc::new));
        Ok(Self {
            config,
            library,
            scope,
            drivers,
        })
    }

    /// The objective of that name; the one that is in the beam when none is named.
    pub(crate) fn objective(&self, name: Option<&str>) -> Result<Objective, CliError> {
        let id = match name {
            Some(name) => ObjectiveId(name.into()),
            None => self.scope.gate().current_objective()?.ok_or_else(|| {
                CliError::Usage(format!(
                    "nobody knows which objective is in the beam: name one with --objective. There are {}",
                    names(&self.scope)
                ))
            })?,
        };
        Ok(self.scope.objective(&id)?.clone())
    }
}

fn names(scope: &Instrument) -> String {
    let all = scope.gate().objectives().iter();
    all.map(|o| o.id.0.as_str()).collect::<Vec<_>>().join(", ")
}

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

/// How often one who waits for an answer looks whether it is still wanted.
const LOOK: Duration = Duration::from_millis(50);

/// Asks whoever sits at the terminal to turn the nosepiece.
fn ask(objective: &Objective, wanted: &dyn Fn() -> bool) -> bool {
    let id = &objective.id;
    if !std::io::stdin().is_terminal() {
        tell!(
            "scopeservo: the objective {id} is needed, and nobody is there to turn the nosepiece: run this in a terminal"
        );
        return false;
    }
    let lines = typed().lock().unwrap_or_else(PoisonError::into_inner);
    // What was typed before the question is no answer to it.
    while lines.try_recv().is_ok() {}
    tell!("Turn the nosepiece to {id}, then press Enter. Type n to end.");
    while wanted() {
        match lines.recv_timeout(LOOK) {
            Ok(line) => {
                let word = line.trim().to_ascii_lowercase();
                match word.as_str() {
                    "" | "y" | "yes" => return true,
                    "n" | "no" | "q" => return false,
                    _ => tell!("Press Enter when {id} is in, or type n to end."),
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return false,
        }
    }
    false
}
