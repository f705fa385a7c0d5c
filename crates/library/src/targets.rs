//! Saved views. A name is given once, each target is one file that can be copied to another library, and its image lies beside it for
//! people.

use crate::files::{self, is_there, make_folder, write_new};
use crate::folder::{Folder, entries, is_json, keep_new, parse, read, to_json, to_png};
use crate::names::{check_name, plain_name, utc};
use crate::{KeptTarget, LibraryError, target_file};
use image::ExtendedColorType;
use scopeservo_scope::{Channels, Frame, Samples, StagePose, Timestamp};
use scopeservo_servo::Target;
use scopeservo_slide::Slide;
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// How a target's file ends.
pub(crate) const ENDING: &str = "target";

/// Where those lie that were taken out.
pub(crate) const REMOVED: &str = "removed";

/// How the file with what is said of a target ends.
pub(crate) const LABEL: &str = "label";

/// What is said of a target: nothing that it is found by.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Label {
    /// The slide that it is on.
    pub slide: Option<String>,
    /// What somebody noted.
    pub note: String,
}

/// A target that is to be kept.
#[derive(Debug)]
pub struct NewTarget<'a> {
    /// The name that it gets.
    pub name: &'a str,
    /// The instrument's name.
    pub instrument: &'a str,
    /// Where the stage was.
    pub stage: StagePose,
    /// The target.
    pub target: Target,
    /// Its image for people.
    pub frame: &'a Frame,
    /// What is said of it.
    pub label: &'a Label,
}

impl NewTarget<'_> {
    /// As it is kept, from now on.
    pub(crate) fn kept(self) -> KeptTarget {
        KeptTarget {
            id: String::new(),
            saved: utc(SystemTime::now()),
            instrument: self.instrument.into(),
            stage: self.stage,
            target: self.target,
        }
    }
}

/// Schema 1: JSON, the features and a grey image in it.
#[derive(Deserialize)]
struct First {
    saved: String,
    instrument: String,
    stage: StagePose,
    target: Target,
}

/// The targets of a library.
pub trait Targets {
    /// The names of all targets.
    ///
    /// # Errors
    /// [`LibraryError::Read`].
    fn target_names(&self) -> Result<Vec<String>, LibraryError>;

    /// A saved target.
    ///
    /// # Errors
    /// [`LibraryError::NoTarget`], [`LibraryError::Damaged`], [`LibraryError::Read`], [`LibraryError::BadName`].
    fn target(&self, name: &str) -> Result<KeptTarget, LibraryError>;

    /// Where a saved target's file lies.
    ///
    /// # Errors
    /// [`LibraryError::NoTarget`], [`LibraryError::BadName`].
    fn target_path(&self, name: &str) -> Result<PathBuf, LibraryError>;

    /// The image of a saved target, for people; a target is found again without it.
    fn target_picture(&self, name: &str) -> Option<Frame>;

    /// What is said of a saved target.
    ///
    /// # Errors
    /// [`LibraryError::NoTarget`], [`LibraryError::BadName`], [`LibraryError::Read`], [`LibraryError::Damaged`].
    fn target_label(&self, name: &str) -> Result<Label, LibraryError>;

    /// Says something else of a saved target.
    ///
    /// # Errors
    /// [`LibraryError::NoTarget`], [`LibraryError::BadName`], [`LibraryError::NotKept`].
    fn label_target(&self, name: &str, label: &Label) -> Result<(), LibraryError>;

    /// Whether targets could be kept, before anything is done for one.
    ///
    /// # Errors
    /// [`LibraryError::CannotWrite`].
    fn try_targets(&self) -> Result<(), LibraryError>;

    /// Refuses a name that is taken or is none, and a library that takes no targets, before anything is done for it.
    ///
    /// # Errors
    /// [`LibraryError::BadName`], [`LibraryError::Taken`], [`LibraryError::CannotWrite`].
    fn check_new_target(&self, name: &str) -> Result<(), LibraryError>;

