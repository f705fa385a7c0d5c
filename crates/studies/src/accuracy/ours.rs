//! What we find in the pairs, in each setting.

use super::degrade::Condition;
use super::rows::Row;
use super::scenes::{PairId, Scene};
use scopeservo_features::{Engine, Features};
use scopeservo_registration::{NotFound, Options, Prior, register};
use scopeservo_sift::{GrayImage, Sift, SiftError};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::time::Instant;

/// Detector settings that differ between rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Look {
    /// As in the detector's options.
    pub max_features: usize,
    /// As in the detector's options.
    pub first_octave: i32,
}

/// How many features are used of those that were found, the strongest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Keep {
    /// All of them.
    All,
    /// So many at most, as OpenCV's `nfeatures` counts.
    AtMost(usize),
    /// As many as OpenCV's precise SIFT found in the same frame, at most.
    AsPeer,
}

/// One way to use our program.
pub struct Setting {
    /// Its name in results and tables.
    pub name: &'static str,
    /// What it does, in words.
    pub says: &'static str,
    /// For the view.
    pub view: Look,
    /// For the target, by zoom.
    pub target: fn(usize) -> Look,
    /// How many features of either are used.
    pub keep: Keep,
    /// Whether the ratio of scales is known, to 3 %.
    pub scale_known: bool,
}

const fn look(max_features: usize, first_octave: i32) -> Look {
    Look {
        max_features,
        first_octave,
    }
}

/// The octave of the target that shows what octave 0 of the view does.
fn octave_of(zoom: usize) -> i32 {
    zoom.ilog2() as i32
}

/// Each of them, in the order of the tables.
pub const SETTINGS: [Setting; 10] = [
    Setting {
        name: "equal",
        says: "nothing known; per frame no more features than OpenCV's precise SIFT found in it",
        view: look(2000, -1),
        target: |_| look(2000, -1),
        keep: Keep::AsPeer,
        scale_known: false,
    },
    Setting {
        name: "2000",
        says: "nothing known, 2000 features",
        view: look(2000, -1),
        target: |_| look(2000, -1),
        keep: Keep::AtMost(2000),
        scale_known: false,
    },
    Setting {
        name: "2000_scale",
        says: "2000 features, the scale known to 3 %",
        view: look(2000, -1),
        target: |_| look(2000, -1),
        keep: Keep::AtMost(2000),
        scale_known: true,
    },
    Setting {
        name: "undoubled",
        says: "nothing known, no doubled octave",
        view: look(2000, 0),
        target: |_| look(2000, 0),
        keep: Keep::AtMost(2000),
        scale_known: false,
    },
    Setting {
        name: "undoubled_scale",
        says: "no doubled octave, the scale known",
        view: look(2000, 0),
        target: |_| look(2000, 0),
        keep: Keep::AtMost(2000),
        scale_known: true,
    },
    Setting {
        name: "skip_scale",
        says: "the scale known; the target without the octaves that the view cannot show",
        view: look(2000, -1),
        target: |zoom| look(2000, octave_of(zoom) - 1),
        keep: Keep::AtMost(2000),
        scale_known: true,
    },
    Setting {
        name: "undoubled_skip_scale",
        says: "the same without the doubled octave of the view",
        view: look(2000, 0),
        target: |zoom| look(2000, octave_of(zoom)),
        keep: Keep::AtMost(2000),
        scale_known: true,
    },
    Setting {
        name: "program",
        says: "as `register --features 4000` does it: nothing known",
        view: look(4000, -1),
        target: |_| look(4000, -1),
        keep: Keep::All,
        scale_known: false,
    },
    Setting {
        name: "servo",
        says: "as the servo does it: the scale known, 3000 features in the view, 8000 in the target",
        view: look(3000, -1),
        target: |_| look(8000, -1),
        keep: Keep::All,
        scale_known: true,
    },
    Setting {
        name: "servo_skip",
        says: "as the servo does it, the target without the octaves that the view cannot show",
        view: look(3000, -1),
        target: |zoom| look(8000, octave_of(zoom) - 1),
        keep: Keep::All,
        scale_known: true,
    },
];

impl Setting {
    /// The setting of that name.
    pub fn of(name: &str) -> Option<&'static Self> {
        SETTINGS.iter().find(|s| s.name == name)
    }
}

/// Engines for each look, kept from image to image.
#[derive(Default)]
struct Engines(BTreeMap<Look, Sift>);

