//! The rules of the motion gate one by one: what each refuses, what it says, and which rules make no sense.

mod recorder;

use recorder::{
    Devices, Fault, LIMIT, NARROW, NARROW_X, RETRACTED, TRAVEL, Ticking, id, pose, rules, z,
};
use scopeservo_scope::{
    Axis, CancelToken, ChangeRule, ErrorKind, Immersion, ImmersionChange, Instrument, KnownBy,
    LargestStep, Limits, Motion, MotionGate, Nosepiece, Objective, ObjectiveId, Rules, ScopeError,
    StagePose, VirtualClock, Workspace,
};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};

#[test]
fn a_place_within_the_slack_is_inside_for_the_objective_that_comes_and_goals_are_judged_to_the_last_bit()
 {
    let devices = Devices::new();
    let gate = devices.gate(rules());
    let settle = || (0..8).for_each(|_| devices.world().tick());
    // 10x may go there; 40x only to 3 mm, and the stage repeats to less than a micrometre.
    let beside = NARROW_X + 0.9e-6;
    gate.start_move(&pose([beside, 0.0, RETRACTED])).unwrap();
    settle();
    gate.start_change(&id("40x")).unwrap();
    settle();
    for by in [0.95e-6, 0.8e-6, 1e-9] {
        let beyond = gate.start_move(&pose([NARROW_X + by, 0.0, RETRACTED]));
        assert!(
            matches!(beyond, Err(ScopeError::OutsideLimits { axis: Axis::X, .. })),
            "{beyond:?}"
        );
    }
    gate.start_move(&pose([NARROW_X, 0.0, RETRACTED])).unwrap();
    settle();
    let broken = devices.world().broken.clone();
    assert!(broken.is_empty(), "{broken:?}");
}

#[test]
fn each_refusal_says_which_rule_and_what_to_do() {
    let devices = Devices::new();
    let gate = devices.gate(rules());
    let settle = || (0..8).for_each(|_| devices.world().tick());
    let go = |at: [f64; 3]| {
        gate.start_move(&pose(at)).unwrap();
        settle();
    };
    let said = |to: [f64; 3]| gate.start_move(&pose(to)).unwrap_err();
    let far = said([9e-3, 0.0, 0.0]);
    assert!(
        matches!(far, ScopeError::OutsideLimits { axis: Axis::X, .. }),
        "{far}"
    );
    let long = said([7e-3, 0.0, -5e-3]);
    assert!(
        matches!(long, ScopeError::StepTooLarge { axis: Axis::X, .. }),
        "{long}"
    );
    assert_eq!(
        said([f64::NAN, 0.0, 0.0]).to_string(),
        ScopeError::NotFinite { axis: Axis::X }.to_string()
    );
    let turn = StagePose::default().with_si(Axis::Rz, 0.0);
    let missing = gate.start_move(&turn);
    assert_eq!(missing, Err(ScopeError::NoSuchAxis { axis: Axis::Rz }));

    go([0.0, 5e-3, -4e-3]);
    let close = said([5e-3, 5e-3, -2e-3]);
    assert!(
        matches!(&close, ScopeError::TooClose { zone, .. } if zone == "the clamp"),
        "{close}"
    );
    // Across the clamp and down behind it: the axes do not go in step, so the way counts.
    go([3e-3, 5e-3, -4e-3]);
    let across = said([7e-3, 5e-3, 0.0]);
    assert!(matches!(across, ScopeError::TooClose { .. }), "{across}");
    go([7e-3, 5e-3, -4e-3]);

    let low = gate.start_change(&id("40x")).unwrap_err();
    assert!(low.to_string().contains("Retract first"), "{low}");
    go([7e-3, 5e-3, RETRACTED]);
    // The objective that comes may not be where this one may.
    let there = gate.start_change(&id("40x")).unwrap_err();
    assert!(
        matches!(there, ScopeError::OutsideLimits { axis: Axis::X, .. }),
        "{there}"
    );
    go([2e-3, 5e-3, RETRACTED]);
    let unknown = gate.start_change(&id("100x")).unwrap_err();
    assert!(unknown.to_string().contains("10x, 40x"), "{unknown}");
    gate.start_change(&id("40x")).unwrap();
    let device = "nosepiece";
    assert_eq!(said([2e-3, 5e-3, RETRACTED]), ScopeError::Busy { device });
    settle();
    go([2e-3, 5e-3, 0.5e-3]);
    let narrow = said([2e-3, 5e-3, 3e-3]);
    assert!(
        matches!(narrow, ScopeError::OutsideLimits { axis: Axis::Z, .. }),
        "{narrow}"
    );
    // A retreat may be longer than a step, and nothing else.
    gate.start_move(&z(-LIMIT)).unwrap();
    let device = "stage";
    assert_eq!(said([2e-3, 5e-3, 0.0]), ScopeError::Busy { device });
    assert!(
        devices.world().broken.is_empty(),
        "{:?}",
        devices.world().broken
    );
}

