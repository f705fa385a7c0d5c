//! Lists that are longer than one answer: what lies in the bin, and what was done.

mod common;

use common::{Bench, Client, HURRIED};
use scopeservo_library::{Database, RunHead, Runs as _};
use serde_json::{Value, json};

fn rows(visitor: &Client, path: &str) -> Vec<Value> {
    let said = visitor.get(path);
    assert_eq!(said.status, 200, "{path}: {}", said.json());
    said.json().as_array().unwrap().clone()
}

#[test]
fn runs_come_page_by_page_whatever_is_added_or_goes_meanwhile() {
    let bench = Bench::demo(HURRIED);
    let visitor = bench.visitor();
    let library = Database::new(bench.folder.path().join("scopeservo-data"));
    let begin = |k: usize| {
        let head = RunHead {
            job: "focus".into(),
            instrument: "another".into(),
            version: String::new(),
            inputs: json!({"number": k}),
        };
        let mut run = library.begin_run(&head).unwrap();
        let id = run.id().to_owned();
        run.end(&json!({})).unwrap();
        id
    };
    let made: Vec<String> = (0..8).map(begin).collect();
    let mut shown: Vec<String> = Vec::new();
    loop {
        let before = shown.last().map(|id| format!("&before={id}"));
        let path = format!("/api/v1/runs?limit=3{}", before.unwrap_or_default());
        let page = rows(&visitor, &path);
        assert!(page.len() <= 3);
        if page.is_empty() {
            break;
        }
        let ids = page
            .iter()
            .map(|run| run["id"].as_str().unwrap().to_owned());
        shown.extend(ids);
        // One more is made between two pages: none is told twice for it.
        begin(100);
    }
    assert_eq!(shown, made.iter().rev().cloned().collect::<Vec<_>>());
    // After what is not there nobody knows what comes; no name leads anywhere else.
    for odd in ["nobody", "..%2F..%2Fdoor", "%00", ""] {
        let said = visitor.get(&format!("/api/v1/runs?before={odd}"));
        assert_eq!(
            (said.status, said.code().as_str()),
            (404, "no_run"),
            "{odd}"
        );
    }
    // A page has bounds.
    assert_eq!(rows(&visitor, "/api/v1/runs?limit=0").len(), 1);
    assert_eq!(visitor.get("/api/v1/runs?limit=-1").status, 400);
}

#[test]
fn the_bin_comes_page_by_page_also_what_has_one_name() {
    let bench = Bench::demo(HURRIED);
    let visitor = bench.visitor();
    for name in ["spot", "other", "spot"] {
        let saved = visitor.run(&json!({"job": "save_target", "name": name, "focus": false}));
        assert_eq!(saved["error"], json!(null), "{saved}");
        let path = format!("/api/v1/targets/{name}");
        assert_eq!(visitor.with("DELETE", &path, &[], "").status, 200);
    }
    let page = |after: Option<&Value>| {
        let after = after.map(|number| format!("&after_number={number}"));
        let path = format!(
            "/api/v1/targets?bin=true&limit=1{}",
            after.unwrap_or_default()
        );
        rows(&visitor, &path).first().cloned()
    };
    let first = page(None).unwrap();
    let second = page(Some(&first["number"])).unwrap();
    assert_eq!([&first["name"], &second["name"]], ["spot", "other"]);
    // The one that was read last is taken back: what comes after it comes all the same.
    let back = visitor.with("PATCH", "/api/v1/targets/other", &[], "{\"restore\": true}");
    assert_eq!(back.status, 200);
    let third = page(Some(&second["number"])).unwrap();
    assert_eq!(third["name"], "spot");
    assert_ne!(third["number"], first["number"]);
    assert_eq!(page(Some(&third["number"])), None);
    // Deleted for good, it has no place any more.
    assert_eq!(
        visitor.with("DELETE", "/api/v1/bin/spot", &[], "").status,
        200
    );
    let path = format!("/api/v1/targets?bin=true&after_number={}", third["number"]);
    let said = visitor.get(&path);
    assert_eq!((said.status, said.code().as_str()), (404, "no_target"));
    for odd in ["x", "1.5", "99999999999999999999"] {
        let said = visitor.get(&format!("/api/v1/targets?after_number={odd}"));
        assert_eq!(
            (said.status, said.code().as_str()),
            (400, "bad_input"),
            "{odd}"
        );
    }
}
