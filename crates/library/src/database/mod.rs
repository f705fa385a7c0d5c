//! A library in a database: SQLite, with what is large beside it as files that are called by their checksums.
//!
//! | file | what |
//! |---|---|
//! | `1.sql`, `schema` | the tables; how an older database becomes the present one |
//! | `objects` | the files beside |
//! | `rows`, `target_rows`, `measured_rows`, `run_rows` | how rows are written and read |
//! | `store` | the database, opened when it is first asked for something |
//! | `targets`, `search`, `slides`, `measured`, `runs`, `journal` | what is kept |
//! | `bin`, `budget` | what goes: at once and for good, or for want of room |
//! | `room`, `drive` | whether anything can be kept here |
//! | `take_in`, `old` | files of earlier versions |
//! | `check`, `backup`, `export`, `rebuild` | looking after it |

mod backup;
mod bin;
mod budget;
mod check;
mod drive;
mod export;
mod journal;
mod measured;
mod measured_rows;
mod objects;
mod old;
mod rebuild;
mod room;
mod rows;
mod run_rows;
mod runs;
mod schema;
mod search;
mod slides;
mod store;
mod take_in;
mod target_rows;
mod targets;
mod wrong;

pub use backup::{BackedUp, restore};
pub use bin::Purged;
pub use budget::FRAMES_BYTES;
pub use check::{Checked, Fault};
pub use export::Exported;
pub use rebuild::Rebuilt;
pub use run_rows::RunRow;
pub use runs::RunQuery;
pub use search::TargetQuery;
pub use slides::SlideRow;
pub use store::Database;
pub use target_rows::TargetRow;