#[test]
fn what_fails_to_begin_is_stopped_and_what_is_refused_is_left_alone() {
    let devices = Devices::new();
    let gate = devices.gate(rules());
    gate.start_move(&pose([9e-3, 0.0, 0.0])).unwrap_err();
    assert_eq!(devices.world().stops, 0);
    devices.world().fault = Some(Fault::Start);
    let fault = gate.start_move(&z(-6e-3)).unwrap_err();
    assert!(matches!(fault, ScopeError::Device { .. }), "{fault}");
    assert_eq!(devices.world().stops, 1);
}

#[test]
fn a_cheap_focus_drive_retreats_farther_and_never_turns_short_of_the_height() {
    const RULE: f64 = -100e-6;
    let rules = |z: f64| Rules {
        change: ChangeRule::Retracted { z, margin: 0.0 },
        ..Rules::travel_only(ChangeRule::Anywhere)
    };
    let mut devices = Devices::new();
    devices.info.axes[2].repeatability = 25e-6;
    devices.world().at[2] = 0.0;
    let clock = Arc::new(Ticking {
        clock: VirtualClock::new(),
        devices: devices.clone(),
    });
    let scope = devices.instrument(rules(RULE), clock, CancelToken::new());
    // Its scatter is wider than what is to be retracted: that is no reason to turn here.
    let refused = scope.gate().start_change(&id("40x"));
    assert!(
        matches!(refused, Err(ScopeError::NotRetracted { .. })),
        "{refused:?}"
    );
    devices.world().excused = true;
    scope.select_objective(&id("40x")).unwrap();
    let turned = devices.world().turned_at;
    assert!((turned.unwrap() + 200e-6).abs() < 1e-9, "{turned:?}");
    // A micrometre short counts, and no more, whatever z scatters.
    for (at, turns) in [(RULE + 1.1e-6, false), (RULE + 0.9e-6, true)] {
        devices.world().at[2] = at;
        let answer = scope.gate().start_change(&id("10x"));
        assert_eq!(answer.is_ok(), turns, "{at}: {answer:?}");
    }
    // No room beyond the height for that.
    let room = MotionGate::new(
        Box::new(devices.clone()),
        Box::new(devices.clone()),
        rules(-TRAVEL + 50e-6),
    );
    let said = room.err().unwrap().to_string();
    assert!(said.contains("100.0 um beyond"), "{said}");
    devices.info.axes[2].repeatability = 600e-6;
    let said = MotionGate::new(Box::new(devices.clone()), Box::new(devices), rules(RULE));
    let said = said.err().unwrap().to_string();
    assert!(said.contains("repeatability of z is 600 um"), "{said}");
}

#[test]
fn an_ellipsoid_gives_each_axis_what_the_others_leave() {
    let devices = Devices::new();
    let gate = devices.gate(Rules {
        workspace: Workspace::Ellipsoid,
        ..Rules::travel_only(ChangeRule::Anywhere)
    });
    // z is at 5 mm of 10: a quarter is used.
    let x = |at| StagePose::default().with_si(Axis::X, at);
    gate.check(&x(8.6e-3)).unwrap();
    let most = gate.check(&x(8.7e-3));
    assert!(
        matches!(most, Err(ScopeError::OutsideWorkspace { share }) if share > 1.0 && share < 1.01),
        "{most:?}"
    );
    gate.check(&pose([9.9e-3, 0.0, 0.0])).unwrap();
}

/// The same devices where somebody says which objective is in.
struct Hearsay(Devices);

