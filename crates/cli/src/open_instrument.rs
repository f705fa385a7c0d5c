//! The instrument that the user described, opened so that Ctrl-C stops it.

use crate::answer::Answer;
use crate::args::InstrumentArgs;
use crate::asking;
use crate::bar;
use crate::beginning;
use crate::console::{Console, hand_on};
use crate::error::{CliError, Code};
use crate::progress::Watcher;
use scopeservo_scope::{CancelToken, Instrument};
use scopeservo_servo::ErrorKind;
use scopeservo_setup::{Config, Consent, home_if_needed};
use scopeservo_station::{News, StationEvent, UseCase};
use scopeservo_workbench::{Asked, Late, Made, RunRecord, Told, Usual, Workbench};
use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// What a command works at.
pub(crate) struct OpenInstrument {
    pub(crate) console: Console,
    bench: Workbench,
}

impl Deref for OpenInstrument {
    type Target = Workbench;

    fn deref(&self) -> &Workbench {
        &self.bench
    }
}

/// What Ctrl-C stops; nothing until an instrument is there.
#[derive(Clone, Default)]
pub(crate) struct StopHandle(Arc<Mutex<Weak<Instrument>>>);

impl StopHandle {
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
pub(crate) fn stop_on_interrupt(cancel: &CancelToken, answer: &Answer) -> StopHandle {
    let stop = StopHandle::default();
    let (wish, held, leaving) = (cancel.clone(), stop.clone(), answer.clone());
    let mut asked = 0;
    answer.on_interrupt(move || {
        asked += 1;
        let scope = held.held();
        if wish.is_cancelled() {
            match &scope {
                // Asked twice: the instrument was told to stop, and nobody waits any longer.
                Some(_) => leaving.leave(CliError::Left),
                None if asked >= IMPATIENT => leaving.leave(CliError::Left),
                // A driver may be starting.
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
    stop
}

impl OpenInstrument {
    /// The instrument, homed where it needs that and the user agreed.
    pub(crate) fn open(args: &InstrumentArgs, answer: &Answer) -> Result<Self, CliError> {
        let (opened, consent) = Self::connected(args, answer)?;
        // Told like every other motion.
        home_if_needed(&opened.scope, &consent)?;
        Ok(opened)
    }

    /// What the description says of every job.
    pub(crate) fn usual(&self) -> Usual<'_> {
        Usual::of(&self.config)
    }

    /// The instrument as it is, for a look at it: nothing is homed.
    pub(crate) fn look(args: &InstrumentArgs, answer: &Answer) -> Result<Self, CliError> {
        Ok(Self::connected(args, answer)?.0)
    }

    fn connected(args: &InstrumentArgs, answer: &Answer) -> Result<(Self, Consent), CliError> {
        let shown = bar::spinner("opening the instrument".into());
        let opened = Self::connect(args, answer);
        shown.finish_and_clear();
        opened
    }

    fn connect(args: &InstrumentArgs, answer: &Answer) -> Result<(Self, Consent), CliError> {
        let config = Config::read(&args.description.config)?;
        let cancel = CancelToken::new();
        let stop = stop_on_interrupt(&cancel, answer);
        let consent = Consent {
            home: args.home,
            ask: Arc::new(asking::to_turn),
            ask_immersion: asking::about_immersion(args.immersion),
        };
        let bench = Workbench::open(config, &consent, cancel, |unread| {
            answer.or_warn::<()>(Err(unread));
        })?;
        stop.hold(&bench.scope);
        let journal = bench.journal.clone();
        let console = Console::new(&bench.scope, journal, Late::LeftOut, bench.keeper())?;
        Ok((Self { console, bench }, consent))
    }

    /// Whether nothing that was killed waits to go on; else an error tells where things stand.
    pub(crate) fn check_nothing_waits(&self) -> Result<(), CliError> {
        match self.waits()? {
            None => Ok(()),
            Some(standing) => Err(CliError::Unfinished(standing)),
        }
    }

    /// Tells what waits to go on, where that is no obstacle.
    pub(crate) fn tell_what_waits(&self, answer: &Answer) {
        if let Err(waits) = self.check_nothing_waits() {
            answer.warn(waits.code(), waits);
        }
    }

    /// Runs a job to its end, shows what it does, and keeps its record.
    pub(crate) fn run<U: UseCase>(
        &self,
        case: U,
        asked: Asked,
        watcher: &mut Watcher,
        answer: &Answer,
    ) -> Result<Ran<U::Output>, CliError> {
        // What cannot be kept is not begun.
        self.library.try_room()?;
        let (mut record, lost) = self.record(case.kind(), asked);
        if let Some(lost) = lost {
            answer.or_warn::<()>(Err(lost));
        }
        let output = self.console.follow(case, |told| {
            hand_on(&told, watcher);
            let Told::Event(news) = told else { return };
            record.event(&news);
            if let News::Station(StationEvent::NotKept { why, .. }) = &news.news {
                answer.warn(Code::NotKept, why);
            }
        })?;
        watcher.finish();
        if let Some(lost) = self.journal.lost() {
            answer.warn(Code::NotKept, lost);
        }
        if let Err(CliError::Servo(error)) = &output
            && matches!(error.kind(), ErrorKind::Interruption | ErrorKind::Fault)
        {
            beginning::tell(&self.scope, answer);
        }
        Ok(Ran {
            output,
            made: record.made(),
            record,
        })
    }
}

/// What a job came to.
pub(crate) struct Ran<T> {
    pub(crate) output: Result<T, CliError>,
    /// What it made on the way, however it ended, and where that is kept.
    pub(crate) made: Vec<Made>,
    record: RunRecord,
}

impl<T> Ran<T> {
    /// Keeps what the view looked like at arrival.
    pub(crate) fn arrived(&mut self, seen: Option<Vec<u8>>, answer: &Answer) {
        if let Some(seen) = seen {
            answer.or_warn(self.record.arrived(&seen));
        }
    }

    /// Keeps the answer as it stands, and the page, with the record of the run.
    pub(crate) fn end(self, page: Option<&str>, answer: &Answer) -> Result<T, CliError> {
        let object = match &self.output {
            Ok(_) => answer.object(),
            Err(error) => answer.object_with(error),
        };
        for lost in self.record.end(page, &object) {
            answer.or_warn::<()>(Err(lost));
        }
        self.output
    }
}
