//! The modules of a crate: what each defines, what it uses, and in which file a path ends.

use crate::tokens::{after_group, begins, tokens, without_tests};
use std::collections::{BTreeMap, BTreeSet};

/// The files of a crate: paths below its `src`, and what they hold.
pub(crate) type Files = BTreeMap<String, String>;

/// From each file to those of which it names something, with one of the names.
pub(crate) type Imports = BTreeMap<String, BTreeMap<String, String>>;

/// A name that a `use` brings in; `*` for all.
#[derive(Debug, Clone)]
struct Use {
    name: String,
    path: Vec<String>,
    public: bool,
}

/// A module outside tests.
#[derive(Debug, Default)]
struct Module {
    file: String,
    defines: BTreeSet<String>,
    uses: Vec<Use>,
    /// Everything but `use` declarations.
    code: Vec<String>,
}

/// The modules of a crate by their paths: "" is the root, then "a", "a::b".
#[derive(Debug, Default)]
pub(crate) struct Modules(BTreeMap<String, Module>);

/// Where a path ends.
#[derive(Debug, Clone, PartialEq)]
enum End {
    Module(String),
    Item { file: String },
}

impl Modules {
    /// All that are reached from `lib.rs` or `main.rs` outside tests.
    pub(crate) fn of(files: &Files) -> Self {
        let top = ["lib.rs", "main.rs"];
        let top = top.into_iter().find(|name| files.contains_key(*name));
        let top = top.expect("a crate has a lib.rs or a main.rs");
        let mut modules = Self::default();
        modules.read(files, "", top);
        modules
    }

    /// The files they are in.
    pub(crate) fn files(&self) -> BTreeSet<&str> {
        self.0.values().map(|m| m.file.as_str()).collect()
    }

    fn read(&mut self, files: &Files, path: &str, file: &str) {
        let text = files.get(file);
        let text = text.unwrap_or_else(|| panic!("{path} is in no file {file}"));
        self.take(files, path, file, &without_tests(&tokens(text)));
    }

    /// Takes in what stands in a module, item by item.
    fn take(&mut self, files: &Files, path: &str, file: &str, tokens: &[String]) {
        let mut module = Module {
            file: file.into(),
            ..Module::default()
        };
        let mut i = 0;
        while i < tokens.len() {
            let next = tokens.get(i + 1).cloned().unwrap_or_default();
            match tokens[i].as_str() {
                "mod" => {
                    let child = join(path, &next);
                    if begins(&tokens[i + 2..], &["{"]) {
                        let end = after_group(tokens, i + 2);
                        self.take(files, &child, file, &tokens[i + 3..end - 1]);
                        i = end;
                    } else {
                        self.read(files, &child, &file_of(files, &child));
                        i += 3;
                    }
                }
                "fn" | "struct" | "enum" | "trait" | "type" | "const" | "static" | "union"
                    if is_word(&next) && next != "fn" && next != "unsafe" =>
                {
                    module.defines.insert(next);
                    i += 2;
                }
                "macro_rules" => {
                    module.defines.insert(tokens[i + 2].clone());
                    i += 3;
                }
                "use" => i = take_use(tokens, i, &mut module),
                "{" | "(" | "[" => {
                    let end = after_group(tokens, i);
                    take_code(&tokens[i..end], &mut module);
                    i = end;
                }
                _ => {
                    module.code.push(tokens[i].clone());
                    i += 1;
                }
            }
        }
        self.0.insert(path.into(), module);
    }

    /// Which file names something of which other.
    ///
    /// `mod x;` is no import, and a `pub use` of something in a module below is none either, unless the file itself has the
    /// name in its code. Methods are named without a path and do not count.
    pub(crate) fn imports(&self) -> Imports {
        let mut imports = Imports::new();
        for (path, module) in &self.0 {
            let mut names = |what: &[String]| {
                if let Some(End::Item { file }) = self.end_of(path, what, &mut Vec::new())
                    && file != module.file
                {
                    let from = imports.entry(module.file.clone()).or_default();
                    from.entry(file).or_insert_with(|| what.join("::"));
                }
            };
            for used in &module.uses {
                match self.end_of(path, &used.path, &mut Vec::new()) {
                    Some(End::Module(of)) if used.name == "*" => {
                        for word in module.code.iter().filter(|word| is_word(word)) {
                            if self.lookup(&of, word, &mut Vec::new()).is_some() {
                                names(&[&used.path[..], std::slice::from_ref(word)].concat());
                            }
                        }
                    }
                    _ if used.public && self.is_below(path, &used.path) => {
                        if module.code.contains(&used.name) {
                            names(&used.path);
                        }
                    }
                    _ => names(&used.path),
                }
            }
            for named in paths(&module.code) {
                names(&named);
            }
        }
        imports
    }

    /// Whether a path leads to a module below `module`.
    fn is_below(&self, module: &str, path: &[String]) -> bool {
        let parent = &path[..path.len() - 1];
        match self.end_of(module, parent, &mut Vec::new()) {
            Some(End::Module(of)) => of != module && of.starts_with(module),
            _ => false,
        }
    }

