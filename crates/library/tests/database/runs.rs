//! Runs, and the frames of the oldest.

use super::*;

#[test]
fn a_run_is_kept_with_its_events_and_is_one_of_the_visits_to_its_target() {
    let (_dir, library) = new();
    keep(&library, "spot", &Label::default()).unwrap();
    let first = run(&library, "reposition", "spot", 3, b"<p>one");
    let second = run(&library, "focus", "spot", 1, b"<p>two");
    let third = run(&library, "reposition", "spot", 0, b"<p>three");
    assert!(
        first.starts_with("000001_") && first.ends_with("_reposition"),
        "{first}"
    );
    let ids = |query: &RunQuery<'_>| -> Vec<String> {
        library
            .runs(query)
            .unwrap()
            .into_iter()
            .map(|r| r.id)
            .collect()
    };
    assert_eq!(
        ids(&RunQuery {
            limit: 9,
            ..RunQuery::default()
        }),
        [third.clone(), second.clone(), first.clone()]
    );
    assert_eq!(
        ids(&RunQuery {
            limit: 1,
            before: Some(&third),
            ..RunQuery::default()
        }),
        [second]
    );
    assert_eq!(
        ids(&RunQuery {
            limit: 9,
            target: Some("spot"),
            ..RunQuery::default()
        }),
        [third, first.clone()]
    );
    let row = library.run(&first).unwrap();
    assert_eq!(
        (row.user.as_deref(), row.verdict.as_deref(), row.seconds),
        (Some("anna"), Some("arrived"), Some(1.5))
    );
    assert!(row.ended.is_some() && row.report);
    let events = library.run_events(&first).unwrap();
    assert_eq!(events.len(), 3);
    assert_eq!(
        serde_json::from_str::<serde_json::Value>(&events[2]).unwrap()["event"],
        2
    );
    let (asked, answer) = library.run_said(&first).unwrap();
    assert_eq!(
        (asked["name"].as_str(), answer.unwrap()["verdict"].as_str()),
        (Some("spot"), Some("arrived"))
    );
    let report = library.run_file(&first, "report.html").unwrap().unwrap();
    assert_eq!(fs::read(report).unwrap(), b"<p>one");
    // One that was killed has its events, and no end.
    let mut killed = library
        .begin_run(&common::head("reposition", "spot"))
        .unwrap();
    killed.event("{\"last\":true}");
    let id = killed.id().to_owned();
    drop(killed);
    assert_eq!(library.run_events(&id).unwrap(), ["{\"last\":true}"]);
    assert_eq!(library.run(&id).unwrap().ended, None);
}

#[test]
fn frames_of_the_oldest_runs_go_first_and_events_never() {
    let (_dir, library) = new();
    let ids: Vec<String> = (0..5u8)
        .map(|k| run(&library, "focus", "", 2, &vec![k; 1000]))
        .collect();
    library.pin_run(&ids[1], true).unwrap();
    assert_eq!(library.frames_bytes().unwrap(), 5000);
    assert!(library.keep_frames_within(5000).unwrap().is_empty());
    assert_eq!(
        library.keep_frames_within(3000).unwrap(),
        [ids[0].clone(), ids[2].clone()]
    );
    let with: Vec<bool> = ids
        .iter()
        .map(|id| library.run(id).unwrap().report)
        .collect();
    assert_eq!(with, [false, true, false, true, true]);
    // The newest keeps its own, whatever the budget.
    library.keep_frames_within(0).unwrap();
    assert_eq!(library.frames_bytes().unwrap(), 2000);
    assert!(
        ids.iter()
            .all(|id| library.run_events(id).unwrap().len() == 2)
    );
    assert_eq!(library.check(false, &mut |_, _| {}).unwrap().faults, []);
}
