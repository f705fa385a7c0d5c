//! The shape of the code: how long files are, and that none import each other.

mod circles;
mod modules;
mod tokens;

use circles::{circles, told, way};
use modules::{Files, Modules};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Imports that close a circle and are not cut yet: a file of a crate, and what it should not name.
const NOT_YET: [(&str, &str, &str); 0] = [];

/// Crates whose functions are not all short yet, or that do not say so.
const LONG_YET: [&str; 0] = [];

/// Before its tests half of all files have no more lines,
const MEDIAN_LINES: usize = 150;
/// and none has more, unless ARCHITECTURE.md says why.
const MOST_LINES: usize = 450;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The Rust files below a folder.
fn files_below(folder: &Path) -> Files {
    let mut all = Files::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(here) = open.pop() {
        for entry in fs::read_dir(&here).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|x| x == "rs") {
                let name = path.strip_prefix(folder).unwrap().to_str().unwrap();
                let text = fs::read_to_string(&path).unwrap();
                all.insert(name.replace('\\', "/"), text);
            }
        }
    }
    all
}

/// Every crate with the files of its `src`.
fn crates() -> BTreeMap<String, Files> {
    let folders = fs::read_dir(root().join("crates")).unwrap().flatten();
    let named = folders.map(|entry| {
        let name = entry.file_name().to_string_lossy().into_owned();
        (name, files_below(&entry.path().join("src")))
    });
    named.collect()
}

/// Lines before the tests in a file.
fn lines_before_tests(text: &str) -> usize {
    let lines: Vec<&str> = text.lines().collect();
    let opens_tests = |at: &usize| {
        let mut item = lines[at + 1..]
            .iter()
            .skip_while(|l| l.trim_start().starts_with("#["));
        lines[*at] == "#[cfg(test)]"
            && item
                .next()
                .is_some_and(|l| l.contains("mod ") && l.ends_with('{'))
    };
    (0..lines.len()).find(opens_tests).unwrap_or(lines.len())
}

/// Files that may be longer, with the reason: the table of ARCHITECTURE.md.
fn longer_files() -> BTreeMap<String, String> {
    let text = fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let (_, table) = text
        .split_once("\n| longer file | why |\n")
        .expect("a table of longer files");
    let rows = table
        .lines()
        .skip(1)
        .take_while(|line| line.starts_with('|'));
    let cells = rows.map(|row| {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        (cells[0].trim_matches('`').into(), cells[1].into())
    });
    cells.collect()
}

#[test]
fn files_are_short_or_say_why() {
    let mut lengths = BTreeMap::new();
    for (name, files) in crates() {
        for file in Modules::of(&files).files() {
            let lines = lines_before_tests(&files[file]);
            lengths.insert(format!("crates/{name}/src/{file}"), lines);
        }
    }
    let mut sorted: Vec<usize> = lengths.values().copied().collect();
    sorted.sort_unstable();
    let median = sorted[sorted.len() / 2];
    assert!(
        median <= MEDIAN_LINES,
        "half of the files have {median} lines or more"
    );
    let longer = longer_files();
    for (file, lines) in &lengths {
        if *lines > MOST_LINES {
            let why = longer.get(file);
            let why =
                why.unwrap_or_else(|| panic!("{file} has {lines} lines: divide it by subject"));
            assert!(
                !why.is_empty(),
                "ARCHITECTURE.md does not say why {file} is longer"
            );
        }
    }
    for file in longer.keys() {
        let lines = lengths.get(file);
        let lines =
            lines.unwrap_or_else(|| panic!("ARCHITECTURE.md lists {file}, which is not there"));
        assert!(
            *lines > MOST_LINES,
            "ARCHITECTURE.md lists {file}, which has only {lines} lines"
        );
    }
}

/// Clippy counts the lines of functions (clippy.toml); here is that every crate asks for that.
#[test]
fn every_crate_keeps_its_functions_short() {
    for (name, files) in crates() {
        let top = files.get("lib.rs").or(files.get("main.rs")).unwrap();
        let asks = top.contains("#![warn(clippy::too_many_lines)]");
        let yet = LONG_YET.contains(&name.as_str());
        assert!(
            asks || yet,
            "{name} does not turn clippy::too_many_lines on"
        );
        assert!(!(asks && yet), "{name} turns it on: take it from LONG_YET");
    }
}