impl Engines {
    /// Features of an image, looked up in `seen` or found and put there.
    fn features<'a>(
        &mut self,
        seen: &'a mut BTreeMap<Look, Timed>,
        image: &GrayImage,
        look: Look,
    ) -> Result<&'a Timed, SiftError> {
        let slot = match seen.entry(look) {
            Entry::Occupied(there) => return Ok(there.into_mut()),
            Entry::Vacant(slot) => slot,
        };
        let engine = match self.0.entry(look) {
            Entry::Occupied(there) => there.into_mut(),
            Entry::Vacant(slot) => slot.insert(Sift::new(scopeservo_sift::Options {
                max_features: look.max_features,
                first_octave: look.first_octave,
                ..Default::default()
            })?),
        };
        let start = Instant::now();
        let features = Features::from(&engine.detect_and_describe(image));
        let ms = ms_since(start);
        Ok(slot.insert(Timed { features, ms }))
    }
}

struct Timed {
    features: Features,
    ms: f64,
}

fn ms_since(start: Instant) -> f64 {
    (start.elapsed().as_secs_f64() * 1e5).round() / 1e2
}

/// Runs settings on scenes.
#[derive(Default)]
pub struct Runner {
    engines: Engines,
    /// Matches the features of all of them.
    engine: Engine,
}

impl Runner {
    /// A row for each pair of the scene and each setting that is `wanted`. `peer` gives the numbers of features that OpenCV
    /// found in view and target, where known: a setting that needs them is left out elsewhere.
    ///
    /// # Errors
    /// Those of the detector's options.
    pub fn rows(
        &mut self,
        scene: &Scene,
        wanted: impl Fn(PairId, &Setting) -> bool,
        peer: impl Fn(PairId) -> Option<[usize; 2]>,
    ) -> Result<Vec<Row>, SiftError> {
        let engines = &mut self.engines;
        let mut rows = Vec::new();
        let mut targets: BTreeMap<Look, Timed> = BTreeMap::new();
        for condition in Condition::EACH {
            let id = PairId {
                scene: scene.id,
                condition,
            };
            let tasks: Vec<(&Setting, [usize; 2])> = SETTINGS
                .iter()
                .filter(|s| wanted(id, s))
                .filter_map(|s| {
                    let keep = match s.keep {
                        Keep::All => [usize::MAX; 2],
                        Keep::AtMost(n) => [n; 2],
                        Keep::AsPeer => peer(id)?,
                    };
                    Some((s, keep))
                })
                .collect();
            if tasks.is_empty() {
                continue;
            }
            let (_, frame) = scene.view(condition);
            let pair = scene.pair(&frame);
            let frames = scene.checksum(&frame);
            let mut views: BTreeMap<Look, Timed> = BTreeMap::new();
            for (setting, keep) in tasks {
                let (of_view, of_target) = (setting.view, (setting.target)(scene.id.zoom));
                let seen = engines.features(&mut views, &pair.view, of_view)?;
                let (view, features_ms) = (first(&seen.features, keep[0]), seen.ms);
                let seen = engines.features(&mut targets, &pair.target, of_target)?;
                let target = first(&seen.features, keep[1]);
                let prior = match setting.scale_known {
                    true => pair.prior(),
                    false => Prior::default(),
                };
                let start = Instant::now();
                let answer = register(&*self.engine, &view, &target, &prior, &Options::default());
                let register_ms = ms_since(start);
                let found = answer.found();
                rows.push(Row {
                    set: scene.set.clone(),
                    pair: id.to_string(),
                    method: setting.name.into(),
                    engine: String::new(),
                    frames: frames.clone(),
                    found: found.is_some(),
                    error_px: found.map(|f| pair.corner_error(&f.target_from_view)),
                    inliers: answer.inliers,
                    matches: answer.matches,
                    features: [view.len(), target.len()],
                    features_ms,
                    register_ms,
                    reason: answer.outcome.as_ref().err().map(code),
                    claimed_px: found.map(|f| f.corner_sigma_px),
                });
            }
        }
        Ok(rows)
    }
}

fn first(features: &Features, at_most: usize) -> Features {
    features.subset(&(0..features.len().min(at_most)).collect::<Vec<_>>())
}

fn code(reason: &NotFound) -> String {
    let json = serde_json::to_value(reason).expect("a reason is plain data");
    json["code"].as_str().unwrap_or_default().into()
}
