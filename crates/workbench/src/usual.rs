//! What the description says of every job, wherever it is asked for: here alone it becomes their options. What somebody asks for goes before it.

use scopeservo_scope::ObjectiveId;
use scopeservo_servo::{
    CalibrateOptions, Calibration, FocusOptions, GridOptions, LevelOptions, RepositionOptions,
    ServoOptions, VisionOptions,
};
use scopeservo_setup::Config;
use scopeservo_station::jobs::{
    CalibrateInput, CheckInput, FocusInput, GridInput, LevelInput, SaveTargetInput,
};

/// What a description says of jobs.
#[derive(Debug, Clone, Copy)]
pub struct Usual<'a> {
    config: &'a Config,
}

/// How one asks for the focus: `None` where the view is in focus.
type Focus = Option<FocusOptions>;

impl<'a> Usual<'a> {
    /// Of a description.
    pub fn of(config: &'a Config) -> Self {
        Self { config }
    }

    /// How the focus is looked for.
    pub fn focusing(&self, asked: FocusOptions) -> FocusOptions {
        FocusOptions {
            sweep: asked.sweep || self.config.focus.sweep,
            ..asked
        }
    }

    /// What is asked of an arrival.
    pub fn arriving(&self, asked: ServoOptions) -> ServoOptions {
        let arrival = &self.config.arrival;
        ServoOptions {
            within_um: asked.within_um.or(arrival.within_um),
            within_deg: asked.within_deg.or(arrival.within_deg),
            ..asked
        }
    }

    /// A focus; `near_z_um` is where one goes first.
    pub fn focus(
        &self,
        objective: Option<ObjectiveId>,
        near_z_um: Option<f64>,
        focus: FocusOptions,
    ) -> FocusInput {
        FocusInput {
            objective,
            near_z_um,
            focus: self.focusing(focus),
            vision: VisionOptions::default(),
        }
    }

    /// A calibration of these objectives, of all where none is named. `switching`: how often each then comes in turn with the lowest one.
    pub fn calibrate(
        &self,
        objectives: Vec<ObjectiveId>,
        focus: Focus,
        calibrate: CalibrateOptions,
        switching: usize,
    ) -> CalibrateInput {
        CalibrateInput {
            objectives,
            focus: focus.map(|focus| self.focusing(focus)),
            calibrate,
            switching,
            vision: VisionOptions::default(),
        }
    }

    /// A check of these calibrations.
    pub fn check(&self, calibrations: Vec<Calibration>, focus: Focus) -> CheckInput {
        CheckInput {
            calibrations,
            focus: focus.map(|focus| self.focusing(focus)),
            vision: VisionOptions::default(),
        }
    }

    /// A look at a grid.
    pub fn grid(
        &self,
        objective: Option<ObjectiveId>,
        focus: Focus,
        grid: GridOptions,
        calibrations: Vec<Calibration>,
    ) -> GridInput {
        GridInput {
            objective,
            focus: focus.map(|focus| self.focusing(focus)),
            grid,
            calibrations,
            vision: VisionOptions::default(),
        }
    }

    /// A look at how the specimen is tilted. It focuses by what `level` says of it; not first, where the view `is_in_focus`.
    pub fn level(
        &self,
        objective: Option<ObjectiveId>,
        is_in_focus: bool,
        level: LevelOptions,
        calibrations: Vec<Calibration>,
    ) -> LevelInput {
        let focus = self.focusing(level.focus);
        LevelInput {
            objective,
            focus: (!is_in_focus).then(|| focus.clone()),
            level: LevelOptions { focus, ..level },
            calibrations,
            vision: VisionOptions::default(),
        }
    }

    /// Saving a view: with `first` it is focused before. `still`: nothing may move for it.
    pub fn save(
        &self,
        objective: Option<ObjectiveId>,
        (focus, first): (FocusOptions, bool),
        still: bool,
        known: Vec<Calibration>,
    ) -> SaveTargetInput {
        let focusing = self.focusing(focus);
        SaveTargetInput {
            objective,
            focus: first.then(|| focusing.clone()),
            focusing,
            still: still || self.config.target.still,
            known,
            vision: VisionOptions::default(),
        }
    }

    /// How one goes back.
    pub fn reposition(&self, servo: ServoOptions, focus: FocusOptions) -> RepositionOptions {
        RepositionOptions {
            servo: self.arriving(servo),
            focus: self.focusing(focus),
            ..RepositionOptions::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};
    use std::path::Path;

    fn described(more: &str) -> Config {
        let text = format!(
            "name = \"lab\"\n[drivers.twin.twin]\nseed = 3\n[devices]\nstage = \"twin\"\ncamera = \"twin\"\nnosepiece = \"twin\"\n{more}"
        );
        Config::parse(&text, Path::new("scopeservo.toml")).unwrap()
    }

    /// All values of that key, wherever they are.
    fn all<'v>(value: &'v Value, key: &str, found: &mut Vec<&'v Value>) {
        match value {
            Value::Object(object) => {
                for (name, value) in object {
                    if name == key {
                        found.push(value);
                    }
                    all(value, key, found);
                }
            }
            Value::Array(values) => values.iter().for_each(|v| all(v, key, found)),
            _ => {}
        }
    }

    fn inputs(usual: Usual<'_>) -> Vec<(&'static str, Value)> {
        let focus = FocusOptions::default;
        let level = LevelOptions::default();
        let (servo, calibrate) = (ServoOptions::default(), CalibrateOptions::default());
        vec![
            ("focus", json!(usual.focus(None, None, focus()))),
            (
                "calibrate",
                json!(usual.calibrate(vec![], Some(focus()), calibrate, 0)),
            ),
            ("check", json!(usual.check(vec![], Some(focus())))),
            (
                "grid",
                json!(usual.grid(None, Some(focus()), GridOptions::default(), vec![])),
            ),
            ("level", json!(usual.level(None, false, level, vec![]))),
            (
                "save",
                json!(usual.save(None, (focus(), true), false, vec![])),
            ),
            ("reposition", json!(usual.reposition(servo, focus()))),
        ]
    }

    #[test]
    fn what_the_description_says_reaches_every_job_and_what_is_asked_goes_before_it() {
        let config = described(
            "[focus]\nsweep = true\n[arrival]\nwithin_um = 1.5\nwithin_deg = 0.25\n[target]\nstill = true\n",
        );
        for (description, expected) in [(&config, true), (&described(""), false)] {
            for (job, input) in inputs(Usual::of(description)) {
                let mut sweeps = Vec::new();
                all(&input, "sweep", &mut sweeps);
                assert!(!sweeps.is_empty(), "{job} focuses: {input}");
                assert!(sweeps.iter().all(|s| **s == expected), "{job}: {input}");
            }
        }
        let usual = Usual::of(&config);
        let save = usual.save(None, (FocusOptions::default(), false), false, vec![]);
        assert!(save.still && save.focus.is_none());
        let asked = ServoOptions {
            within_um: Some(4.0),
            ..ServoOptions::default()
        };
        let back = usual.reposition(asked, FocusOptions::default());
        assert_eq!(back.servo.within_um, Some(4.0));
        assert_eq!(back.servo.within_deg, Some(0.25));
        // What is asked of one focus alone.
        let (plain, narrow) = (
            described(""),
            FocusOptions {
                sweep: true,
                half_range_um: 7.0,
                ..FocusOptions::default()
            },
        );
        let focus = Usual::of(&plain).focusing(narrow);
        assert!(focus.sweep && focus.half_range_um == 7.0);
        assert_eq!(usual.check(vec![], None).focus, None);
    }
}
