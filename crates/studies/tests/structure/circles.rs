//! Circles of imports.

use crate::modules::Imports;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// The files on a shortest way from one to another, both ends included; of a file to itself, a shortest circle, its end left out.
pub(crate) fn way(imports: &Imports, from: &str, to: &str) -> Option<Vec<String>> {
    let mut came_from: BTreeMap<&str, &str> = BTreeMap::new();
    let mut open = VecDeque::from([from]);
    while let Some(here) = open.pop_front() {
        for next in imports.get(here).into_iter().flat_map(BTreeMap::keys) {
            if next == to {
                let mut way: Vec<&str> = Vec::from_iter((from != to).then_some(to));
                way.push(here);
                while let Some(before) = way.last().and_then(|at| came_from.get(at)) {
                    way.push(before);
                }
                way.reverse();
                return Some(way.into_iter().map(String::from).collect());
            }
            if next != from && !came_from.contains_key(next.as_str()) {
                came_from.insert(next, here);
                open.push_back(next);
            }
        }
    }
    None
}

/// Circles in which files import each other: a shortest one through each file that lies on any, each once and from its first file on.
pub(crate) fn circles(imports: &Imports) -> BTreeSet<Vec<String>> {
    let shortest = imports.keys().filter_map(|file| way(imports, file, file));
    let from_the_first = shortest.map(|mut circle| {
        let first = circle
            .iter()
            .min()
            .and_then(|first| circle.iter().position(|f| f == first));
        circle.rotate_left(first.unwrap_or(0));
        circle
    });
    from_the_first.collect()
}

/// A circle in words, with a name that each file takes from the next.
pub(crate) fn told(circle: &[String], imports: &Imports) -> String {
    let nexts = circle.iter().cycle().skip(1);
    let steps = circle.iter().zip(nexts).map(|(file, next)| {
        let name = &imports[file][next];
        format!("{file} uses {name} of {next}")
    });
    steps.collect::<Vec<_>>().join(", ")
}