impl Nosepiece for Hearsay {
    fn objectives(&self) -> &[Objective] {
        self.0.objectives()
    }
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        self.0.current()
    }
    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        self.0.start_change(to)
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        Nosepiece::poll(&self.0)
    }
    fn stop(&self) -> Result<(), ScopeError> {
        Nosepiece::stop(&self.0)
    }
    fn known_by(&self) -> KnownBy {
        KnownBy::Report
    }
}

#[test]
fn until_a_picture_shows_the_objective_the_rules_of_all_hold() {
    let mut devices = Devices::new();
    // Those that work in air.
    devices.objectives.truncate(2);
    let hearsay = Hearsay(devices.clone());
    let gate = MotionGate::new(Box::new(devices.clone()), Box::new(hearsay), rules()).unwrap();
    assert_eq!(gate.current_objective(), Ok(Some(id("10x"))));
    // Beyond what 40x may, within what 10x may.
    let beyond = StagePose::default().with_si(Axis::X, NARROW_X + 1e-4);
    assert!(matches!(
        gate.check(&beyond),
        Err(ScopeError::OutsideLimits { .. })
    ));
    gate.confirm_objective();
    assert_eq!(gate.check(&beyond), Ok(()));
    // Shown to be another one, it is unknown until somebody was asked again, also for the same.
    assert!(gate.contradict_objective());
    assert_eq!(gate.current_objective(), Ok(None));
    assert!(gate.check(&beyond).is_err());
    gate.start_change(&id("10x")).unwrap();
    (0..3).for_each(|_| devices.world().tick());
    assert_eq!(gate.poll_nosepiece(), Ok(Motion::Settled));
    assert_eq!(gate.current_objective(), Ok(Some(id("10x"))));
    assert!(gate.objective_is_reported());
}

#[test]
fn rules_that_make_no_sense_are_refused() {
    type Breakage = fn(&mut Rules);
    let nonsense: [(&str, Breakage); 7] = [
        ("no room", |r| r.limits.ranges[0].min = 9e-3),
        ("finite", |r| r.limits.ranges[0].max = f64::NAN),
        ("no objective here", |r| {
            r.objective_limits.insert(id("63x"), Limits::default());
        }),
        ("largest step", |r| r.largest_steps[0].step = 0.0),
        ("zone 'the clamp'", |r| r.zones[0].x = [1.0, 0.0]),
        ("leave out the height", |r| {
            let limits = r.objective_limits.get_mut(&id("40x")).unwrap();
            limits.ranges[0].min = -4e-3;
        }),
        ("outside the limits of z", |r| {
            r.objective_limits.clear();
            r.change = ChangeRule::Retracted {
                z: -9e-3,
                margin: 0.0,
            };
        }),
    ];
    for (word, f) in nonsense {
        let devices = Devices::new();
        let mut rules = rules();
        f(&mut rules);
        let answer = MotionGate::new(Box::new(devices.clone()), Box::new(devices), rules);
        let said = answer.err().expect(word).to_string();
        assert!(said.contains(word), "{word}: {said}");
    }
}

/// An instrument whose medium on the specimen somebody changes who answers like this, and how often that was asked.
fn asked(devices: &Devices, yes: bool) -> (Instrument, Arc<Mutex<Vec<ImmersionChange>>>) {
    let clock = Arc::new(Ticking {
        clock: VirtualClock::new(),
        devices: devices.clone(),
    });
    let heard: Arc<Mutex<Vec<ImmersionChange>>> = Arc::default();
    let (ears, world) = (heard.clone(), devices.clone());
    let scope = devices
        .instrument(rules(), clock, CancelToken::new())
        .asking_before_immersion(Arc::new(move |change, _| {
            ears.lock().unwrap().push(change.clone());
            if yes {
                world.world().medium = change.to;
            }
            yes
        }));
    (scope, heard)
}

