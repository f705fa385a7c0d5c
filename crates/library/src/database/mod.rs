//! A library in a database: SQLite, with what is large beside it as files that are called by their checksums.
//!
//! | file | what |
//! |---|---|
//! | `1.sql`, `2.sql`, `schema` | the tables; how an older database becomes the present one |
//! | `objects` | the files beside |
//! | `rows`, `target_rows`, `measured_rows`, `run_rows` | how rows are written and read |
//! | `store` | the database, opened when it is first asked for something |
//! | `targets`, `search`, `slides`, `measured`, `runs`, `pictures`, `journal` | what is kept |
//! | `bin`, `budget` | what goes: at once and for good, or for want of room |
//! | `under_way` | what a run needs stays until it has ended |
//! | `room`, `drive` | whether anything can be kept here |
//! | `take_in`, `old` | files of earlier versions |
//! | `check`, `archive`, `backup`, `restore`, `export`, `rebuild` | looking after it |

mod archive;
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
mod pictures;
mod rebuild;
mod restore;
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
mod under_way;
mod wrong;

pub use backup::BackedUp;
pub use bin::Purged;
pub use budget::FRAMES_BYTES;
pub use check::{Checked, Fault};
pub use export::Exported;
pub use pictures::{NewPicture, PICTURES, PictureRow};
pub use rebuild::Rebuilt;
pub use restore::{Restored, restore};
pub use run_rows::RunRow;
pub use runs::RunQuery;
pub use search::{Chance, TargetQuery};
pub use slides::SlideRow;
pub use store::Database;
pub use target_rows::TargetRow;
