//! One session on the simulated microscope.

mod common;

use common::{PLACE_UM, Watched, bench, drain};
use scopeservo_scope::Axis;
use scopeservo_servo::{Event, FocusOptions, RepositionOptions, ServoOptions, Verdict};
use scopeservo_station::jobs::{
    Answer, AnyJob, CalibrateInput, CalibrateJob, DoctorInput, DoctorJob, IdentifyInput,
    IdentifyJob, RepositionInput, RepositionJob, Request, SaveTargetInput, SaveTargetJob, Trouble,
};
use scopeservo_station::{
    Ended, JobError, JobId, JobInfo, Journal as _, Kept, News, Refusal, StationEvent,
};

#[test]
fn one_session_calibrates_stops_repositions_stops_and_repositions_to_the_end_while_others_watch() {
    let bench = bench();
    let (journal, hand) = Watched::new();
    let session = bench.session(journal.clone());
    let ada = session.take_lease("Ada", None).unwrap();
    // A second owner is refused, and watches. Another listens and never reads.
    let refused = session.take_lease("Bob", None).unwrap_err();
    assert!(
        matches!(&refused, Refusal::Held { owner, .. } if owner == "Ada"),
        "{refused}"
    );
    let (mut bob, mut never) = (session.listen(), session.listen());
    let from = 1; // After the lease was taken.
    assert_eq!(bob.frame(), None);

    let save = SaveTargetInput {
        focus: Some(FocusOptions::default()),
        ..SaveTargetInput::default()
    };
    let saved = session.start(&ada, SaveTargetJob::new(save)).unwrap();
    let saved = saved.wait().unwrap();
    assert!(saved.target.moved.is_some() && saved.frame.is_some());
    let truth = bench.twin.truth_now();
    let shown = bob.frame().unwrap();
    assert!(shown.missed > 0);
    let identify = IdentifyJob::new(IdentifyInput::default());
    let identified = session.start(&ada, identify).unwrap().wait().unwrap();
    assert!(identified.identity.as_told);

    let [x, y] = PLACE_UM;
    bench.twin.centre_specimen([x + 25.0, y - 15.0], 6.0);
    hand.wait_at(|job, _, state| job.kind == "calibrate" && state.contains("{\"calibrate\":{"));
    let calibrate = CalibrateJob::new(CalibrateInput::default());
    let calibrating = session.start(&ada, calibrate).unwrap();
    hand.reached();
    let moves = bench.scope.counters().moves;
    session.stop().unwrap();
    hand.go();
    let stopped = calibrating.wait();
    assert!(
        matches!(stopped, Err(JobError::Stopped { at: Some(_) })),
        "{stopped:?}"
    );
    assert_eq!(bench.scope.counters().moves, moves);

    let input = |known: Vec<_>| RepositionInput {
        target_id: "mitosis-3".into(),
        options: RepositionOptions {
            servo: ServoOptions {
                lambda: 0.7,
                ..ServoOptions::default()
            },
            ..RepositionOptions::default()
        },
        foreign_um_per_px: None,
        known,
        switchings: Vec::new(),
        parcentric: Vec::new(),
    };
    let run = |known| RepositionJob::new(saved.target.clone(), input(known));
    hand.wait_at(|job, _, state| job.kind == "reposition" && state.contains("{\"servo\":{"));
    let repositioning = session.start(&ada, run(Vec::new())).unwrap();
    let handle = repositioning.handle().clone();
    hand.reached();
    handle.stop().unwrap();
    hand.go();
    assert!(matches!(
        repositioning.wait(),
        Err(JobError::Stopped { .. })
    ));
    // What it measured on the way is not lost, and its state has no copy of the target.
    let kept = handle.kept();
    let [Kept::Calibration(made)] = &kept[..] else {
        panic!("{kept:?}");
    };
    assert!(made.residual_px.is_some() && made.focus_z_um.is_some());
    let state = journal.last_state();
    assert!(state.len() < 20_000, "{} bytes", state.len());

    // From its state it goes on, whole again with its target.
    let stored = AnyJob::stored("reposition", state.as_bytes()).unwrap();
    assert_eq!(stored.target_id(), Some("mitosis-3"));
    let stored = stored.with_target(saved.target.clone());
    let resumed = session.start(&ada, stored).unwrap().wait();
    let Ok(Answer::Reposition(resumed)) = resumed else {
        panic!("{resumed:?}");
    };
    assert_eq!(resumed.outcome.verdict, Verdict::Arrived);
    assert_eq!(resumed.made.len(), 1);
    let (um, deg) = bench.error_from(&truth);
    assert!(um < 1.0 && deg < 0.1, "{um} um, {deg} deg");

    // And a new run to the end, with what was kept.
    bench.twin.centre_specimen([x - 20.0, y + 10.0], 3.0);
    let known = vec![made.calibration.clone()];
    let arrived = session.start(&ada, run(known)).unwrap().wait().unwrap();
    assert_eq!(
        arrived.outcome.verdict,
        Verdict::Arrived,
        "{:?}",
        arrived.outcome
    );
    assert!(arrived.made.is_empty() && arrived.counters.moves > 0);
    let (um, deg) = bench.error_from(&truth);
    assert!(um < 1.0 && deg < 0.1, "{um} um, {deg} deg");

    // Who watched has heard how each job ended, or is told how much is gone.
    let (heard, missed) = drain(&mut bob);
    let told = heard.last().unwrap().number + 1;
    assert_eq!(heard.len() as u64 + missed, told - from);
    let mut ends = heard.iter().filter_map(|r| match &r.news {
        News::Station(StationEvent::JobEnded { how, .. }) => Some(how.clone()),
        _ => None,
    });
    assert_eq!(ends.next_back(), Some(Ended::Answered));
    let finished = |e: &Event| matches!(e, Event::Finished { .. });
    assert!(
        heard
            .iter()
            .any(|r| matches!(&r.news, News::Procedure(e) if finished(e)))
    );
    assert!(bob.frame().unwrap().missed > 50);
    assert!(never.heard().is_some());
}

