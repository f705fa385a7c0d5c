//! `scopeservo init`: a commented description of an instrument, to be edited.

use crate::answer::Answer;
use crate::args::InitArgs;
use crate::error::CliError;
use scopeservo_library::files::write_new;
use scopeservo_setup::{TEMPLATE, TWIN_TEMPLATE, schema};

pub(crate) fn run(args: &InitArgs, answer: &Answer) -> Result<bool, CliError> {
    if args.schema {
        say!(answer, "{}", schema().trim_end());
        return Ok(true);
    }
    let path = &args.file;
    let text = if args.twin { TWIN_TEMPLATE } else { TEMPLATE };
    match write_new(path, text.as_bytes()) {
        Ok(true) => {}
        Ok(false) => {
            return Err(CliError::Usage(format!(
                "{} is there already and is not overwritten: move it away, or name another file",
                path.display()
            )));
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
        match args.twin {
            true => "next: scopeservo calibrate",
            false => "next: describe your instrument in it, then: scopeservo doctor",
        }
    );
    Ok(true)
}