    /// Keeps a target under a new name, with its image for people. Returns where it lies.
    ///
    /// # Errors
    /// [`LibraryError::Taken`], [`LibraryError::BadName`], [`LibraryError::NotKept`].
    fn keep_target(&self, new: NewTarget<'_>) -> Result<PathBuf, LibraryError>;

    /// Gives a target another name. Whenever a program is killed meanwhile it is there under one of the two, or under both.
    ///
    /// # Errors
    /// [`LibraryError::NoTarget`], [`LibraryError::Taken`], [`LibraryError::BadName`], [`LibraryError::Read`], [`LibraryError::NotKept`],
    /// [`LibraryError::InUse`]. A damaged one keeps its name, so that what is left of it is not lost track of.
    fn rename_target(&self, name: &str, to: &str) -> Result<PathBuf, LibraryError>;

    /// Puts a target into the bin, from which it can be taken back. Returns where its file lies.
    ///
    /// # Errors
    /// [`LibraryError::NoTarget`], [`LibraryError::BadName`], [`LibraryError::NotKept`], [`LibraryError::InUse`].
    fn remove_target(&self, name: &str) -> Result<PathBuf, LibraryError>;

    /// Writes a target into a file of its own, which any library can take in; never over another file.
    ///
    /// # Errors
    /// As [`Targets::target`], and [`LibraryError::NotKept`].
    fn export_target(&self, name: &str, to: &Path) -> Result<(), LibraryError>;

    /// Takes in a target that was exported, under a new name. Returns it.
    ///
    /// # Errors
    /// As [`Targets::keep_target`], and [`LibraryError::Damaged`].
    fn import_target(&self, from: &Path, name: &str) -> Result<KeptTarget, LibraryError>;
}

impl Folder {
    pub(crate) fn targets(&self) -> PathBuf {
        self.path().join("targets")
    }

    /// The file that makes a target exist. Its image lies beside it.
    pub(crate) fn target_file(&self, name: &str) -> Result<PathBuf, LibraryError> {
        plain_name(name)?;
        Ok(self.targets().join(format!("{name}.{ENDING}")))
    }

    pub(crate) fn label_file(&self, name: &str) -> PathBuf {
        self.targets().join(format!("{name}.{LABEL}"))
    }

    /// Writes what is said of a target; nothing where nothing is.
    pub(crate) fn put_label(&self, name: &str, label: &Label) -> Result<(), LibraryError> {
        let path = self.label_file(name);
        let written = match label == &Label::default() {
            true if is_there(&path) => fs::remove_file(&path),
            true => Ok(()),
            false => files::replace(&path, &to_json(label)?),
        };
        written.map_err(LibraryError::not_kept(&path))
    }

    /// Writes the image, then the file that makes the target exist.
    fn keep(
        &self,
        name: &str,
        bytes: &[u8],
        frame: Option<&Frame>,
        label: &Label,
    ) -> Result<PathBuf, LibraryError> {
        let path = self.target_file(name)?;
        let picture = self.targets().join(format!("{name}.png"));
        make_folder(&self.targets()).map_err(LibraryError::not_kept(&self.targets()))?;
        // Another program may save one of that name at the same time: the image must be that of whichever comes first.
        let _lock = files::lock(&self.targets());
        if self.existing(name)?.is_some() {
            return Err(taken(name));
        }
        self.put_label(name, label)?;
        // An image alone is what a killed program left. The file that makes the target exist comes last.
        if let Some(frame) = frame {
            files::replace(&picture, &png(frame)?).map_err(LibraryError::not_kept(&picture))?;
        }
        match write_new(&path, bytes) {
            Ok(true) => Ok(path),
            Ok(false) => Err(taken(name)),
            Err(error) => {
                // Of no use alone. It is no obstacle either, should it stay.
                let _ = fs::remove_file(&picture);
                Err(LibraryError::not_kept(&path)(error))
            }
        }
    }

    /// The file of a target, of this version or the one before.
    fn existing(&self, name: &str) -> Result<Option<PathBuf>, LibraryError> {
        let path = self.target_file(name)?;
        let first = self.targets().join(format!("{name}.json"));
        // A link that leads nowhere has the name, and is told as what it is.
        Ok([path, first].into_iter().find(|p| is_there(p)))
    }
}

impl Targets for Folder {
    fn target_names(&self) -> Result<Vec<String>, LibraryError> {
        let one = |p: &PathBuf| is_json(p) || p.extension().is_some_and(|e| e == ENDING);
        let files = entries(&self.targets())?.into_iter().filter(one);
        let name = |p: PathBuf| Some(p.file_stem()?.to_string_lossy().into_owned());
        let mut names: Vec<String> = files.filter_map(name).collect();
        names.sort();
        names.dedup();
        Ok(names)
    }

    fn target(&self, name: &str) -> Result<KeptTarget, LibraryError> {
        read_target(&self.target_path(name)?)
    }

    fn target_path(&self, name: &str) -> Result<PathBuf, LibraryError> {
        match self.existing(name)? {
            Some(path) => Ok(path),
            None => Err(LibraryError::NoTarget {
                name: name.into(),
                known: self.target_names()?,
                more: 0,
            }),
        }
    }

