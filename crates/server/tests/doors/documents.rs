//! What is said of the routes, of requests that make no sense, and of the page.

use crate::common::{Bench, HURRIED};
use scopeservo_server::{OPENAPI, routes};
use serde_json::{Value, json};

#[test]
fn what_makes_no_sense_is_refused_with_a_sentence() {
    let mut bench = Bench::demo(HURRIED);
    let visitor = bench.visitor();
    let jobs = [
        json!({}),
        json!({"job": "dance"}),
        json!({"job": "move"}),
        json!({"job": "move", "by": {}}),
        json!({"job": "move", "by": {"w_um": 1.0}}),
        json!({"job": "move", "by": {"x_um": 1.0}, "to": {"x_um": 1.0}}),
        json!({"job": "move", "by": {"x_um": "far"}}),
        json!({"job": "centre", "x": 1.5, "y": 0.5}),
        json!({"job": "objective", "objective": "100x"}),
        json!({"job": "focus", "range_um": -3.0}),
        json!({"job": "calibrate", "objectives": ["100x"]}),
        json!({"job": "save_target", "name": "../../etc/passwd"}),
        json!({"job": "reposition", "target": "nothing"}),
        json!({"job": "resume"}),
        json!({"job": "check"}),
    ];
    for job in jobs {
        let said = visitor.post("/api/v1/jobs", &job);
        assert!((400..500).contains(&said.status), "{job}: {}", said.head);
        let message = said.json()["message"].as_str().unwrap().to_owned();
        assert!(message.len() > 10, "{job}: {message}");
    }
    for (path, body) in [
        ("/api/v1/exposure", "{\"ms\": 1e999}"),
        ("/api/v1/exposure", "{\"ms\": -1}"),
        ("/api/v1/light", "{\"level\": 7}"),
        ("/api/v1/light", "[[[[[["),
        ("/api/v1/slide", "{\"name\": \"a\\u0000b\"}"),
        ("/api/v1/questions/9", "{\"yes\": true}"),
    ] {
        let said = visitor.with("POST", path, &[], body);
        assert!(
            (400..500).contains(&said.status),
            "{path} {body}: {}",
            said.head
        );
        said.code();
    }
    let large = format!("{{\"name\": \"{}\"}}", "x".repeat(2 << 20));
    assert_eq!(
        visitor.with("POST", "/api/v1/slide", &[], &large).status,
        413
    );
    for path in [
        "/api/v1/nothing",
        "/api/v1/targets/%ff",
        "/api/v1/runs/..%2f..",
        "/api/v1/jobs/abc",
        "/nothing.js",
    ] {
        let said = visitor.get(path);
        assert!((400..500).contains(&said.status), "{path}: {}", said.head);
    }
    // Beyond a limit it is the job that is refused.
    let beyond = visitor.run(&json!({"job": "move", "to": {"x_um": 50000.0}}));
    assert_eq!(beyond["error"]["kind"], "refusal", "{beyond}");
    assert_eq!(bench.motions(), 0);
}

#[test]
fn a_page_of_ours_loads_nothing_from_elsewhere_and_is_nobodys_frame() {
    let bench = Bench::demo(HURRIED);
    for path in ["/", "/app.js", "/app.css"] {
        let said = bench.stranger().get(path);
        assert_eq!(said.status, 200, "{path}");
        let policy = said.header("content-security-policy").unwrap();
        assert!(
            policy.starts_with("default-src 'none'; script-src 'self'"),
            "{policy}"
        );
        assert!(policy.contains("frame-ancestors 'none'"), "{policy}");
        assert_eq!(said.header("x-content-type-options"), Some("nosniff"));
    }
    let page = bench.stranger().get("/");
    let text = String::from_utf8(page.body).unwrap();
    assert!(
        !text.contains("http://") && !text.contains("https://"),
        "{text}"
    );
}

#[test]
fn the_document_has_every_route_with_who_may() {
    let document = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/server.md");
    let text = std::fs::read_to_string(document).unwrap();
    let table = text.split("<!-- routes").nth(1).unwrap();
    let rows = table.lines().filter(|line| {
        line.starts_with("| GET") || line.starts_with("| P") || line.starts_with("| DELETE")
    });
    let mut told: Vec<String> = rows
        .map(|row| {
            row.split('|')
                .take(3)
                .map(str::trim)
                .collect::<Vec<_>>()
                .join(" ")
        })
        .collect();
    let mut there: Vec<String> = routes()
        .into_iter()
        .map(|[method, path, need]| format!(" {method} {path} {need}"))
        .collect();
    told.sort();
    there.sort();
    assert_eq!(told, there);
}

#[test]
fn the_description_for_programs_has_every_route_with_who_may() {
    let described: Value = serde_json::from_str(OPENAPI).unwrap();
    let mut told = Vec::new();
    for (path, methods) in described["paths"].as_object().unwrap() {
        for (method, operation) in methods.as_object().unwrap() {
            let who = operation["x-who"].as_str().unwrap();
            told.push([method.to_uppercase(), path.clone(), who.to_owned()]);
            let parameters = operation["parameters"].as_array();
            let named = parameters
                .into_iter()
                .flatten()
                .filter(|p| p["in"] == "path");
            assert_eq!(named.count(), path.matches('{').count(), "{path}");
        }
    }
    let all = routes()
        .into_iter()
        .filter(|[_, path, _]| path.starts_with("/api/"));
    let mut there: Vec<[String; 3]> = all.map(|route| route.map(str::to_owned)).collect();
    told.sort();
    there.sort();
    assert_eq!(told, there);
}
