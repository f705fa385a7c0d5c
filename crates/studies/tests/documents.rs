//! The documents say what is so.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn rust_sources(folder: &Path, into: &mut String) {
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        if path.is_dir() {
            rust_sources(&path, into);
        } else if path.extension().is_some_and(|x| x == "rs") {
            into.push_str(&fs::read_to_string(&path).unwrap());
        }
    }
}

#[test]
fn every_convention_names_a_test_that_exists() {
    let text = fs::read_to_string(root().join("CONVENTIONS.md")).unwrap();
    let mut sources = String::new();
    rust_sources(&root().join("crates"), &mut sources);
    let named: Vec<&str> = text
        .split("(test: `")
        .skip(1)
        .map(|rest| rest.split('`').next().unwrap())
        .collect();
    assert!(named.len() > 20);
    for name in named {
        assert!(
            sources.contains(&format!("fn {name}()")),
            "no test is called {name}"
        );
    }
    // One line, one proof.
    for item in text.split("\n- ").skip(1) {
        assert!(item.contains("(test: `"), "unproved: {item}");
    }
}

/// The crates of ours that each crate may use outside its tests.
const ALLOWED: [(&str, &[&str]); 19] = [
    ("files", &[]),
    ("sift", &[]),
    ("geometry", &[]),
    ("features", &["sift"]),
    ("registration", &["features", "geometry"]),
    ("scope", &[]),
    ("protocol", &["scope"]),
    ("setup", &["files", "scope", "protocol", "drivers", "twin"]),
    ("drivers", &["files", "slide", "scope"]),
    ("slide", &["files"]),
    ("twin", &["scope", "slide"]),
    ("servo", &["features", "geometry", "registration", "scope"]),
    ("library", &["files", "slide", "scope", "servo", "features"]),
    ("station", &["features", "scope", "servo"]),
    ("report", &["servo", "scope", "geometry", "registration"]),
    (
        "cli",
        &[
            "files",
            "sift",
            "features",
            "geometry",
            "registration",
            "scope",
            "slide",
            "twin",
            "servo",
            "report",
            "protocol",
            "setup",
            "library",
            "station",
            "workbench",
            "server",
        ],
    ),
    (
        "workbench",
        &[
            "library", "report", "scope", "servo", "setup", "station", "twin",
        ],
    ),
    (
        "server",
        &[
            "files",
            "library",
            "protocol",
            "report",
            "scope",
            "servo",
            "setup",
            "slide",
            "station",
            "workbench",
        ],
    ),
    (
        "studies",
        &[
            "sift",
            "features",
            "geometry",
            "registration",
            "scope",
            "slide",
            "twin",
            "servo",
        ],
    ),
];

#[test]
fn crates_know_only_what_the_architecture_allows() {
    let output = Command::new(env!("CARGO"))
        .args([
            "metadata",
            "--no-deps",
            "--format-version",
            "1",
            "--offline",
        ])
        .current_dir(root())
        .output()
        .unwrap();
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    assert_eq!(packages.len(), ALLOWED.len());
    for package in packages {
        let short = |name: &serde_json::Value| name.as_str().unwrap().replace("scopeservo-", "");
        let name = short(&package["name"]);
        let (_, allowed) = ALLOWED
            .iter()
            .find(|(n, _)| *n == name)
            .expect("every crate is listed");
        let used: BTreeSet<String> = package["dependencies"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|d| {
                d["kind"].is_null() && d["name"].as_str().unwrap().starts_with("scopeservo-")
            })
            .map(|d| short(&d["name"]))
            .collect();
        for dependency in used {
            assert!(
                allowed.contains(&dependency.as_str()),
                "{name} must not know {dependency}"
            );
        }
    }
}

/// Clippy holds most of it (clippy.toml, and the lints against printing); here is that a library asks for that, and what clippy cannot
/// see.
#[test]
fn libraries_keep_to_themselves() {
    let lints = fs::read_to_string(root().join("Cargo.toml")).unwrap();
    for print in ["print_stdout", "print_stderr", "dbg_macro"] {
        assert!(lints.contains(&format!("{print} = \"warn\"")), "{print}");
    }
    let strict = [
        "sift",
        "features",
        "geometry",
        "registration",
        "servo",
        "station",
        "report",
    ];
    let others = [
        "twin",
        "scope",
        "protocol",
        "setup",
        "drivers",
        "library",
        "slide",
        "files",
        "workbench",
        "server",
    ];
    for name in strict.into_iter().chain(others) {
        let package = root().join("crates").join(name);
        let manifest = fs::read_to_string(package.join("Cargo.toml")).unwrap();
        assert!(manifest.contains("[lints]\nworkspace = true"), "{name}");
        let mut sources = String::new();
        rust_sources(&package.join("src"), &mut sources);
        assert!(!sources.is_empty());
        // The streams by their functions, which only the strict are held to by clippy.
        for word in ["io::stdout", "io::stderr", "clippy::print_std"] {
            assert!(!sources.contains(word), "{name} uses {word}");
        }
        if !strict.contains(&name) {
            continue;
        }
        let top = fs::read_to_string(package.join("src/lib.rs")).unwrap();
        for lint in ["methods", "types", "macros"] {
            let lint = format!("clippy::disallowed_{lint}");
            assert!(top.contains(&lint), "{name} does not turn {lint} on");
        }
        // A global that changes is state, whatever its type.
        let globals = sources.lines().map(str::trim_start).filter(|line| {
            let line = line.strip_prefix("pub ").unwrap_or(line);
            let line = line.strip_prefix("pub(crate) ").unwrap_or(line);
            line.starts_with("static ")
                && ["Mutex", "Atomic", "Cell", "RwLock", "static mut"]
                    .iter()
                    .any(|word| line.contains(word))
        });
        let globals: Vec<&str> = globals.collect();
        assert!(globals.is_empty(), "{name}: {globals:?}");
    }
}

