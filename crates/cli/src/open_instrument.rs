//! The instrument that the user described, opened so that Ctrl-C stops it.

use crate::answer::Answer;
use crate::args::InstrumentArgs;
use crate::asking;
use crate::bar;
use crate::beginning;
use crate::console::{Console, Late, Told};
use crate::error::{CliError, Code};
use crate::journal::{self, Asked, FileJournal, Made};
use crate::progress::Watcher;
use scopeservo_library::{
    CalibrationSets as _, Cameras as _, Folder, Journal as _, Journalled, Nosepieces as _, RunHead,
    RunLog, Runs as _,
};
use scopeservo_scope::{CancelToken, GateEvent, Instrument, Length, ObjectiveId};
use scopeservo_servo::{ErrorKind, Parcentric, SwitchingReport};
use scopeservo_setup::{Config, Consent, Held, Opened, connect, home_if_needed};
use scopeservo_station::{News, StationEvent, UseCase};
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// What a command works at.
pub(crate) struct OpenInstrument {
    pub(crate) config: Config,
    pub(crate) library: Arc<Folder>,
    pub(crate) scope: Arc<Instrument>,
    pub(crate) drivers: Vec<(String, String)>,
    pub(crate) console: Console,
    /// What is known of where its objectives look and focus beside each other.
    pub(crate) switchings: Vec<SwitchingReport>,
    /// The same by calibrations that were made together.
    pub(crate) parcentric: Vec<Parcentric>,
    journal: Arc<FileJournal>,
    /// Let go last.
    _held: Held,
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
        let held = Held::data(&config)?;
        let library = Arc::new(Folder::new(config.resolve(&config.data_folder)));
        let cancel = CancelToken::new();
        let stop = stop_on_interrupt(&cancel, answer);
        let consent = Consent {
            home: args.home,
            ask: Arc::new(asking::to_turn),
            ask_immersion: asking::about_immersion(args.immersion),
        };
        let Opened {
            instrument,
            drivers,
            ..
        } = connect(&config, &consent, cancel)?;
        let scope = Arc::new(instrument);
        stop.hold(&scope);
        // What lay on the camera when it was seen last.
        let info = scope.camera().info();
        let seen = library.shadows(&config.name, [info.width, info.height]);
        scope.set_flat_field(answer.or_warn(seen).flatten().map(Arc::new));
        let switchings = known_switchings(&config, &library, &scope, answer);
        let set = answer.or_warn(library.calibration_set(&config.name));
        let parcentric = set.flatten().map_or(Vec::new(), |kept| kept.set.parcentric);
        let journal = Arc::new(FileJournal::new(&library, &config.name, &scope));
        let goes = journal.clone();
        let console = Console::new(&scope, journal.clone(), Late::LeftOut, move |record| {
            if let News::Gate(GateEvent::MoveAsked { to }) = &record.news {
                goes.goes(to);
            }
        })?;
        let opened = Self {
            config,
            library,
            scope,
            drivers,
            console,
            switchings,
            parcentric,
            journal,
            _held: held,
        };
        Ok((opened, consent))
    }

    /// Whether stage or camera are simulated, by our own description or by what a driver calls them.
    pub(crate) fn is_simulated(&self) -> bool {
        let devices = &self.config.devices;
        let described = [&devices.stage, &devices.camera].into_iter().any(|name| {
            let driver = self.config.drivers.get(name);
            driver.is_some_and(|driver| driver.twin.is_some())
        });
        let names = [
            &self.scope.gate().info().name,
            &self.scope.camera().info().name,
        ];
        let told = names
            .iter()
            .any(|name| name.to_lowercase().contains("simulated"));
        described || told
    }

    /// What lies under a simulated microscope; nobody knows it of another.
    pub(crate) fn specimen(&self) -> String {
        let driver = self.config.drivers.get(&self.config.devices.camera);
        let Some(twin) = driver.and_then(|driver| driver.twin.as_ref()) else {
            return String::new();
        };
        match (&twin.specimen, &twin.made) {
            (Some(file), _) => file.display().to_string(),
            (None, Some(_)) => "a specimen made up as described".into(),
            (None, None) => format!("procedural tissue, seed {}", twin.seed),
        }
    }

    /// Whether nothing that was killed waits to go on; else an error tells where things stand.
    pub(crate) fn check_nothing_waits(&self) -> Result<(), CliError> {
        match self.library.journal(&self.config.name)? {
            None => Ok(()),
            Some(left) => Err(CliError::Unfinished(journal::standing(&left, &self.scope))),
        }
    }

    /// Tells what waits to go on, where that is no obstacle.
    pub(crate) fn tell_what_waits(&self, answer: &Answer) {
        if let Err(waits) = self.check_nothing_waits() {
            answer.warn(waits.code(), waits);
        }
    }

    /// What a killed program left.
    pub(crate) fn left(&self) -> Result<Option<Journalled>, CliError> {
        Ok(self.library.journal(&self.config.name)?)
    }

    /// What a killed program left needs nothing more.
    pub(crate) fn end_left(&self) -> Result<(), CliError> {
        Ok(self.journal.close()?)
    }

    /// Runs a job to its end, shows what it does, and keeps its record.
    pub(crate) fn run<U: UseCase>(
        &self,
        case: U,
        asked: Asked,
        watcher: &mut Watcher,
        answer: &Answer,
    ) -> Result<Ran<U::Output>, CliError> {
        let head = RunHead {
            job: case.kind().into(),
            instrument: self.config.name.clone(),
            version: format!("scopeservo {}", env!("CARGO_PKG_VERSION")),
            inputs: asked.inputs.clone(),
        };
        self.journal.comes(case.kind(), asked);
        let mut record = answer.or_warn(self.library.begin_run(&head));
        let output = self.console.follow(case, |told| {
            told.show(watcher);
            let Told::Event(news) = told else { return };
            if let (Some(record), Ok(line)) = (&mut record, serde_json::to_string(&*news)) {
                record.event(&line);
            }
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
            made: self.journal.made(),
            record,
            journal: self.journal.clone(),
        })
    }
}

