//! The instrument that the user described, opened so that Ctrl-C stops it.

use crate::args::InstrumentArgs;
use crate::error::CliError;
use crate::store::Store;
use scopeservo_scope::{CancelToken, Instrument, Objective, ObjectiveId};
use scopeservo_setup::{Config, Consent, Opened, open};
use std::io::{BufRead, IsTerminal};
use std::sync::{Arc, OnceLock, Weak};

/// What a command works at.
pub(crate) struct Desk {
    pub(crate) config: Config,
    pub(crate) store: Store,
    pub(crate) scope: Arc<Instrument>,
    pub(crate) drivers: Vec<(String, String)>,
}

/// What Ctrl-C stops; empty until the instrument is there.
type Reins = Arc<OnceLock<Weak<Instrument>>>;

/// From now on Ctrl-C cancels, and stops what moves.
pub(crate) fn rein_in(cancel: &CancelToken) -> Result<Reins, CliError> {
    let reins: Reins = Arc::default();
    let (wish, held) = (cancel.clone(), reins.clone());
    ctrlc::set_handler(move || {
        let scope = held.get().and_then(Weak::upgrade);
        if wish.is_cancelled() {
            match &scope {
                // Asked twice: the instrument was told to stop, and nobody waits any longer.
                Some(_) => std::process::exit(1),
                // It may be homing, and only who homes can stop that.
                None => return eprintln!("scopeservo: stopping; wait for the instrument"),
            }
        }
        wish.cancel();
        // From here too, should the working thread hang in a device.
        if let Some(scope) = scope
            && let Err(error) = scope.gate().stop()
        {
            eprintln!("scopeservo: the instrument did not take the stop: {error}");
        }
    })
    .map_err(|e| CliError::Internal(format!("Ctrl-C could not be provided for: {e}")))?;
    Ok(reins)
}

impl Desk {
    pub(crate) fn open(args: &InstrumentArgs) -> Result<Self, CliError> {
        let config = Config::read(&args.config)?;
        let store = Store::new(config.resolve(&config.data_folder));
        let cancel = CancelToken::new();
        let reins = rein_in(&cancel)?;
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
        let _ = reins.set(Arc::downgrade(&scope));
        Ok(Self {
            config,
            store,
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

/// Asks whoever sits at the terminal to turn the nosepiece.
fn ask(objective: &Objective) -> bool {
    let id = &objective.id;
    if !std::io::stdin().is_terminal() {
        eprintln!(
            "scopeservo: the objective {id} is needed, and nobody is there to turn the nosepiece"
        );
        return false;
    }
    eprintln!("Turn the nosepiece to {id}, then press Enter. Type n to end.");
    let mut line = String::new();
    let read = std::io::stdin().lock().read_line(&mut line);
    read.is_ok_and(|n| n > 0) && !line.trim().eq_ignore_ascii_case("n")
}
