//! `scopeservo completions` and `scopeservo man`: made of the grammar of the command line, so that they say what the program takes.

use crate::answer::Answer;
use crate::args::{Cli, CompletionsArgs, ManArgs};
use crate::error::CliError;
use clap::CommandFactory as _;
use scopeservo_library::files::{make_folder, replace};
use std::io;
use std::path::Path;

const NAME: &str = "scopeservo";

pub(crate) fn completions(args: &CompletionsArgs, answer: &Answer) -> Result<bool, CliError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), NAME, &mut script);
    say!(answer, "{}", String::from_utf8_lossy(&script).trim_end());
    Ok(true)
}

pub(crate) fn pages(args: &ManArgs, answer: &Answer) -> Result<bool, CliError> {
    let made = pages_of(Cli::command());
    let Some(folder) = &args.out else {
        let first = made.map_err(|e| CliError::Internal(e.to_string()))?;
        let page = first.first().map(|(_, page)| page.as_slice());
        let page = String::from_utf8_lossy(page.unwrap_or_default());
        say!(answer, "{}", page.trim_end());
        return Ok(true);
    };
    let made = made.map_err(|e| CliError::Internal(e.to_string()))?;
    make_folder(folder).map_err(cannot_write(folder))?;
    for (name, page) in &made {
        let file = folder.join(name);
        replace(&file, page).map_err(cannot_write(&file))?;
    }
    say!(answer, "wrote {} pages to {}", made.len(), folder.display());
    Ok(true)
}

fn cannot_write(path: &Path) -> impl FnOnce(io::Error) -> CliError {
    let path = path.to_path_buf();
    |source| CliError::CannotWrite {
        path,
        source,
        instead: "give another folder with --out",
    }
}

/// The pages of a command and of all below it, its own first: the name of each file, and what it holds.
fn pages_of(command: clap::Command) -> io::Result<Vec<(String, Vec<u8>)>> {
    let mut command = command.disable_help_subcommand(true);
    command.build();
    let mut all = Vec::new();
    add(&command, &mut all)?;
    Ok(all)
}

fn add(command: &clap::Command, all: &mut Vec<(String, Vec<u8>)>) -> io::Result<()> {
    let page = clap_mangen::Man::new(command.clone());
    let mut bytes = Vec::new();
    page.render(&mut bytes)?;
    all.push((page.get_filename(), bytes));
    let below = command.get_subcommands().filter(|c| !c.is_hide_set());
    below.into_iter().try_for_each(|c| add(c, all))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_is_a_page_for_every_command() {
        let pages = pages_of(Cli::command()).unwrap();
        let page = |name: &str| {
            let found = pages.iter().find(|(file, _)| file == name);
            let (_, bytes) = found.unwrap_or_else(|| panic!("no {name}"));
            String::from_utf8(bytes.clone()).unwrap()
        };
        assert_eq!(pages[0].0, "scopeservo.1");
        for (file, word) in [
            ("scopeservo.1", "Brings a motorised microscope back"),
            ("scopeservo-reposition.1", "within"),
            (
                "scopeservo-target-rename.1",
                "Give a saved target another name",
            ),
            ("scopeservo-stage-go.1", "Goals are places of the stage"),
        ] {
            assert!(page(file).contains(word), "{file}");
        }
    }

    #[test]
    fn every_shell_completes_every_command() {
        for shell in [
            clap_complete::Shell::Bash,
            clap_complete::Shell::Zsh,
            clap_complete::Shell::Fish,
            clap_complete::Shell::PowerShell,
        ] {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), NAME, &mut script);
            let script = String::from_utf8(script).unwrap();
            for command in Cli::command().get_subcommands() {
                assert!(
                    script.contains(command.get_name()),
                    "{shell} {}",
                    command.get_name()
                );
            }
        }
    }
}