/// What was kept of the nosepiece, of objectives that it carries; the instrument learns how high they focus beside each other.
fn known_switchings(
    config: &Config,
    library: &Folder,
    scope: &Instrument,
    answer: &Answer,
) -> Vec<SwitchingReport> {
    let kept = answer.or_warn(library.switchings(&config.name));
    let kept = kept.into_iter().flatten();
    let all = kept.filter_map(|kept| Some(answer.or_warn(kept)?.switching));
    let there = |id: &ObjectiveId| scope.objective(id).is_ok();
    let all: Vec<_> = all.filter(|s| there(&s.from) && there(&s.to)).collect();
    for SwitchingReport {
        from, to, focus, ..
    } in &all
    {
        if let Some(focus) = focus {
            scope.parfocal_known([from, to], Length::from_um(focus.offset_um.value));
        }
    }
    all
}

/// What a job came to.
pub(crate) struct Ran<T> {
    pub(crate) output: Result<T, CliError>,
    /// What it made on the way, however it ended, and where that is kept.
    pub(crate) made: Vec<Made>,
    record: Option<Box<dyn RunLog>>,
    journal: Arc<FileJournal>,
}

impl<T> Ran<T> {
    /// Keeps the answer as it stands, and the page, with the record of the run. Only then the journal ends: whoever is killed before has the
    /// answer given again.
    pub(crate) fn end(mut self, page: Option<&str>, answer: &Answer) -> Result<T, CliError> {
        if let Some(record) = &mut self.record {
            if let Some(page) = page {
                answer.or_warn(record.attach("report.html", page.as_bytes()));
            }
            let object = match &self.output {
                Ok(_) => answer.object(),
                Err(error) => answer.object_with(error),
            };
            answer.or_warn(record.end(&object));
        }
        answer.or_warn(self.journal.close());
        self.output
    }
}