    fn target_picture(&self, name: &str) -> Option<Frame> {
        self.target_file(name).ok()?;
        picture_of(&self.targets().join(format!("{name}.png")))
    }

    fn target_label(&self, name: &str) -> Result<Label, LibraryError> {
        self.target_path(name)?;
        let path = self.label_file(name);
        match is_there(&path) {
            true => read(&path),
            false => Ok(Label::default()),
        }
    }

    fn label_target(&self, name: &str, label: &Label) -> Result<(), LibraryError> {
        self.target_path(name)?;
        let _lock = files::lock(&self.targets());
        self.put_label(name, label)
    }

    fn try_targets(&self) -> Result<(), LibraryError> {
        self.try_folder(&self.targets())
    }

    fn check_new_target(&self, name: &str) -> Result<(), LibraryError> {
        self.target_file(name)?;
        check_name(name)?;
        self.try_targets()?;
        // A target must be found again where a file system is blind to case.
        let mut known = self.target_names()?.into_iter();
        match known.find(|known| known.eq_ignore_ascii_case(name)) {
            Some(known) => Err(taken(&known)),
            None => Ok(()),
        }
    }

    fn keep_target(&self, new: NewTarget<'_>) -> Result<PathBuf, LibraryError> {
        let (name, frame, label) = (new.name, new.frame, new.label);
        let (bytes, _) = target_file::encode(&new.kept(), Some(name))?;
        self.keep(name, &bytes, Some(frame), label)
    }

    fn rename_target(&self, name: &str, to: &str) -> Result<PathBuf, LibraryError> {
        let from = self.target_path(name)?;
        if name.eq_ignore_ascii_case(to) {
            return Err(taken(name));
        }
        self.check_new_target(to)?;
        read_target(&from)?;
        let bytes = fs::read(&from).map_err(LibraryError::read(&from))?;
        let extension = from.extension().unwrap_or_default().to_string_lossy();
        let path = self.targets().join(format!("{to}.{extension}"));
        let pictures = [name, to].map(|n| self.targets().join(format!("{n}.png")));
        let _lock = files::lock(&self.targets());
        // The image first, then the file that makes the target exist; what it was called before goes last.
        self.put_label(to, &self.target_label(name)?)?;
        if let Ok(picture) = fs::read(&pictures[0]) {
            files::replace(&pictures[1], &picture).map_err(LibraryError::not_kept(&pictures[1]))?;
        }
        match write_new(&path, &bytes).map_err(LibraryError::not_kept(&path))? {
            true => {}
            false => return Err(taken(to)),
        }
        fs::remove_file(&from).map_err(LibraryError::not_kept(&from))?;
        let _ = fs::remove_file(&pictures[0]);
        let _ = fs::remove_file(self.label_file(name));
        Ok(path)
    }

    fn remove_target(&self, name: &str) -> Result<PathBuf, LibraryError> {
        let from = self.target_path(name)?;
        let folder = self.targets().join(REMOVED);
        make_folder(&folder).map_err(LibraryError::not_kept(&folder))?;
        let _lock = files::lock(&self.targets());
        let when = utc(SystemTime::now()).replace(':', "-");
        let extension = from.extension().unwrap_or_default().to_string_lossy();
        // Two of one name may go within a second.
        let to = (0..)
            .map(|k| match k {
                0 => format!("{name}_{when}.{extension}"),
                k => format!("{name}_{when}_{k}.{extension}"),
            })
            .map(|file| folder.join(file))
            .find(|to| !is_there(to))
            .unwrap_or_default();
        fs::rename(&from, &to).map_err(LibraryError::not_kept(&to))?;
        let picture = self.targets().join(format!("{name}.png"));
        let _ = fs::rename(&picture, to.with_extension("png"));
        let _ = fs::rename(self.label_file(name), to.with_extension(LABEL));
        Ok(to)
    }

    fn export_target(&self, name: &str, to: &Path) -> Result<(), LibraryError> {
        let (bytes, _) = target_file::encode(&self.target(name)?, Some(name))?;
        keep_new(to, &bytes)
    }

