//! What ends the program early: in a sentence for people, and in a code word and an exit code for programs.

use clap::ValueEnum;
use scopeservo_library::LibraryError;
use scopeservo_scope::{Remedy as ScopeRemedy, ScopeError};
use scopeservo_servo::{ErrorCode, Remedy, ServoError};
use scopeservo_setup::SetupError;
use scopeservo_slide::SlideError;
use scopeservo_station::JobError;
use scopeservo_workbench::OpenError;
use serde::Serialize;
use std::io;
use std::path::PathBuf;
use thiserror::Error;

#[derive(Debug, Error)]
pub(crate) enum CliError {
    #[error("{0}")]
    Usage(String),
    #[error(transparent)]
    Slide(#[from] SlideError),
    #[error(transparent)]
    Specimen(#[from] scopeservo_twin::specimen::SpecimenError),
    #[error(
        "{path} is only {width}x{height} pixels, too small to hold features; give an image of at least {least} pixels each way"
    )]
    TooSmall {
        path: PathBuf,
        width: usize,
        height: usize,
        least: usize,
    },
    /// Tried before anything moves.
    #[error("cannot write to {path}: {source}. Make that possible, or {instead}")]
    CannotWrite {
        path: PathBuf,
        source: io::Error,
        /// What else to do.
        instead: &'static str,
    },
    /// What the program says that serves the instrument.
    #[error("{0}")]
    AtServer(String),
    #[error(transparent)]
    Library(#[from] LibraryError),
    /// A job was killed, and waits.
    #[error(
        "{0}. `scopeservo resume` goes on with it, `scopeservo abandon` ends it; nothing moved"
    )]
    Unfinished(String),
    /// It cannot go on.
    #[error("{0}; nothing moved. `scopeservo abandon` ends the job")]
    CannotResume(String),
    #[error(transparent)]
    Setup(#[from] SetupError),
    #[error("{path} cannot be read: {what}")]
    Read { path: PathBuf, what: String },
    #[error(transparent)]
    Servo(#[from] ServoError),
    #[error(transparent)]
    Twin(#[from] scopeservo_twin::TwinError),
    #[error("the features could not be computed: {0}")]
    Features(#[from] scopeservo_features::FeatureError),
    /// Where there is no instrument yet that would have to be stopped.
    #[error("stopped on request")]
    Interrupted,
    /// Asked twice.
    #[error("left on request, without waiting for the instrument: see whether it stands still")]
    Left,
    #[error("{0}")]
    Internal(String),
}

impl From<ScopeError> for CliError {
    fn from(error: ScopeError) -> Self {
        Self::Servo(error.into())
    }
}

impl From<OpenError> for CliError {
    fn from(error: OpenError) -> Self {
        match error {
            OpenError::Setup(error) => error.into(),
            OpenError::Library(error) => error.into(),
        }
    }
}

impl From<JobError> for CliError {
    fn from(error: JobError) -> Self {
        match error {
            JobError::Stopped { at } => Self::Servo(ScopeError::Interrupted { at }.into()),
            JobError::Procedure(error) => Self::Servo(error),
            JobError::NoObjective { available } => Self::Usage(format!(
                "nobody knows which objective is active: name one with --objective. There are {available}"
            )),
            JobError::Journal(_) => Self::Library(LibraryError::NotKept {
                path: "journal".into(),
                what: error.to_string(),
            }),
            error => Self::Internal(error.to_string()),
        }
    }
}

/// The code words of errors and warnings, for programs. Stable: added to, never renamed. `docs/answers.md` explains each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Code {
    Usage,
    BadImage,
    BadDescription,
    NoDriver,
    CannotWrite,
    CannotRead,
    Damaged,
    Refused,
    InUse,
    Unfinished,
    NoFocus,
    AtLimit,
    StaleImages,
    Blurred,
    CalibrationFailed,
    WrongObjective,
    PoorTarget,
    NothingMoves,
    Ambiguous,
    GridFailed,
    CheckFailed,
    LevelFailed,
    Immersion,
    NotKept,
    ObjectivesDisagree,
    ForeignTarget,
    NobodysCalibration,
    Interrupted,
    Fault,
    Internal,
}

impl Code {
    /// The exit code of a command that it ends: 2 where the user can mend it by other input, 3 where the instrument refused or did
    /// not find, else 1.
    pub(crate) fn exit(self) -> u8 {
        match self {
            Self::Usage
            | Self::BadImage
            | Self::BadDescription
            | Self::NoDriver
            | Self::CannotWrite
            | Self::CannotRead
            | Self::Damaged => 2,
            Self::Refused
            | Self::InUse
            | Self::Unfinished
            | Self::NoFocus
            | Self::AtLimit
            | Self::StaleImages
            | Self::CalibrationFailed
            | Self::WrongObjective
            | Self::PoorTarget
            | Self::NothingMoves
            | Self::Ambiguous
            | Self::GridFailed
            | Self::CheckFailed
            | Self::LevelFailed
            | Self::Immersion => 3,
            Self::NotKept
            | Self::ObjectivesDisagree
            | Self::ForeignTarget
            | Self::NobodysCalibration
            | Self::Blurred
            | Self::Interrupted
            | Self::Fault
            | Self::Internal => 1,
        }
    }
}

impl CliError {
    /// What is wrong, and which command or flag of this program helps.
    pub(crate) fn words(&self) -> String {
        let remedy = match self {
            Self::Servo(error) => error.remedy(),
            Self::Setup(SetupError::Read { .. }) => {
                return format!("{self}. `scopeservo init` writes one");
            }
            Self::Library(LibraryError::NoTarget { known, .. }) if known.is_empty() => {
                return format!("{self}: `scopeservo target save NAME`");
            }
            Self::Library(LibraryError::DamagedCalibration { objective, .. }) => {
                return format!(
                    "{self}: `scopeservo calibrate --objective {}`",
                    shell(objective)
                );
            }
            Self::Library(LibraryError::DamagedJournal { .. }) => {
                return format!(
                    "{self}. Look where the stage stands; `scopeservo abandon` puts it aside"
                );
            }
            Self::Setup(error) => error.remedy().map(Remedy::Scope),
            _ => None,
        };
        match remedy {
            Some(remedy) => format!("{self}{}", advice(&remedy)),
            None => self.to_string(),
        }
    }

    pub(crate) fn code(&self) -> Code {
        match self {
            Self::Usage(_) => Code::Usage,
            Self::Slide(_) | Self::Specimen(_) | Self::TooSmall { .. } => Code::BadImage,
            Self::CannotWrite { .. } => Code::CannotWrite,
            Self::Library(error) => library_code(error),
            Self::AtServer(_) => Code::Refused,
            Self::Unfinished(_) | Self::CannotResume(_) => Code::Unfinished,
            Self::Read { .. } => Code::CannotRead,
            Self::Setup(error) => setup_code(error),
            Self::Servo(error) => servo_code(error),
            Self::Interrupted | Self::Left => Code::Interrupted,
            Self::Twin(_) | Self::Features(_) | Self::Internal(_) => Code::Internal,
        }
    }
}

/// A word as a command line takes it.
pub(crate) fn shell(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:".contains(c);
    match !word.is_empty() && word.chars().all(plain) {
        true => word.into(),
        false => format!("'{}'", word.replace('\'', "'\\''")),
    }
}

fn library_code(error: &LibraryError) -> Code {
    match error {
        LibraryError::BadName(_)
        | LibraryError::Taken { .. }
        | LibraryError::NoTarget { .. }
        | LibraryError::NoTargetNumbered { .. }
        | LibraryError::NotInBin { .. }
        | LibraryError::NoPicture { .. }
        | LibraryError::TooManyPictures { .. }
        | LibraryError::NoRun { .. } => Code::Usage,
        LibraryError::CannotWrite { .. } | LibraryError::NetworkDrive { .. } => Code::CannotWrite,
        LibraryError::Busy { .. } | LibraryError::InUse { .. } => Code::InUse,
        LibraryError::NotKept { .. } => Code::NotKept,
        LibraryError::Read { .. } | LibraryError::Newer { .. } => Code::CannotRead,
        LibraryError::Damaged { .. }
        | LibraryError::DamagedCalibration { .. }
        | LibraryError::NoSums { .. }
        | LibraryError::NotExported { .. }
        | LibraryError::DamagedJournal { .. } => Code::Damaged,
        LibraryError::NobodysCalibration { .. } => Code::NobodysCalibration,
        _ => Code::Internal,
    }
}

/// The end of the sentence that an error is.
pub(crate) fn advice(remedy: &Remedy) -> String {
    match remedy {
        Remedy::Scope(ScopeRemedy::Home) => ", then allow it with --home".into(),
        Remedy::Scope(ScopeRemedy::BringBack) => ": `scopeservo stage go`".into(),
        Remedy::Scope(ScopeRemedy::FocusNear { objective, z_um }) => {
            format!(": `scopeservo focus --objective {objective} --near-z-um {z_um:.1}`")
        }
        Remedy::Scope(ScopeRemedy::AgreeToImmersion { to }) => {
            format!(", in a terminal or with --immersion {}", to.word())
        }
        Remedy::DescribeOneObjective => " (nosepiece = \"none\")".into(),
        Remedy::CorrectScales => " (um_per_px)".into(),
        _ => String::new(),
    }
}

fn setup_code(error: &SetupError) -> Code {
    match error.root() {
        SetupError::Driver(_) => Code::NoDriver,
        SetupError::Specimen(_) => Code::BadImage,
        SetupError::InUse { .. } | SetupError::NameInUse { .. } => Code::InUse,
        SetupError::Held { .. } => Code::CannotWrite,
        // What the file sets cannot be.
        SetupError::Scope(ScopeError::BadSetting { .. }) => Code::BadDescription,
        SetupError::Scope(error) => servo_code(&ServoError::Scope(error.clone())),
        _ => Code::BadDescription,
    }
}

fn servo_code(error: &ServoError) -> Code {
    match error.code() {
        ErrorCode::NoFocus => Code::NoFocus,
        ErrorCode::AtLimit => Code::AtLimit,
        ErrorCode::StaleImages => Code::StaleImages,
        ErrorCode::CalibrationFailed => Code::CalibrationFailed,
        ErrorCode::WrongObjective => Code::WrongObjective,
        ErrorCode::PoorTarget => Code::PoorTarget,
        ErrorCode::NothingMoves => Code::NothingMoves,
        ErrorCode::Ambiguous => Code::Ambiguous,
        ErrorCode::GridFailed => Code::GridFailed,
        ErrorCode::CheckFailed => Code::CheckFailed,
        ErrorCode::LevelFailed => Code::LevelFailed,
        ErrorCode::Immersion => Code::Immersion,
        ErrorCode::OutsideLimits | ErrorCode::Refused => Code::Refused,
        ErrorCode::Interrupted => Code::Interrupted,
        ErrorCode::Fault => Code::Fault,
        ErrorCode::Internal => Code::Internal,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// The rows of the page's table: word and exit code.
    fn page() -> Vec<(String, u8)> {
        let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/answers.md");
        let text = std::fs::read_to_string(page).unwrap();
        let rows = text.lines().filter_map(|line| {
            let mut cells = line.strip_prefix("| `")?.split('|');
            let word = cells.next()?.trim().trim_end_matches('`').to_owned();
            Some((word, cells.next()?.trim().parse().ok()?))
        });
        rows.collect()
    }

    #[test]
    fn an_error_names_the_flag_or_the_command_that_helps() {
        let told = |error: ScopeError| {
            let ours = CliError::from(error.clone()).words();
            assert_eq!(CliError::Setup(error.clone().into()).words(), ours);
            // The library names neither.
            let theirs = error.to_string();
            assert!(!theirs.contains("--") && !theirs.contains('`'), "{theirs}");
            ours
        };
        let home = told(ScopeError::NotHomed { device: "stage" });
        assert!(
            home.ends_with("make room, then allow it with --home"),
            "{home}"
        );
        let breach = || scopeservo_scope::Breach::Workspace { share: 1.5 };
        for outside in [
            told(ScopeError::StandsOutside { breach: breach() }),
            told(ScopeError::Strayed { breach: breach() }),
        ] {
            assert!(outside.ends_with("`scopeservo stage go`"), "{outside}");
        }
        let immersion = told(ScopeError::ImmersionNotAgreed {
            change: scopeservo_scope::ImmersionChange {
                objective: scopeservo_scope::ObjectiveId("60x".into()),
                to: scopeservo_scope::Immersion::Silicone,
                from: [scopeservo_scope::Immersion::Air].into(),
            },
        });
        assert!(
            immersion.ends_with("agree to this change, in a terminal or with --immersion silicone"),
            "{immersion}"
        );
        let change = told(ScopeError::ChangeEnded {
            asked: scopeservo_scope::ObjectiveId("40x".into()),
            retracted_from_um: Some(12.34),
        });
        assert!(
            change.ends_with("from before: `scopeservo focus --objective 40x --near-z-um 12.3`"),
            "{change}"
        );
    }

    #[test]
    fn an_error_of_a_procedure_names_the_key_of_the_file_that_helps() {
        let objective = || scopeservo_scope::ObjectiveId("40x".into());
        let coarse = CliError::from(ServoError::StageTooCoarse {
            objective: objective(),
            moved_um: 5.0,
            scatter_um: 4.0,
        });
        assert!(coarse.words().ends_with("(nosepiece = \"none\")"));
        let wrong = CliError::from(ServoError::WrongObjective {
            told: objective(),
            looks_like: None,
            um_per_px: 1.0,
        });
        assert!(wrong.words().ends_with("(um_per_px)"), "{}", wrong.words());
    }

    #[test]
    fn every_code_word_is_explained_with_its_exit_code_and_no_other() {
        let mut known: Vec<(String, u8)> = Code::value_variants()
            .iter()
            .map(|code| {
                let word = serde_json::to_value(code).unwrap();
                (word.as_str().unwrap().to_owned(), code.exit())
            })
            .collect();
        let mut page = page();
        known.sort();
        page.sort();
        assert_eq!(known, page);
    }
}