#[test]
fn every_study_is_in_the_measured_page() {
    let page = fs::read_to_string(root().join("docs/measured.md")).unwrap();
    for study in fs::read_dir(root().join("crates/studies/examples"))
        .unwrap()
        .flatten()
    {
        let name = study
            .path()
            .file_stem()
            .unwrap()
            .to_string_lossy()
            .into_owned();
        assert!(
            page.contains(&format!("--example {name}")),
            "{name} is not measured"
        );
    }
}

#[test]
fn the_readme_names_the_rust_that_is_promised() {
    let read = |name: &str| fs::read_to_string(root().join(name)).unwrap();
    let manifest = read("Cargo.toml");
    let (_, rest) = manifest.split_once("\nrust-version = \"").unwrap();
    let (version, _) = rest.split_once('"').unwrap();
    assert!(read("README.md").contains(&format!("[Rust](https://rustup.rs) {version} or newer")));
}

#[test]
fn files_that_the_documents_link_to_are_there() {
    for document in [
        "README.md",
        "ARCHITECTURE.md",
        "CONVENTIONS.md",
        "CHANGELOG.md",
        "docs/answers.md",
        "docs/measured.md",
        "docs/sift-accuracy.md",
    ] {
        let path = root().join(document);
        let text = fs::read_to_string(&path).unwrap();
        for link in text
            .split("](")
            .skip(1)
            .map(|rest| rest.split(')').next().unwrap())
        {
            if !link.starts_with("http") {
                let target = path.parent().unwrap().join(link);
                assert!(target.exists(), "{document} links to {link}");
            }
        }
    }
}

/// The variants of an enum as code words.
fn words_of(source: &str, name: &str) -> BTreeSet<String> {
    let text = fs::read_to_string(root().join(source)).unwrap();
    let (_, body) = text.split_once(&format!("enum {name} {{\n")).unwrap();
    let (body, _) = body.split_once("\n}").unwrap();
    let names = body.lines().map(str::trim);
    let names = names.filter(|line| line.starts_with(|c: char| c.is_ascii_uppercase()));
    let snake = |name: &str| {
        let parts = name
            .trim_end_matches(',')
            .chars()
            .map(|c| match c.is_ascii_uppercase() {
                true => format!("_{}", c.to_ascii_lowercase()),
                false => c.to_string(),
            });
        parts.collect::<String>().trim_start_matches('_').to_owned()
    };
    names.map(snake).collect()
}

#[test]
fn every_code_word_and_every_reason_says_what_it_means_and_what_to_do() {
    let page = fs::read_to_string(root().join("docs/troubleshooting.md")).unwrap();
    let mut sections = BTreeSet::new();
    for section in page.split("\n### `").skip(1) {
        let (word, rest) = section.split_once('`').unwrap();
        let rest = rest.split("\n## ").next().unwrap();
        for part in ["**What it means.** ", "**What to do.** "] {
            let said = rest
                .split(part)
                .nth(1)
                .unwrap_or_else(|| panic!("{word}: {part}"));
            assert!(said.len() > 20, "{word}: {part}");
        }
        assert!(sections.insert(word.to_owned()), "{word} twice");
    }
    let program = words_of("crates/cli/src/error.rs", "Code");
    let method = words_of("crates/servo/src/code.rs", "ErrorCode");
    let mut reasons = words_of("crates/servo/src/reposition/outcome.rs", "Reason");
    assert!(reasons.remove("converged"), "an arrival is no trouble");
    assert!(program.len() > 20 && method.len() > 12 && reasons.len() > 15);
    // A refusal by the gate is told as `refused` by a command, as `outside_limits` in a verdict.
    let known: BTreeSet<String> = program.into_iter().chain(method).chain(reasons).collect();
    assert_eq!(sections, known);
}
