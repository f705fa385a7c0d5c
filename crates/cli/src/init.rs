//! `scopeservo init`: a commented description of an instrument, to be edited.

use crate::answer::Answer;
use crate::args::InitArgs;
use crate::error::CliError;
use crate::interview::Interview;
use crate::nearby::{self, Nearby};
use scopeservo_library::files::write_new;
use scopeservo_setup::{Config, TEMPLATE, TWIN_TEMPLATE, schema};
use std::path::Path;

pub(crate) fn run(args: &InitArgs, answer: &Answer) -> Result<bool, CliError> {
    if args.schema {
        say!(answer, "{}", schema().trim_end());
        return Ok(true);
    }
    let path = &args.file;
    // Before anybody answers questions for nothing.
    if args.ask && path.symlink_metadata().is_ok() {
        return Err(there_already(path));
    }
    let text = match (args.twin, args.ask) {
        (true, _) => TWIN_TEMPLATE.into(),
        (false, true) => asked(path)?,
        (false, false) => template(answer),
    };
    match write_new(path, text.as_bytes()) {
        Ok(true) => {}
        Ok(false) => {
            return Err(there_already(path));
        }
        Err(source) => {
            return Err(CliError::CannotWrite {
                path: path.clone(),
                source,
                instead: "name another file",
            });
        }
    }
    say!(answer, "wrote {}", path.display());
    say!(
        answer,
        "{}",
        match (args.twin, args.ask) {
            (true, _) => "next: scopeservo calibrate",
            (false, true) => "next: look through it, then: scopeservo doctor",
            (false, false) => "next: describe your instrument in it, then: scopeservo doctor",
        }
    );
    Ok(true)
}

fn there_already(path: &Path) -> CliError {
    CliError::Usage(format!(
        "{} is there already and is not overwritten: move it away, or name another file",
        path.display()
    ))
}

/// A commented description, with what is connected here.
fn template(answer: &Answer) -> String {
    let root = Path::new("/");
    let (ports, cameras) = (nearby::serial_ports(root), nearby::cameras(root));
    for (kind, all) in [("serial port", &ports), ("video device", &cameras)] {
        for Nearby { path, what } in all {
            say!(answer, "found a {kind}: {path} ({what})");
        }
    }
    let found = nearby::comments(&ports, &cameras);
    TEMPLATE.replacen("[drivers.main]", &format!("{found}[drivers.main]"), 1)
}

/// What follows from the answers of whoever sits here.
fn asked(path: &Path) -> Result<String, CliError> {
    let root = Path::new("/");
    let (ports, cameras) = (nearby::serial_ports(root), nearby::cameras(root));
    let mut lines = std::io::stdin().lock();
    let show = |line: &str| tell!("{line}");
    let mut interview = Interview::new(&mut lines, &show, &ports, &cameras);
    let text = interview.description()?;
    // What cannot be an instrument is not written.
    Config::parse(&text, path).map_err(|error| {
        CliError::Usage(format!(
            "from these answers no instrument follows, and nothing was written: {error}"
        ))
    })?;
    Ok(text)
}