    fn import_target(&self, from: &Path, name: &str) -> Result<KeptTarget, LibraryError> {
        self.check_new_target(name)?;
        let kept = read_target(from)?;
        let (bytes, id) = target_file::encode(&kept, Some(name))?;
        let taken = kept.target.taken.clone();
        let frame = taken.as_deref().map(|t| &*t.frame);
        self.keep(name, &bytes, frame, &Label::default())?;
        Ok(KeptTarget { id, ..kept })
    }
}

/// No target's file is larger, bytes.
const LARGEST_TARGET: u64 = 1 << 30;

/// Whether a file is one of the first version.
pub(crate) fn is_first(path: &Path) -> bool {
    is_json(path)
}

/// The bytes of a target's file.
pub(crate) fn bytes_of(path: &Path) -> Result<Vec<u8>, LibraryError> {
    if !path.exists() && is_there(path) {
        let to = fs::read_link(path).unwrap_or_default();
        return Err(LibraryError::Read {
            path: path.into(),
            what: format!(
                "it is a link to {}, which is not there. Bring that back, or remove the link",
                to.display()
            ),
        });
    }
    scopeservo_files::read(path, LARGEST_TARGET).map_err(LibraryError::read(path))
}

/// What a target's file holds, of this version or the one before.
pub(crate) fn kept_of(path: &Path, bytes: &[u8]) -> Result<KeptTarget, LibraryError> {
    if !is_first(path) {
        return target_file::decode(bytes).map_err(|what| LibraryError::damaged(path, what));
    }
    let First {
        saved,
        instrument,
        stage,
        target,
    } = parse(path, bytes)?;
    let sound = target.features.check();
    sound.map_err(|what| LibraryError::damaged(path, what))?;
    Ok(KeptTarget {
        id: String::new(),
        saved,
        instrument,
        stage,
        target,
    })
}

/// A target's file, of this version or the one before.
fn read_target(path: &Path) -> Result<KeptTarget, LibraryError> {
    kept_of(path, &bytes_of(path)?)
}

/// A picture that was kept for people.
pub(crate) fn picture_of(path: &Path) -> Option<Frame> {
    let slide = Slide::open(path).ok()?;
    let size = slide.levels()[0];
    let picture = slide
        .read_rgb8(0, 0, 0, size.width, size.height, [255; 3])
        .ok()?;
    Some(Frame {
        width: picture.width as usize,
        height: picture.height as usize,
        channels: Channels::Rgb,
        bit_depth: 8,
        samples: Samples::U8(picture.data),
        sequence: 0,
        exposure_start: Timestamp::default(),
        exposure: Duration::ZERO,
    })
}

/// An image for people.
pub(crate) fn png(frame: &Frame) -> Result<Vec<u8>, LibraryError> {
    let size = [frame.width, frame.height];
    to_png(&frame.rgb8(), size, ExtendedColorType::Rgb8)
}

pub(crate) fn taken(name: &str) -> LibraryError {
    LibraryError::Taken { name: name.into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_features::Features;
    use scopeservo_scope::ObjectiveId;

    /// A view without features: enough to be a file.
    fn view() -> (Target, Frame) {
        let target = Target {
            objective: ObjectiveId("40x".into()),
            features: Features::none("sift", 4, 3),
            picture: None,
            periods_px: Vec::new(),
            moved: None,
            mask: None,
            quality: None,
            taken: None,
        };
        let frame = Frame {
            width: 4,
            height: 3,
            channels: Channels::Gray,
            bit_depth: 8,
            samples: Samples::U8(vec![7; 12]),
            sequence: 0,
            exposure_start: Timestamp::default(),
            exposure: Duration::ZERO,
        };
        (target, frame)
    }

    fn keep(folder: &Folder, name: &str) -> Result<PathBuf, LibraryError> {
        let (target, frame) = view();
        folder.keep_target(NewTarget {
            name,
            instrument: "lab",
            stage: StagePose::default(),
            target,
            frame: &frame,
            label: &Label::default(),
        })
    }

    /// Whenever a save is killed, the target is whole or not there, and its name is free as long as it is not there.
    #[test]
    fn a_killed_save_leaves_no_half_target_and_does_not_take_the_name() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::new(dir.path().into());
        let targets = folder.targets();
        fs::create_dir(&targets).unwrap();
        // Killed between the files: the image is there, and the file that makes the target exist is not.
        fs::write(targets.join("spot.png"), "half an image").unwrap();
        assert!(folder.target_names().unwrap().is_empty());
        folder.check_new_target("spot").unwrap();
        let file = keep(&folder, "spot").unwrap();
        assert_eq!(folder.target_names().unwrap(), ["spot"]);
        assert_eq!(folder.target("spot").unwrap().target, view().0);
        let picture = folder.target_picture("spot").unwrap();
        assert_eq!((picture.width, picture.height), (4, 3));
        // Now it is taken, also for the image, and where case does not count.
        let before = fs::read(&file).unwrap();
        for name in ["spot", "SPOT"] {
            assert!(folder.check_new_target(name).is_err(), "{name}");
        }
        assert!(keep(&folder, "spot").is_err());
        assert_eq!(fs::read(&file).unwrap(), before);
    }

    #[test]
    fn a_target_whose_picture_cannot_be_kept_is_not_there() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::new(dir.path().into());
        fs::create_dir_all(folder.targets().join("spot.png")).unwrap();
        let error = keep(&folder, "spot").unwrap_err();
        assert!(matches!(error, LibraryError::NotKept { .. }), "{error}");
        assert!(folder.target_names().unwrap().is_empty());
    }

