//! What was told of files, by the files as they were then: each is some megabytes, and seldom another.

use crate::lock;
use serde_json::Value;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::SystemTime;

/// By what a file is known to be the same.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stamp {
    modified: SystemTime,
    length: u64,
}

impl Stamp {
    /// That of a file; `None` where the system does not tell.
    pub(crate) fn of(path: &Path) -> Option<Self> {
        let file = std::fs::metadata(path).ok()?;
        Some(Self {
            modified: file.modified().ok()?,
            length: file.len(),
        })
    }
}

/// What was told.
#[derive(Default)]
pub(crate) struct Remembered(Mutex<HashMap<PathBuf, (Stamp, Value)>>);

impl Remembered {
    /// What was told of this file, where it is the same.
    pub(crate) fn get(&self, path: &Path, stamp: Option<Stamp>) -> Option<Value> {
        let all = lock(&self.0);
        let (then, value) = all.get(path)?;
        (Some(*then) == stamp).then(|| value.clone())
    }

    /// That this is told of it.
    pub(crate) fn put(&self, path: PathBuf, stamp: Option<Stamp>, value: Value) {
        if let Some(stamp) = stamp {
            lock(&self.0).insert(path, (stamp, value));
        }
    }

    /// Those that are gone are not remembered.
    pub(crate) fn keep(&self, there: &HashSet<PathBuf>) {
        lock(&self.0).retain(|path, _| there.contains(path));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_file_that_is_another_is_told_anew() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.target");
        let told = Remembered::default();
        let stamp = || Stamp::of(&path);
        assert_eq!(stamp(), None);
        std::fs::write(&path, "one").unwrap();
        assert_eq!(told.get(&path, stamp()), None);
        told.put(path.clone(), stamp(), json!(1));
        assert_eq!(told.get(&path, stamp()), Some(json!(1)));
        std::fs::write(&path, "another").unwrap();
        assert_eq!(told.get(&path, stamp()), None);
        told.put(path.clone(), stamp(), json!(2));
        told.keep(&HashSet::new());
        assert_eq!(told.get(&path, stamp()), None);
    }
}