#[test]
fn focus_and_calibration_answer_what_is_to_be_kept() {
    let bench = bench();
    let session = bench.session(std::sync::Arc::new(
        scopeservo_station::MemoryJournal::default(),
    ));
    let ada = session.take_lease("Ada", None).unwrap();
    // Also as data.
    let request = r#"{"job": "focus", "input": {"focus": {"half_range_um": 30.0}}}"#;
    let request: Request = serde_json::from_str(request).unwrap();
    let focus = AnyJob::new(request, |id| Err(id.to_owned())).unwrap();
    let focused = session.start(&ada, focus).unwrap().wait();
    let Ok(Answer::Focus(focused)) = focused else {
        panic!("{focused:?}");
    };
    let z_um = focused.result.z_um.unwrap();
    let mut ear = session.bus().listen_from(0);
    let calibrate = CalibrateJob::new(CalibrateInput::default());
    let job = session.start(&ada, calibrate).unwrap();
    let handle = job.handle().clone();
    let made = job.wait().unwrap().made;
    assert_eq!(made.len(), 1);
    assert_eq!(
        handle.kept(),
        [Kept::Calibration(Box::new(made[0].clone()))]
    );
    assert!((made[0].focus_z_um.unwrap() - z_um).abs() < 5.0);
    // Each frame is told with when it was exposed and where the stage stood, so that a log can be replayed.
    let (told, missed) = drain(&mut ear);
    let mut frames = 0;
    for record in &told {
        if let News::Procedure(event) = &record.news
            && let Event::FrameGrabbed {
                exposure_start_s,
                exposure_s,
                stage,
                ..
            } = &**event
        {
            frames += 1;
            let began = exposure_start_s.unwrap();
            let lasted = exposure_s.unwrap();
            assert!(began + lasted <= record.time_s && record.time_s - began < 1.0);
            let z = stage.and_then(|at| at.si(Axis::Z));
            assert!(z.is_some(), "{event:?}");
        }
    }
    assert!(
        frames > 20 && missed == 0,
        "{frames} frames, {missed} missed"
    );
    let objective = &made[0].calibration.objective;
    let truth = bench.twin.true_calibration(objective).unwrap();
    let scale = made[0].calibration.um_per_px() * truth.kx.abs() * 1e-6;
    assert!((scale - 1.0).abs() < 0.01, "{scale}");
}

#[test]
fn a_doctor_tells_each_finding_as_it_is_reached_and_leaves_the_journal_alone() {
    let bench = bench();
    let journal = std::sync::Arc::new(scopeservo_station::MemoryJournal::default());
    let session = bench.session(journal.clone());
    let ada = session.take_lease("Ada", None).unwrap();
    // A job that was killed waits.
    let left = JobInfo {
        id: JobId(7),
        kind: "reposition".into(),
        owner: "Ada".into(),
    };
    journal
        .before_step(&left, 3, &|| Ok(b"{}".to_vec()))
        .unwrap();
    for allow_motion in [false, true] {
        let mut ear = session.listen();
        let moves = bench.scope.counters().moves;
        let job = DoctorJob::new(DoctorInput { allow_motion });
        let found = session.start(&ada, job).unwrap().wait().unwrap().findings;
        let wrong: Vec<_> = found.iter().filter(|f| !f.is_ok()).collect();
        assert!(wrong.is_empty(), "{wrong:?}");
        assert_eq!(found.iter().any(|f| f.of_trial), allow_motion);
        assert_eq!(bench.scope.counters().moves > moves, allow_motion);
        let told = drain(&mut ear).0.into_iter().filter_map(|r| match &r.news {
            News::Station(StationEvent::Found { finding }) => Some((**finding).clone()),
            _ => None,
        });
        assert_eq!(told.collect::<Vec<_>>(), found);
    }
    assert_eq!(journal.last().unwrap().0, left);
    // Trouble is a value: the view's is that too little is to be seen.
    bench.scope.light().unwrap().set_level(0.0).unwrap();
    let request: Request = serde_json::from_str(r#"{"job": "doctor", "input": {}}"#).unwrap();
    let doctor = AnyJob::new(request, |id| Err(id.to_owned())).unwrap();
    let Ok(Answer::Doctor(found)) = session.start(&ada, doctor).unwrap().wait() else {
        panic!("a doctor answers");
    };
    let trouble = found.findings.into_iter().filter_map(|f| f.trouble);
    assert_eq!(
        trouble.collect::<Vec<_>>(),
        [Trouble::Dark, Trouble::TooLittle]
    );
}