    #[test]
    fn a_target_gets_another_name_and_is_there_under_one_of_the_two() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::new(dir.path().into());
        for name in ["spot", "other"] {
            keep(&folder, name).unwrap();
        }
        let before = folder.target("spot").unwrap();
        folder.rename_target("spot", "mitosis-3").unwrap();
        assert_eq!(folder.target_names().unwrap(), ["mitosis-3", "other"]);
        assert_eq!(folder.target("mitosis-3").unwrap(), before);
        assert!(folder.target_picture("mitosis-3").is_some());
        assert!(folder.target_picture("spot").is_none());
        for (from, to, word) in [
            ("spot", "new", "there is no target 'spot'"),
            ("mitosis-3", "other", "already"),
            ("mitosis-3", "OTHER", "already"),
            ("mitosis-3", "Mitosis-3", "already"),
            ("mitosis-3", "CON", "device"),
            ("mitosis-3", "-rf", "option"),
            ("mitosis-3", "../x", "is no name"),
        ] {
            let said = folder.rename_target(from, to).unwrap_err().to_string();
            assert!(said.contains(word), "{from} {to}: {said}");
        }
        // What is damaged keeps its name.
        let file = folder.target_path("other").unwrap();
        fs::write(&file, "half a file").unwrap();
        assert!(folder.rename_target("other", "new").is_err());
        assert_eq!(folder.target_names().unwrap(), ["mitosis-3", "other"]);
    }

    #[test]
    fn what_was_removed_can_be_taken_in_again() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::new(dir.path().into());
        let mut removed = Vec::new();
        for _ in 0..3 {
            keep(&folder, "spot").unwrap();
            removed.push(folder.remove_target("spot").unwrap());
            assert!(folder.target_names().unwrap().is_empty());
            assert!(folder.target_picture("spot").is_none());
        }
        assert!(folder.remove_target("spot").is_err());
        let kept: std::collections::BTreeSet<_> = removed.iter().collect();
        assert_eq!(kept.len(), 3, "none was lost: {removed:?}");
        folder.import_target(&removed[0], "spot").unwrap();
        assert_eq!(folder.target("spot").unwrap().target, view().0);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_that_leads_nowhere_is_told_and_has_the_name() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::new(dir.path().into());
        keep(&folder, "sound").unwrap();
        for (link, to) in [
            ("dang.target", "gone"),
            ("old.json", "gone.json"),
            ("self.target", "self.target"),
        ] {
            std::os::unix::fs::symlink(to, folder.targets().join(link)).unwrap();
        }
        for name in ["dang", "old"] {
            let said = folder.target(name).unwrap_err().to_string();
            assert!(
                said.contains("it is a link to gone") && said.contains("remove the link"),
                "{said}"
            );
            assert!(folder.check_new_target(name).is_err());
        }
        assert!(
            folder
                .target("self")
                .unwrap_err()
                .to_string()
                .contains("it is a link to self.target")
        );
        assert_eq!(
            folder.target_names().unwrap(),
            ["dang", "old", "self", "sound"]
        );
        folder.target("sound").unwrap();
    }

    #[test]
    fn names_of_targets_stay_in_their_folder() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::new(dir.path().join("data"));
        for bad in [
            "",
            ".",
            "..",
            "../x",
            "a/b",
            "a\\b",
            "ä",
            "e\u{301}",
            "a b",
            "a ",
            " a",
            ".hidden",
            "C:x",
            "a\u{7}",
            "\u{1f52c}",
            "a\n",
            "a\0b",
        ] {
            assert!(folder.check_new_target(bad).is_err(), "{bad}");
            assert!(folder.target(bad).is_err(), "{bad}");
        }
        assert!(folder.check_new_target("mitosis-3.b_2").is_ok());
        let none = folder.target("mitosis-3").unwrap_err().to_string();
        assert!(none.contains("none is saved"), "{none}");
    }
}
