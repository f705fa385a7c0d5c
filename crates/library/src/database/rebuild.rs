//! A database made anew from the files beside it, where it was lost: targets under the names that they were saved under, and what was measured
//! of instruments. What only rows had is gone: later names, notes, slides and runs.

use crate::database::measured_rows::{Kind, insert};
use crate::database::store::Database;
use crate::database::target_rows::NewRow;
use crate::targets::{kept_of, png};
use crate::{Label, LibraryError, target_file};
use serde::Serialize;
use serde_json::Value;
use std::path::PathBuf;

/// What was found.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Rebuilt {
    /// The targets, under the names that they have now.
    pub targets: Vec<String>,
    /// Calibrations and the like.
    pub measurements: usize,
    /// Files of which nothing could be made, such as reports of runs.
    pub left: usize,
}

impl Database {
    /// Makes a database from the files beside it. `progress` hears how many of how many are done.
    ///
    /// # Errors
    /// [`LibraryError::NotKept`] where there is a database: move it away first.
    pub fn rebuild(&self, progress: &mut dyn FnMut(usize, usize)) -> Result<Rebuilt, LibraryError> {
        if self.file().exists() {
            return Err(LibraryError::NotKept {
                path: self.file(),
                what: "there is a database, and none is made in place of it. Move it away first"
                    .into(),
            });
        }
        let name = |p: &PathBuf| Some(p.file_name()?.to_str()?.to_owned());
        let names: Vec<String> = self.objects().all()?.iter().filter_map(name).collect();
        let mut done = Rebuilt::default();
        let mut measured = Vec::new();
        for (k, object) in names.iter().enumerate() {
            progress(k, names.len());
            let Ok(bytes) = self.objects().get(object) else {
                done.left += 1;
                continue;
            };
            let place = self.objects().place(object);
            match kept_of(&place, &bytes) {
                Ok(kept) => {
                    let first = target_file::first_name(&bytes);
                    let first = first.unwrap_or_else(|| format!("target-{}", &object[..8]));
                    let frame = kept
                        .target
                        .taken
                        .as_deref()
                        .map(|t| png(&t.frame))
                        .transpose()?;
                    let name = self.write(|change| {
                        let file = self
                            .objects()
                            .put(&bytes, object.rsplit_once('.').map_or("target", |(_, e)| e))?;
                        let picture = frame
                            .as_ref()
                            .map(|png| self.objects().put(png, "png"))
                            .transpose()?;
                        let label = Label::default();
                        let mut names = std::iter::once(first.clone())
                            .chain((2..).map(|k| format!("{first}-{k}")));
                        loop {
                            let name = names.next().unwrap_or_default();
                            let new = NewRow {
                                name: &name,
                                kept: Ok(&kept),
                                label: &label,
                                file: &file,
                                picture: picture.as_ref(),
                                binned: None,
                            };
                            if new.insert(change)? {
                                return Ok(name);
                            }
                        }
                    })?;
                    done.targets.push(name);
                }
                Err(_) => match measurement(&bytes) {
                    Some(one) => measured.push((one, bytes)),
                    None => done.left += 1,
                },
            }
        }
        measured.sort_by(|(a, _), (b, _)| a.made.cmp(&b.made));
        done.measurements = measured.len();
        for (one, bytes) in measured {
            self.write(|change| {
                let file = self.objects().put(&bytes, "json")?;
                insert(
                    change,
                    one.kind,
                    [&one.instrument, &one.of, &one.made],
                    &file,
                )
            })?;
        }
        progress(names.len(), names.len());
        Ok(done)
    }
}

struct Measured {
    kind: Kind,
    instrument: String,
    of: String,
    made: String,
}

/// What a file of JSON was measured of.
fn measurement(bytes: &[u8]) -> Option<Measured> {
    let said: Value = serde_json::from_slice(bytes).ok()?;
    let text = |value: &Value| value.as_str().map(str::to_owned);
    let (kind, of) = if let Some(of) = text(&said["calibration"]["objective"]) {
        (Kind::Calibration, of)
    } else if said["set"].is_object() {
        (Kind::Set, String::new())
    } else {
        let pair = &said["switching"];
        (
            Kind::Switching,
            format!("{} to {}", text(&pair["from"])?, text(&pair["to"])?),
        )
    };
    Some(Measured {
        kind,
        instrument: text(&said["instrument"])?,
        of,
        made: text(&said["made"])?,
    })
}
