//! What documents and help texts tell people to type is what the program takes.

#[path = "../../tests/common/page.rs"]
#[expect(
    unreachable_pub,
    dead_code,
    reason = "the tests that run the program use it too"
)]
mod page;

use super::Cli;
use clap::error::ErrorKind;
use clap::{Command, CommandFactory, Parser};
use std::collections::BTreeSet;

/// Where people read commands.
const PAGES: [&str; 12] = [
    "README.md",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "CONVENTIONS.md",
    "SECURITY.md",
    "docs/adding-a-device.md",
    "docs/answers.md",
    "docs/driver-protocol.md",
    "docs/hardware.md",
    "docs/measured.md",
    "docs/troubleshooting.md",
    "python/README.md",
];

/// The words of a command line, without its quotes.
fn words(line: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut quote = None;
    for c in line.chars() {
        match (c, quote) {
            ('\'' | '"', None) => quote = Some(c),
            (c, Some(q)) if c == q => quote = None,
            (c, None) if c.is_whitespace() => words.push(String::new()),
            (c, _) => {
                if let Some(last) = words.last_mut() {
                    last.push(c);
                }
            }
        }
    }
    words.retain(|w| !w.is_empty());
    words
}

/// Why the program does not take it; a name without all that must follow it is one that it knows.
fn misfit(command: &str) -> Option<String> {
    let command = page::filled(command).replace("scopeservo COMMAND", "scopeservo doctor");
    let error = Cli::try_parse_from(words(&command)).err()?;
    let known = [
        ErrorKind::DisplayHelp,
        ErrorKind::DisplayVersion,
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand,
        ErrorKind::MissingRequiredArgument,
        ErrorKind::MissingSubcommand,
    ];
    (!known.contains(&error.kind())).then(|| format!("{command}: {error}"))
}

fn options_of(command: &Command, into: &mut BTreeSet<String>) {
    into.extend(
        command
            .get_arguments()
            .filter_map(|a| a.get_long().map(str::to_owned)),
    );
    into.extend(["help", "version"].map(str::to_owned));
    command.get_subcommands().for_each(|c| options_of(c, into));
}

/// The examples at the end of each command's help.
fn examples_of(command: &Command, into: &mut Vec<String>) {
    let help = command.get_after_help().map(ToString::to_string);
    // What an example does stands two blanks or more after it.
    let lines = help.iter().flat_map(|help| help.lines());
    let lines = lines.map(|line| {
        line.trim()
            .split("  ")
            .next()
            .unwrap_or_default()
            .to_owned()
    });
    into.extend(lines.flat_map(|line| page::commands(&line)));
    command.get_subcommands().for_each(|c| examples_of(c, into));
}

#[test]
fn what_the_program_does_not_know_no_page_and_no_help_names() {
    let mut all = Vec::new();
    for name in PAGES {
        let text = page::page(name);
        for fence in page::fences(&text) {
            all.extend(page::commands(&fence.body));
        }
        let inline = page::inline(&text).into_iter();
        all.extend(inline.flat_map(|code| page::commands(&code)));
    }
    let of_pages = all.len();
    examples_of(&Cli::command(), &mut all);
    assert!(
        of_pages > 40 && all.len() > of_pages + 40,
        "{of_pages} {}",
        all.len()
    );
    let misfits: Vec<String> = all.iter().filter_map(|c| misfit(c)).collect();
    assert!(misfits.is_empty(), "{misfits:#?}");
    // That it would be noticed.
    for wrong in [
        "scopeservo calibrat",
        "scopeservo reposition mitosis-3 --metod paper",
        "scopeservo target shows mitosis-3",
        "scopeservo stage go --x-um far",
    ] {
        assert!(misfit(wrong).is_some(), "{wrong}");
    }
}

#[test]
fn every_option_that_a_page_names_is_one() {
    let mut known = BTreeSet::new();
    options_of(&Cli::command(), &mut known);
    let mut seen = 0;
    for name in [
        "README.md",
        "docs/troubleshooting.md",
        "docs/answers.md",
        "docs/adding-a-device.md",
    ] {
        for code in page::inline(&page::page(name)) {
            let Some(option) = code.strip_prefix("--") else {
                continue;
            };
            let end = option.find(|c: char| !c.is_ascii_alphanumeric() && c != '-');
            let option = &option[..end.unwrap_or(option.len())];
            assert!(known.contains(option), "{name}: --{option}");
            seen += 1;
        }
    }
    assert!(seen > 30, "{seen}");
}
