//! A library with very many targets and events: how long a list, a search and an opening take.
//!
//! `cargo run --release -p scopeservo-library --example many -- [TARGETS] [EVENTS]`; 100 000 and 1 000 000 unless told. The targets share one
//! file and one picture.
#![allow(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "a program that measures and tells"
)]

use rusqlite::{Connection, params};
use scopeservo_features::Features;
use scopeservo_library::{
    Database, Label, NewTarget, RunHead, RunQuery, Runs as _, TargetQuery, Targets as _,
};
use scopeservo_scope::{Channels, Frame, ObjectiveId, Samples, StagePose, Timestamp};
use scopeservo_servo::Target;
use serde_json::json;
use std::error::Error;
use std::time::{Duration, Instant};

/// Each is done so often.
const TIMES: usize = 21;

fn main() -> Result<(), Box<dyn Error>> {
    let mut given = std::env::args().skip(1);
    let mut number = |usual: i64| given.next().map_or(Ok(usual), |text| text.parse());
    let (targets, events) = (number(100_000)?, number(1_000_000)?);
    let dir = tempfile::tempdir()?;
    let library = Database::new(dir.path().into());
    fill(&library, targets, events)?;
    println!(
        "{targets} targets, {events} events, {:.0} MB; ms: median, most",
        size(&library)?
    );
    let query = |text, slide| TargetQuery {
        text,
        slide,
        limit: 100,
        ..TargetQuery::default()
    };
    let middle = format!("t-{}", targets / 2);
    let find = |wanted: TargetQuery<'_>| library.find_targets(&wanted).map(|rows| rows.len());
    time("the newest 100 targets", || find(query("", None)))?;
    time("100 from the middle on", || {
        find(TargetQuery {
            after: Some(&middle),
            ..query("", None)
        })
    })?;
    time("a word that a hundredth has", || {
        find(query("note-17", None))
    })?;
    time("a word that all have", || find(query("metaphase", None)))?;
    time("a word and a part of one", || {
        find(query("metaphase te-4711", None))
    })?;
    time("two letters", || find(query("47", None)))?;
    time("two letters that none has", || find(query("qx", None)))?;
    time("those of a slide", || find(query("", Some("slide 42"))))?;
    time("one target, opened", || library.target(&middle).map(|_| 1))?;
    time("the newest 50 runs", || {
        library
            .runs(&RunQuery {
                limit: 50,
                ..RunQuery::default()
            })
            .map(|r| r.len())
    })?;
    time("the visits to a target", || {
        library
            .runs(&RunQuery {
                limit: 10,
                target: Some(&middle),
                ..RunQuery::default()
            })
            .map(|r| r.len())
    })?;
    let run = library
        .runs(&RunQuery {
            limit: 1,
            ..RunQuery::default()
        })?
        .remove(0)
        .id;
    time("the 1000 events of a run", || {
        library.run_events(&run).map(|e| e.len())
    })?;
    Ok(())
}

/// Rows by themselves: it is their number that counts here.
fn fill(library: &Database, targets: i64, events: i64) -> Result<(), Box<dyn Error>> {
    let frame = Frame {
        width: 640,
        height: 480,
        channels: Channels::Gray,
        bit_depth: 8,
        samples: Samples::U8((0..640 * 480).map(|i| (i * i % 251) as u8).collect()),
        sequence: 0,
        exposure_start: Timestamp::default(),
        exposure: Duration::ZERO,
    };
    let target = Target {
        objective: ObjectiveId("40x".into()),
        features: Features::none("sift", 640, 480),
        picture: None,
        periods_px: Vec::new(),
        moved: None,
        mask: None,
        quality: None,
        taken: None,
    };
    library.keep_target(NewTarget {
        name: "first",
        instrument: "lab",
        stage: StagePose::default(),
        target,
        frame: &frame,
        label: &Label {
            slide: Some("slide 0".into()),
            note: String::new(),
        },
    })?;
    let head = RunHead {
        job: "reposition".into(),
        instrument: "lab".into(),
        version: "scopeservo".into(),
        inputs: json!({"name": "first"}),
    };
    library
        .begin_run(&head)?
        .end(&json!({"verdict": "arrived"}))?;
    let mut rows = Connection::open(library.file())?;
    let all = rows.transaction()?;
    for k in 1..1000 {
        all.execute(
            "INSERT INTO slides (name, first_named) VALUES (?1, '')",
            [format!("slide {k}")],
        )?;
    }
    for k in 0..targets {
        all.prepare_cached(
            "INSERT INTO targets (name, content, instrument, slide, note, saved, objective, um_per_px, width_px, height_px, features, stage, file, picture)
             SELECT ?1, content, instrument, 1 + ?2 % 1000, ?3, ?4, objective, 0.25, width_px, height_px, 800, stage, file, picture
             FROM targets WHERE id = 1",
        )?
        .execute(params![
            format!("t-{k}"),
            k,
            format!("metaphase note-{} site-{k}", k % 100),
            format!("2026-{:02}-{:02}T{:02}:{:02}:00Z", 1 + k / 28 / 24 / 60 % 12, 1 + k / 24 / 60 % 28, k / 60 % 24, k % 60),
        ])?;
    }
    let line = json!({"number": 1, "time_s": 12.25, "job": 3, "from": "procedure", "event": "iteration", "index": 7, "error_um": 1.25, "sigma_px": 0.004,
        "target_from_view": [[0.99, 0.01, 3.2], [-0.01, 0.99, 1.2]], "pairs": 812}).to_string();
    for run in 0..events / 1000 {
        all.execute(
            "INSERT INTO runs (name, job, instrument, version, began, ended, target, target_name, verdict, inputs)
             SELECT ?1, job, instrument, version, began, ended, 2 + ?2, target_name, verdict, inputs FROM runs WHERE id = 1",
            params![format!("{:06}_reposition", run + 2), run * 97 % targets],
        )?;
        let id = all.last_insert_rowid();
        for number in 1..=1000 {
            all.prepare_cached("INSERT INTO events (run, number, event) VALUES (?1, ?2, ?3)")?
                .execute(params![id, number, line])?;
        }
    }
    Ok(all.commit()?)
}

fn size(library: &Database) -> std::io::Result<f64> {
    Ok(std::fs::metadata(library.file())?.len() as f64 / 1e6)
}

fn time<E: Error + 'static>(
    what: &str,
    work: impl Fn() -> Result<usize, E>,
) -> Result<(), Box<dyn Error>> {
    let mut ms = Vec::new();
    let mut count = 0;
    for _ in 0..TIMES {
        let began = Instant::now();
        count = work()?;
        ms.push(1e3 * began.elapsed().as_secs_f64());
    }
    ms.sort_by(f64::total_cmp);
    println!(
        "| {what} | {count} | {:.2} | {:.2} |",
        ms[TIMES / 2],
        ms[TIMES - 1]
    );
    Ok(())
}
