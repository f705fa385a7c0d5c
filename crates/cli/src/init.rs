//! `scopeservo init`: a commented description of an instrument, to be edited.

use crate::args::InitArgs;
use crate::error::CliError;
use scopeservo_setup::{SCHEMA, TEMPLATE, TWIN_TEMPLATE};
use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};

pub(crate) fn run(args: &InitArgs) -> Result<bool, CliError> {
    if args.schema {
        say!("{}", SCHEMA.trim_end());
        return Ok(true);
    }
    let path = &args.file;
    let text = if args.twin { TWIN_TEMPLATE } else { TEMPLATE };
    let file = OpenOptions::new().write(true).create_new(true).open(path);
    let written = file.and_then(|mut file| file.write_all(text.as_bytes()));
    match written {
        Ok(()) => {}
        Err(e) if e.kind() == ErrorKind::AlreadyExists => {
            return Err(CliError::Usage(format!(
                "{} is there already and is not overwritten: move it away, or name another file",
                path.display()
            )));
        }
        Err(source) => {
            return Err(CliError::Write {
                path: path.clone(),
                source,
            });
        }
    }
    say!("wrote {}", path.display());
    say!(
        "{}",
        match args.twin {
            true => "next: scopeservo calibrate",
            false => "next: describe your instrument in it, then: scopeservo doctor",
        }
    );
    Ok(true)
}
