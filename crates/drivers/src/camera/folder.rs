//! A folder into which another program puts images, or a folder of images to go through.

use crate::camera::exposing::Exposing;
use crate::camera::picture::{self, Picture};
use crate::camera::{bad_setting, check_latency, device, duration, frame, info};
use crate::session::lock;
use scopeservo_scope::{Camera, CameraInfo, Clock, Frame, ScopeError};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime};

/// Which image of a folder is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FolderOrder {
    /// The one that another program puts there after it was asked for: a camera that only its maker's program can drive.
    Newest,
    /// One after the other by name, and an error after the last: for trying things without a microscope.
    InTurn,
}

/// A folder of images.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FolderSettings {
    /// Where they are: JPEG, PNG and TIFF files, all of one size.
    pub path: PathBuf,
    /// Which is taken.
    pub order: FolderOrder,
    /// For `newest`, which needs it: the longest time from the start of an exposure until the file is there, whole.
    pub latency_ms: Option<f64>,
    /// How long after that an image is waited for.
    #[serde(default = "ten_seconds")]
    pub timeout_ms: f64,
    /// How long the images are exposed, as the other program is set.
    pub exposure_ms: f64,
}

fn ten_seconds() -> f64 {
    10_000.0
}

/// How often the folder is looked into.
const LOOK: Duration = Duration::from_millis(20);
/// No larger file is read.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// A camera that is a folder.
pub struct FolderCamera {
    path: PathBuf,
    order: FolderOrder,
    latency: Duration,
    timeout: Duration,
    exposing: Exposing,
    info: CameraInfo,
    clock: Arc<dyn Clock>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// How many frames there were.
    count: u64,
    /// The name of the last image, in turn.
    last: Option<PathBuf>,
}

/// A file as far as it can be told apart from another of its name.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Version {
    bytes: u64,
    changed: Option<SystemTime>,
}