#[test]
fn nothing_goes_between_oil_and_dry_unasked_and_one_answer_is_for_one_change() {
    let devices = Devices::new();
    let (scope, heard) = asked(&devices, true);
    let times = || heard.lock().unwrap().len();
    // Dry to dry: nobody is asked. Then into oil, and out again: each time.
    for (to, asked) in [("40x", 0), ("60x", 1), ("60x", 1), ("10x", 2), ("60x", 3)] {
        scope.select_objective(&id(to)).unwrap();
        assert_eq!(times(), asked, "{to}");
    }
    let (first, second) = {
        let heard = heard.lock().unwrap();
        (heard[0].clone(), heard[1].clone())
    };
    assert_eq!(first.from, BTreeSet::from([Immersion::Air]));
    assert_eq!((first.to, second.to), (Immersion::Oil, Immersion::Air));
    assert_eq!(second.from, BTreeSet::from([Immersion::Oil]));
    // Whoever asks the gate itself is refused, whatever was agreed to before.
    let refused = scope.gate().start_change(&id("10x"));
    assert!(
        matches!(refused, Err(ScopeError::ImmersionNotAgreed { .. })),
        "{refused:?}"
    );
    let broken = devices.world().broken.clone();
    assert!(broken.is_empty(), "{broken:?}");
}

#[test]
fn who_says_no_to_another_medium_or_is_not_there_moves_nothing() {
    let devices = Devices::new();
    let (says_no, heard) = asked(&devices, false);
    let clock = Arc::new(VirtualClock::new());
    let nobody = devices.instrument(rules(), clock, CancelToken::new());
    devices.world().at[2] = 1e-3;
    for scope in [&says_no, &nobody] {
        let begun = devices.world().begun;
        let refused = scope.select_objective(&id("60x")).unwrap_err();
        let ScopeError::ImmersionNotAgreed { change } = &refused else {
            panic!("{refused}");
        };
        assert_eq!(
            (change.to, refused.kind()),
            (Immersion::Oil, ErrorKind::Refused)
        );
        let said = refused.to_string();
        assert!(
            said.contains("60x works in oil, and on the specimen there is air"),
            "{said}"
        );
        // Not even away from the specimen.
        assert_eq!(devices.world().begun, begun);
    }
    assert_eq!(heard.lock().unwrap().len(), 1);
}

#[test]
fn what_the_specimen_was_made_ready_for_counts_until_that_objective_is_in() {
    let devices = Devices::new();
    let gate = devices.gate(rules());
    let settle = || (0..8).for_each(|_| devices.world().tick());
    let change = gate.immersion_change(&id("60x")).unwrap().unwrap();
    devices.world().medium = Immersion::Oil;
    gate.agree_to_immersion(&change);
    // There is oil under a dry objective now: another dry one may not come.
    let both = BTreeSet::from([Immersion::Air, Immersion::Oil]);
    let dry = gate.start_change(&id("40x"));
    assert!(
        matches!(&dry, Err(ScopeError::ImmersionNotAgreed { change }) if change.from == both),
        "{dry:?}"
    );
    // Stopped on the way: which objective is in is not known, and nothing comes unasked, the same one included.
    gate.start_change(&id("60x")).unwrap();
    gate.stop().unwrap();
    settle();
    for to in ["10x", "40x", "60x"] {
        let again = gate.immersion_change(&id(to)).unwrap().unwrap();
        assert_eq!(again.from, both, "{to}");
    }
    let change = gate.immersion_change(&id("60x")).unwrap().unwrap();
    gate.agree_to_immersion(&change);
    gate.start_change(&id("60x")).unwrap();
    settle();
    assert_eq!(gate.poll_nosepiece(), Ok(Motion::Settled));
    assert_eq!(gate.immersions(), Ok(BTreeSet::from([Immersion::Oil])));
    let broken = devices.world().broken.clone();
    assert!(broken.is_empty(), "{broken:?}");
}

/// A nosepiece that takes a change, and settles where it was.
struct Stalls(Devices);

impl Nosepiece for Stalls {
    fn objectives(&self) -> &[Objective] {
        self.0.objectives()
    }
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        self.0.current()
    }
    fn start_change(&self, _: &ObjectiveId) -> Result<(), ScopeError> {
        Ok(())
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        Nosepiece::poll(&self.0)
    }
    fn stop(&self) -> Result<(), ScopeError> {
        Nosepiece::stop(&self.0)
    }
}