    /// Where a path ends that is written in `module`; `None` outside the crate.
    fn end_of(&self, module: &str, path: &[String], asked: &mut Vec<String>) -> Option<End> {
        let mut end = End::Module(module.into());
        for segment in path {
            let End::Module(here) = &end else {
                return Some(end);
            };
            end = match segment.as_str() {
                "crate" => End::Module(String::new()),
                "self" => continue,
                "super" => {
                    let parent = here.rsplit_once("::").map_or("", |(parent, _)| parent);
                    End::Module(parent.into())
                }
                name => self.lookup(here, name, asked)?,
            };
        }
        Some(end)
    }

    /// What a name is in a module.
    fn lookup(&self, module: &str, name: &str, asked: &mut Vec<String>) -> Option<End> {
        let here = self.0.get(module)?;
        if here.defines.contains(name) {
            let file = here.file.clone();
            return Some(End::Item { file });
        }
        let child = join(module, name);
        if self.0.contains_key(&child) {
            return Some(End::Module(child));
        }
        // A name may lead back to itself over two globs.
        if asked.contains(&child) {
            return None;
        }
        asked.push(child);
        let mut named = here.uses.iter().filter(|u| u.name == name);
        let named = named.find_map(|u| self.end_of(module, &u.path, asked));
        let mut globs = here.uses.iter().filter(|u| u.name == "*");
        let found = named.or_else(|| {
            globs.find_map(|u| match self.end_of(module, &u.path, asked) {
                Some(End::Module(of)) if of != module => self.lookup(&of, name, asked),
                _ => None,
            })
        });
        asked.pop();
        found
    }
}

fn join(module: &str, name: &str) -> String {
    match module {
        "" => name.into(),
        _ => format!("{module}::{name}"),
    }
}

fn file_of(files: &Files, module: &str) -> String {
    let path = module.replace("::", "/");
    let names = [format!("{path}.rs"), format!("{path}/mod.rs")];
    let found = names.iter().find(|name| files.contains_key(*name));
    found.unwrap_or(&names[0]).clone()
}

fn is_word(token: &str) -> bool {
    let first = token.chars().next();
    first.is_some_and(|c| c.is_alphabetic() || c == '_')
}

/// Takes in code, with the `use` declarations in it.
fn take_code(tokens: &[String], module: &mut Module) {
    let mut i = 0;
    while i < tokens.len() {
        let declares = i > 0 && ["{", "}", ";", "]"].contains(&tokens[i - 1].as_str());
        if tokens[i] == "use" && declares {
            i = take_use(tokens, i, module);
        } else {
            module.code.push(tokens[i].clone());
            i += 1;
        }
    }
}

/// Takes in the `use` declaration at `i`; returns what comes after it.
fn take_use(tokens: &[String], i: usize, module: &mut Module) -> usize {
    let end = i + tokens[i..]
        .iter()
        .position(|t| t == ";")
        .expect("a use ends");
    let before = &tokens[..i];
    let public = before.last().is_some_and(|t| t == "pub")
        || before.last().is_some_and(|t| t == ")")
            && before.iter().rev().take(6).any(|t| t == "pub");
    take_tree(&tokens[i + 1..end], &[], public, module);
    end + 1
}

/// `a::{b, c::d as e, self, *}`
fn take_tree(tree: &[String], prefix: &[String], public: bool, module: &mut Module) {
    let mut path = prefix.to_vec();
    let mut i = 0;
    while i < tree.len() {
        match tree[i].as_str() {
            "::" => i += 1,
            "{" => {
                let end = after_group(tree, i);
                for branch in branches(&tree[i + 1..end - 1]) {
                    take_tree(branch, &path, public, module);
                }
                return;
            }
            "as" => {
                let name = tree[i + 1].clone();
                module.uses.push(Use { name, path, public });
                return;
            }
            "*" => {
                let name = "*".into();
                module.uses.push(Use { name, path, public });
                return;
            }
            "self" if !path.is_empty() => i += 1,
            segment => {
                path.push(segment.into());
                i += 1;
            }
        }
    }
    let name = path.last().cloned().unwrap_or_default();
    module.uses.push(Use { name, path, public });
}

/// The parts between the commas.
fn branches(tree: &[String]) -> Vec<&[String]> {
    let (mut all, mut start, mut i) = (Vec::new(), 0, 0);
    while i < tree.len() {
        match tree[i].as_str() {
            "{" => i = after_group(tree, i),
            "," => {
                all.push(&tree[start..i]);
                i += 1;
                start = i;
            }
            _ => i += 1,
        }
    }
    all.push(&tree[start..]);
    all.retain(|branch| !branch.is_empty());
    all
}

/// Paths of two words and more.
fn paths(code: &[String]) -> Vec<Vec<String>> {
    let mut all = Vec::new();
    let mut i = 0;
    while i < code.len() {
        let mut path = Vec::new();
        if is_word(&code[i]) && (i == 0 || !["::", "."].contains(&code[i - 1].as_str())) {
            path.push(code[i].clone());
            while begins(&code[i + 1..], &["::"]) && code.get(i + 2).is_some_and(|t| is_word(t)) {
                path.push(code[i + 2].clone());
                i += 2;
            }
        }
        if path.len() > 1 {
            all.push(path);
        }
        i += 1;
    }
    all
}