impl FolderCamera {
    /// Looks into the folder. What an image is like is read off one that is there, or off the first that comes.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`]; [`ScopeError::Device`] for a folder or an image that cannot be read, and when none comes.
    pub fn open(
        settings: &FolderSettings,
        path: PathBuf,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, ScopeError> {
        let exposure = duration("exposure_ms", settings.exposure_ms)?;
        if exposure.is_zero() {
            return Err(bad_setting("exposure_ms must be above 0"));
        }
        let timeout = duration("timeout_ms", settings.timeout_ms)?;
        let latency = match (settings.order, settings.latency_ms) {
            (FolderOrder::Newest, Some(ms)) => duration("latency_ms", ms)?,
            (FolderOrder::InTurn, None) => exposure,
            (FolderOrder::Newest, None) => {
                return Err(bad_setting(
                    "order = \"newest\" needs latency_ms: the longest time from the start of an exposure until the file is there",
                ));
            }
            (FolderOrder::InTurn, Some(_)) => {
                return Err(bad_setting("latency_ms belongs to order = \"newest\""));
            }
        };
        check_latency("latency_ms", latency, exposure)?;
        let there = files(&path)?;
        let first = match settings.order {
            FolderOrder::InTurn => match there.keys().next() {
                Some(file) => read(file)?,
                None => {
                    return Err(bad_setting(format!(
                        "there is no JPEG, PNG or TIFF file in {}",
                        path.display()
                    )));
                }
            },
            FolderOrder::Newest => {
                let mut there: Vec<_> = there.into_iter().collect();
                there.sort_by_key(|(_, version)| std::cmp::Reverse(version.changed));
                // Of those that lie there, the newest that is whole: the last one may still be written.
                match there.iter().find_map(|(file, _)| read(file).ok()) {
                    Some(picture) => picture,
                    None => wait_for_new(&path, Duration::ZERO, timeout)?,
                }
            }
        };
        let exposing = Exposing::fixed(exposure);
        Ok(Self {
            info: info(
                format!("images in {}", path.display()),
                &first,
                exposing.range(),
            ),
            path,
            order: settings.order,
            latency,
            timeout,
            exposing,
            clock,
            state: Mutex::default(),
        })
    }

    fn in_turn(&self, state: &mut State) -> Result<Picture, ScopeError> {
        let all = files(&self.path)?;
        let next = all
            .into_keys()
            .find(|file| state.last.as_ref().is_none_or(|last| file > last))
            .ok_or_else(|| {
                device(format!(
                    "all {} images of {} have been seen",
                    state.count,
                    self.path.display()
                ))
            })?;
        let picture = read(&next)?;
        state.last = Some(next);
        Ok(picture)
    }
}

/// The images in a folder by name.
fn files(path: &Path) -> Result<BTreeMap<PathBuf, Version>, ScopeError> {
    let unreadable = |e: std::io::Error| device(format!("{}: {e}", path.display()));
    let mut all = BTreeMap::new();
    for entry in fs::read_dir(path).map_err(unreadable)? {
        let file = entry.map_err(unreadable)?.path();
        let kind = file.extension().and_then(|e| e.to_str());
        let kind = kind.map(str::to_ascii_lowercase).unwrap_or_default();
        if !["jpg", "jpeg", "png", "tif", "tiff"].contains(&kind.as_str()) {
            continue;
        }
        // One that was taken away meanwhile is not there.
        if let Ok(meta) = fs::metadata(&file)
            && meta.is_file()
        {
            let version = Version {
                bytes: meta.len(),
                changed: meta.modified().ok(),
            };
            all.insert(file, version);
        }
    }
    Ok(all)
}

fn read(file: &Path) -> Result<Picture, ScopeError> {
    let bad = |what: &dyn std::fmt::Display| device(format!("{}: {what}", file.display()));
    let bytes = scopeservo_files::read(file, MAX_FILE_BYTES).map_err(|e| bad(&e))?;
    picture::decode(&bytes).map_err(|e| bad(&e))
}

/// Waits until `after` has passed and then for an image that was not there before, whole.
fn wait_for_new(path: &Path, after: Duration, timeout: Duration) -> Result<Picture, ScopeError> {
    let asked = Instant::now();
    std::thread::sleep(after);
    let mut before = files(path)?;
    let mut growing: Option<(PathBuf, Version)> = None;
    let mut fault = None;
    loop {
        std::thread::sleep(LOOK);
        let now = files(path)?;
        let new = now
            .iter()
            .filter(|(file, version)| before.get(*file) != Some(version))
            .max_by_key(|(_, version)| version.changed);
        match new {
            // It has stopped growing.
            Some((file, version)) if growing.as_ref() == Some(&(file.clone(), version.clone())) => {
                match read(file) {
                    Ok(picture) => return Ok(picture),
                    // Perhaps its writer only paused; it counts again when it grows.
                    Err(error) => {
                        fault = Some(error);
                        before.insert(file.clone(), version.clone());
                        growing = None;
                    }
                }
            }
            Some((file, version)) => growing = Some((file.clone(), version.clone())),
            None => growing = None,
        }
        if asked.elapsed() > after + timeout {
            return Err(fault.unwrap_or_else(|| {
                device(format!(
                    "no new image came into {} within {:.1} s: let the other program save there, again and again",
                    path.display(),
                    (after + timeout).as_secs_f64()
                ))
            }));
        }
    }
}

impl Camera for FolderCamera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    fn exposure(&self) -> Result<Duration, ScopeError> {
        Ok(self.exposing.get())
    }

    fn set_exposure(&self, exposure: Duration) -> Result<Duration, ScopeError> {
        self.exposing.set(&self.info, exposure)
    }