#[test]
fn what_the_specimen_was_made_ready_for_counts_where_the_nosepiece_settles_at_another_objective() {
    let devices = Devices::new();
    let stalls = Box::new(Stalls(devices.clone()));
    let gate = MotionGate::new(Box::new(devices.clone()), stalls, rules()).unwrap();
    let change = gate.immersion_change(&id("60x")).unwrap().unwrap();
    gate.agree_to_immersion(&change);
    gate.start_change(&id("60x")).unwrap();
    assert_eq!(gate.poll_nosepiece(), Ok(Motion::Settled));
    assert_eq!(gate.current_objective(), Ok(Some(id("10x"))));
    // There is oil, whatever objective is above it.
    let both = BTreeSet::from([Immersion::Air, Immersion::Oil]);
    assert_eq!(gate.immersions(), Ok(both));
    let dry = gate.start_change(&id("40x"));
    assert!(
        matches!(&dry, Err(ScopeError::ImmersionNotAgreed { .. })),
        "{dry:?}"
    );
}

/// An instrument of which no move of z may be longer than 0.1 mm, with a stage that ends a little short of every goal.
fn short(devices: &Devices) -> Instrument {
    devices.world().short = 0.9e-6;
    let clock = Arc::new(Ticking {
        clock: VirtualClock::new(),
        devices: devices.clone(),
    });
    let mut rules = rules();
    rules
        .largest_steps
        .retain(|largest| largest.axis != Axis::Z);
    rules.largest_steps.push(LargestStep {
        axis: Axis::Z,
        step: 1e-4,
    });
    devices.instrument(rules, clock, CancelToken::new())
}

#[test]
fn each_step_of_a_long_way_counts_from_where_the_stage_says_that_it_is() {
    let devices = Devices::new();
    let scope = short(&devices);
    devices.world().at[2] = 1e-3;
    scope.select_objective(&id("40x")).unwrap();
    let at = devices.world().at[2];
    assert!((at - 1e-3).abs() < 2e-6, "{at}");
    // Across both other axes it is a straight line, and a goal that is refused moves nothing.
    scope.move_in_steps(&pose([1e-3, -2e-3, 1.5e-3])).unwrap();
    let begun = devices.world().begun;
    let outside = scope.move_in_steps(&pose([0.0, 0.0, NARROW + 1e-6]));
    assert!(
        matches!(
            outside,
            Err(ScopeError::OutsideLimits { axis: Axis::Z, .. })
        ),
        "{outside:?}"
    );
    assert_eq!(devices.world().begun, begun);
    let broken = devices.world().broken.clone();
    assert!(broken.is_empty(), "{broken:?}");
}

#[test]
fn a_stage_that_stood_beyond_a_limit_by_less_than_it_may_miss_can_go_back() {
    let devices = Devices::new();
    let scope = short(&devices);
    devices.world().at[0] = LIMIT + 0.8e-6;
    let stood = scope.gate().position().unwrap();
    scope
        .move_to(&StagePose::default().with_si(Axis::X, LIMIT - 5e-3))
        .unwrap();
    let refused = scope.move_to(&stood);
    assert!(
        matches!(
            refused,
            Err(ScopeError::OutsideLimits { axis: Axis::X, .. })
        ),
        "{refused:?}"
    );
    scope.return_to(&stood).unwrap();
    let at = devices.world().at[0];
    assert!((at - LIMIT).abs() < 2e-6, "{at}");
    // Beyond by more, it is told as before.
    let far = stood.with_si(Axis::X, LIMIT + 1e-5);
    assert!(matches!(
        scope.return_to(&far),
        Err(ScopeError::OutsideLimits { axis: Axis::X, .. })
    ));
}

/// A nosepiece that names an objective that it does not list.
struct Unlisted(Devices);

impl Nosepiece for Unlisted {
    fn objectives(&self) -> &[Objective] {
        self.0.objectives()
    }
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        Ok(Some(id("5x")))
    }
    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        self.0.start_change(to)
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        Nosepiece::poll(&self.0)
    }
    fn stop(&self) -> Result<(), ScopeError> {
        Nosepiece::stop(&self.0)
    }
}

#[test]
fn an_objective_that_the_nosepiece_does_not_list_may_work_in_anything() {
    let devices = Devices::new();
    let nosepiece = Box::new(Unlisted(devices.clone()));
    let gate = MotionGate::new(Box::new(devices), nosepiece, rules()).unwrap();
    let both = BTreeSet::from([Immersion::Air, Immersion::Oil]);
    assert_eq!(gate.immersions(), Ok(both));
}
