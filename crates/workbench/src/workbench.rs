//! The instrument that somebody described, opened.

use crate::journal::{self, FileJournal};
use crate::known;
use scopeservo_library::{Database, Journal as _, Journalled, LibraryError};
use scopeservo_scope::{CancelToken, GateEvent, Instrument};
use scopeservo_servo::{Parcentric, SwitchingReport};
use scopeservo_setup::{Config, Consent, Held, Opened, SetupError, connect};
use scopeservo_station::{News, Record};
use scopeservo_twin::Twin;
use scopeservo_twin::specimen::Specimen;
use std::sync::{Arc, Mutex};
use thiserror::Error;

/// What a front end works at.
pub struct Workbench {
    /// The description.
    pub config: Config,
    /// What is kept.
    pub library: Arc<Database>,
    /// The instrument.
    pub scope: Arc<Instrument>,
    /// The simulated microscope, where it is one of this process.
    pub twin: Option<Twin>,
    /// Each driver with the name it gives itself.
    pub drivers: Vec<(String, String)>,
    /// What is known of where its objectives look and focus beside each other.
    pub switchings: Vec<SwitchingReport>,
    /// The same by calibrations that were made together.
    pub parcentric: Vec<Parcentric>,
    /// What lay under a simulated microscope at first, while something else does.
    pub(crate) first_specimen: Mutex<Option<Arc<dyn Specimen>>>,
    /// Where the state of its jobs goes.
    pub journal: Arc<FileJournal>,
    /// Let go last.
    _held: Held,
}

/// Why an instrument could not be opened.
#[derive(Debug, Error)]
pub enum OpenError {
    /// The description, or what it describes.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// What is kept of it.
    #[error(transparent)]
    Library(#[from] LibraryError),
}

impl Workbench {
    /// Takes the instrument for this program and finds its devices; nothing moves, and nothing is homed. What of its library cannot be read
    /// is told to `warn`. `cancel` ends what is done with the instrument.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn open(
        config: Config,
        consent: &Consent,
        cancel: CancelToken,
        mut warn: impl FnMut(LibraryError),
    ) -> Result<Self, OpenError> {
        let held = Held::data(&config)?;
        let library = Arc::new(Database::new(config.resolve(&config.data_folder)));
        library
            .take_in(&mut |_, _| {})?
            .into_iter()
            .for_each(&mut warn);
        let Opened {
            instrument,
            twin,
            drivers,
        } = connect(&config, consent, cancel)?;
        let scope = Arc::new(instrument);
        known::shadows(&config, &library, &scope, &mut warn);
        let switchings = known::switchings(&config, &library, &scope, &mut warn);
        let parcentric = known::parcentric(&config, &library, &mut warn);
        let journal = Arc::new(FileJournal::new(&library, &config.name, &scope));
        Ok(Self {
            config,
            library,
            scope,
            twin,
            drivers,
            switchings,
            parcentric,
            first_specimen: Mutex::default(),
            journal,
            _held: held,
        })
    }

    /// Must hear every event as it happens: where the stage is sent is kept before it goes.
    pub fn keeper(&self) -> impl Fn(&Record) + Send + Sync + 'static {
        let journal = self.journal.clone();
        move |record| {
            if let News::Gate(GateEvent::MoveAsked { to }) = &record.news {
                journal.goes(to);
            }
        }
    }

    /// Whether stage or camera are simulated, by our own description or by what a driver calls them.
    pub fn is_simulated(&self) -> bool {
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
    pub fn specimen(&self) -> String {
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

    /// What a killed program left.
    ///
    /// # Errors
    /// [`LibraryError::DamagedJournal`].
    pub fn left(&self) -> Result<Option<Journalled>, LibraryError> {
        self.library.journal(&self.config.name)
    }

    /// Where things stand with what a killed program left, for people; `None` when nothing waits.
    ///
    /// # Errors
    /// As [`Workbench::left`].
    pub fn waits(&self) -> Result<Option<String>, LibraryError> {
        let left = self.left()?;
        Ok(left.map(|left| journal::standing(&left, &self.scope)))
    }

    /// What a killed program left needs nothing more.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`].
    pub fn end_left(&self) -> Result<(), LibraryError> {
        self.journal.close()
    }
}