    fn grab(&self) -> Result<Frame, ScopeError> {
        let asked = self.clock.now();
        let mut state = lock(&self.state);
        let picture = match self.order {
            FolderOrder::InTurn => self.in_turn(&mut state)?,
            FolderOrder::Newest => wait_for_new(&self.path, self.latency, self.timeout)?,
        };
        let sequence = state.count;
        state.count += 1;
        frame(&self.info, picture, sequence, asked, self.exposing.get())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::picture::tests::jpeg;
    use scopeservo_scope::SystemClock;
    use std::io::Write;

    fn settings(order: FolderOrder) -> FolderSettings {
        FolderSettings {
            path: PathBuf::new(),
            order,
            latency_ms: (order == FolderOrder::Newest).then_some(50.0),
            timeout_ms: 400.0,
            exposure_ms: 10.0,
        }
    }

    fn camera(order: FolderOrder, path: &Path) -> Result<FolderCamera, ScopeError> {
        FolderCamera::open(&settings(order), path.into(), Arc::new(SystemClock::new()))
    }

    /// The first red sample of a grab.
    fn red(camera: &FolderCamera) -> Result<u8, ScopeError> {
        Ok(camera.grab()?.rgb8()[0])
    }

    #[test]
    fn pictures_in_turn_come_by_name_and_end() {
        let folder = tempfile::tempdir().unwrap();
        for (name, shade) in [("b.jpg", 200), ("a.jpeg", 20), ("notes.txt", 0)] {
            fs::write(folder.path().join(name), jpeg(16, 8, shade)).unwrap();
        }
        let camera = camera(FolderOrder::InTurn, folder.path()).unwrap();
        assert_eq!((camera.info().width, camera.info().height), (16, 8));
        assert!(red(&camera).unwrap().abs_diff(20) < 10);
        assert!(red(&camera).unwrap().abs_diff(200) < 10);
        let end = camera.grab().unwrap_err().to_string();
        assert!(end.contains("all 2 images"), "{end}");
        fs::write(folder.path().join("c.jpg"), jpeg(8, 8, 9)).unwrap();
        let size = camera.grab().unwrap_err().to_string();
        assert!(size.contains("now are 8 x 8"), "{size}");
    }

    #[test]
    fn the_newest_is_one_that_came_whole_and_after_the_latency() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("old.jpg"), jpeg(64, 64, 10)).unwrap();
        let camera = camera(FolderOrder::Newest, folder.path()).unwrap();
        std::thread::scope(|s| {
            let grab = s.spawn(|| red(&camera));
            // Exposed before the question, perhaps: within the latency.
            std::thread::sleep(Duration::from_millis(20));
            fs::write(at("stale.jpg"), jpeg(64, 64, 60)).unwrap();
            std::thread::sleep(Duration::from_millis(80));
            // Written in two goes.
            let bytes = jpeg(64, 64, 200);
            let mut file = fs::File::create(at("new.jpg")).unwrap();
            file.write_all(&bytes[..bytes.len() / 2]).unwrap();
            file.flush().unwrap();
            std::thread::sleep(Duration::from_millis(70));
            file.write_all(&bytes[bytes.len() / 2..]).unwrap();
            drop(file);
            let seen = grab.join().unwrap().unwrap();
            assert!(seen.abs_diff(200) < 10, "{seen}");
        });
        // The same name again, as programs do that write one file over and over.
        std::thread::scope(|s| {
            let grab = s.spawn(|| red(&camera));
            std::thread::sleep(Duration::from_millis(100));
            fs::write(at("new.jpg"), jpeg(64, 64, 120)).unwrap();
            let seen = grab.join().unwrap().unwrap();
            assert!(seen.abs_diff(120) < 10, "{seen}");
        });
        let started = Instant::now();
        let silence = camera.grab();
        let silence = silence.unwrap_err().to_string();
        assert!(silence.contains("no new image came into"), "{silence}");
        assert!(started.elapsed() < Duration::from_secs(1));
    }

    #[test]
    fn folders_without_pictures_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let said = |answer: Result<FolderCamera, ScopeError>| answer.err().unwrap().to_string();
        let empty = said(camera(FolderOrder::InTurn, folder.path()));
        assert!(empty.contains("no JPEG, PNG or TIFF"), "{empty}");
        let silent = said(camera(FolderOrder::Newest, folder.path()));
        assert!(silent.contains("no new image came into"), "{silent}");
        let none = said(camera(FolderOrder::Newest, &folder.path().join("none")));
        assert!(none.contains("none: "), "{none}");
        let mut without = settings(FolderOrder::Newest);
        without.latency_ms = None;
        let clock = Arc::new(SystemClock::new());
        let untold = said(FolderCamera::open(
            &without,
            folder.path().into(),
            clock.clone(),
        ));
        assert!(untold.contains("needs latency_ms"), "{untold}");
        without.latency_ms = Some(5.0);
        let short = said(FolderCamera::open(&without, folder.path().into(), clock));
        assert!(short.contains("shorter than the exposure"), "{short}");
        fs::write(folder.path().join("a.png"), b"text").unwrap();
        let damaged = said(camera(FolderOrder::InTurn, folder.path()));
        assert!(damaged.contains("a.png"), "{damaged}");
    }
}