#[test]
fn no_files_import_each_other() {
    let crates = crates();
    let mut wrong = Vec::new();
    for (name, from, to) in NOT_YET {
        let imports = Modules::of(&crates[name]).imports();
        let names = imports.get(from).is_some_and(|all| all.contains_key(to));
        if !names || way(&imports, to, from).is_none() {
            wrong.push(format!(
                "{name}: {from} closes no circle with {to} any more, take it from NOT_YET"
            ));
        }
    }
    for (name, files) in &crates {
        let mut imports = Modules::of(files).imports();
        for (_, from, to) in NOT_YET.iter().filter(|(of, ..)| of == name) {
            imports.get_mut(*from).and_then(|all| all.remove(*to));
        }
        let circles = circles(&imports);
        wrong.extend(
            circles
                .iter()
                .map(|c| format!("{name}: {}", told(c, &imports))),
        );
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn tree(files: &[(&str, &str)]) -> Files {
    let files = files
        .iter()
        .map(|(name, text)| ((*name).into(), (*text).into()));
    files.collect()
}

fn circles_of(files: &[(&str, &str)]) -> Vec<String> {
    let imports = Modules::of(&tree(files)).imports();
    circles(&imports)
        .iter()
        .map(|c| told(c, &imports))
        .collect()
}

#[test]
fn lines_are_counted_up_to_the_tests() {
    assert_eq!(lines_before_tests("a\n#[cfg(test)]\nuse b;\nc\n"), 4);
    assert_eq!(lines_before_tests("a\n#[cfg(test)]\nmod b;\nc\n"), 4);
    assert_eq!(
        lines_before_tests("a\n\n#[cfg(test)]\n#[rustfmt::skip]\npub(crate) mod tests {\n}\n"),
        2
    );
}

#[test]
fn a_circle_is_found_however_it_is_written() {
    let top = ("lib.rs", "mod a; mod b; mod c; pub use a::A; pub use b::B;");
    // Through what the root re-exports, as a path in code, through a module's name, from the module above, and over a third.
    let circles = [
        vec![
            top,
            ("a.rs", "use crate::B; pub struct A(B);"),
            ("b.rs", "use crate::{A as Other}; pub struct B;"),
            ("c.rs", ""),
        ],
        vec![
            top,
            ("a.rs", "pub struct A(crate::B);"),
            ("b.rs", "pub struct B; fn f() -> super::A { todo!() }"),
            ("c.rs", ""),
        ],
        vec![
            top,
            ("a.rs", "use crate::b; pub fn A() { b::f() }"),
            ("b.rs", "pub fn B() {} pub fn f() { use crate::a::*; A() }"),
            ("c.rs", ""),
        ],
    ];
    for files in circles {
        let found = circles_of(&files);
        assert!(
            matches!(&found[..], [one] if one.starts_with("a.rs uses ") && one.contains("b.rs uses ")),
            "{found:?}"
        );
    }
    let over_a_third = [
        top,
        ("a.rs", "use crate::b::B; pub struct A(B);"),
        ("b.rs", "use crate::c::C; pub struct B(C);"),
        ("c.rs", "use crate::a::A; pub struct C(A);"),
    ];
    assert_eq!(
        circles_of(&over_a_third),
        [
            "a.rs uses crate::b::B of b.rs, b.rs uses crate::c::C of c.rs, c.rs uses crate::a::A of a.rs"
        ]
    );
    let parent_and_child = [
        ("lib.rs", "mod a;"),
        (
            "a/mod.rs",
            "mod b; use b::B; pub const SIZE: usize = 1; pub struct A(B);",
        ),
        ("a/b.rs", "use super::SIZE; pub struct B([u8; SIZE]);"),
    ];
    assert_eq!(circles_of(&parent_and_child).len(), 1);
    let re_exported_and_used = [
        ("lib.rs", "mod a;"),
        (
            "a/mod.rs",
            "mod b; pub use b::B; pub const SIZE: usize = 1; pub struct A(B);",
        ),
        ("a/b.rs", "use super::SIZE; pub struct B([u8; SIZE]);"),
    ];
    assert_eq!(circles_of(&re_exported_and_used).len(), 1);
}

#[test]
fn what_is_no_circle_is_not_told_as_one() {
    let none = [
        // A parent declares and re-exports its child, which takes from it what the parent defines.
        vec![
            ("lib.rs", "mod a;"),
            (
                "a/mod.rs",
                "mod b; pub use b::B; pub const SIZE: usize = 1;",
            ),
            ("a/b.rs", "use super::SIZE; pub struct B([u8; SIZE]);"),
        ],
        // Siblings through a parent that defines nothing.
        vec![
            ("main.rs", "mod a;"),
            (
                "a/mod.rs",
                "mod b; mod c; pub(crate) use b::B; pub(crate) use c::C;",
            ),
            ("a/b.rs", "use super::C; pub struct B(C);"),
            ("a/c.rs", "pub struct C;"),
        ],
        // Tests, comments and texts.
        vec![
            ("lib.rs", "mod a; mod b; #[cfg(test)] mod t;"),
            ("a.rs", "use crate::b::B; pub struct A(B);"),
            (
                "b.rs",
                "pub struct B { #[cfg(test)] a: crate::a::A, b: u8 } // crate::a::A\n/* /* */ use crate::a::A; */\n\
                      const T: &str = \"crate::a::A\"; const R: &str = r#\"\"crate::a::A\"#; const C: char = '\"';\n\
                      #[cfg(test)] mod tests { use crate::a::A; } impl B { #[cfg(test)] fn a<'a, T>() -> crate::a::A { } }\n\
                      #[cfg(test)] use crate::a::{A, A as C};",
            ),
            ("t.rs", "use crate::a::A;"),
        ],
        // Other crates, a module of the same name in them, and an enum's variants.
        vec![
            ("lib.rs", "mod a; mod b;"),
            (
                "a.rs",
                "use std::b::B; use other::{a, b}; pub enum A { X } pub fn f() { std::b::f() }",
            ),
            (
                "b.rs",
                "use crate::a::A::{self, X}; use A::*; pub fn f() -> A { X }",
            ),
        ],
    ];
    for files in none {
        assert_eq!(circles_of(&files), Vec::<String>::new());
    }
}
