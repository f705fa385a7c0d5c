//! `scopeservo status`, `scopeservo snap` and `scopeservo objective`: single steps, through the gate like everything else.

use crate::answer::Answer;
use crate::args::{ObjectiveArgs, SnapArgs, StatusArgs};
use crate::bar;
use crate::beginning;
use crate::error::CliError;
use crate::open_instrument::OpenInstrument;
use scopeservo_library::files::{try_folder, write_new};
use scopeservo_library::{LibraryError, Targets as _, png_of};
use scopeservo_protocol::Place;
use scopeservo_scope::{Axis, Motion, ObjectiveId};
use serde_json::json;
use std::path::Path;

pub(crate) fn status(args: &StatusArgs, answer: &Answer) -> Result<bool, CliError> {
    let opened = OpenInstrument::look(&args.instrument, answer)?;
    let (scope, gate) = (&opened.scope, opened.scope.gate());
    let homed = gate.is_homed()?;
    let at = gate.position()?;
    let moves = gate.poll()? == Motion::Moving;
    let objective = gate.current_objective()?;
    let exposure_ms = scope.camera().exposure()?.as_secs_f64() * 1e3;
    let level = scope.light().map(|light| light.level()).transpose()?;
    let outside = gate.check(&at).err().map(|error| error.to_string());
    let info = scope.camera().info();
    let targets = opened.library.target_names()?.len();
    answer.put(json!({
        "instrument": opened.config.name,
        "simulated": opened.is_simulated(),
        "at": Place::from(&at),
        "homed": homed,
        "moves": moves,
        "outside": outside,
        "objective": objective,
        "objectives": gate.objectives().iter().map(|o| &o.id).collect::<Vec<_>>(),
        "camera": {"name": info.name, "width": info.width, "height": info.height, "exposure_ms": exposure_ms},
        "light": level,
        "targets": targets,
    }));
    let simulated = match opened.is_simulated() {
        true => " (simulated)",
        false => "",
    };
    say!(answer, "{}{simulated}", opened.config.name);
    let state = match (homed, moves) {
        (false, _) => ", and does not know where it is: it has to be homed (--home)",
        (_, true) => ", and moves",
        _ => "",
    };
    say!(answer, "  stage      {at}{state}");
    if let Some(what) = outside.filter(|_| homed) {
        say!(answer, "             outside of where it may be: {what}");
    }
    let known = match gate.objective_is_reported() {
        true => ", as was said and not seen",
        false => "",
    };
    let all: Vec<&str> = gate.objectives().iter().map(|o| o.id.0.as_str()).collect();
    match &objective {
        Some(id) => say!(answer, "  objective  {id}{known}, of {}", all.join(", ")),
        None => say!(answer, "  objective  unknown, one of {}", all.join(", ")),
    }
    say!(
        answer,
        "  camera     {}, {} x {}, {exposure_ms:.3} ms",
        info.name,
        info.width,
        info.height
    );
    if let Some(level) = level {
        say!(answer, "  light      {level:.3}");
    }
    say!(
        answer,
        "  kept       {targets} targets in {}",
        opened.library.path().display()
    );
    opened.tell_what_waits(answer);
    Ok(true)
}

pub(crate) fn snap(args: &SnapArgs, answer: &Answer) -> Result<bool, CliError> {
    check_file(&args.file)?;
    let opened = OpenInstrument::look(&args.instrument, answer)?;
    let frame = opened.scope.grab()?;
    let objective = opened.scope.gate().current_objective()?;
    let at = opened.scope.gate().position()?;
    let bytes = png_of(&frame)?;
    match write_new(&args.file, &bytes) {
        Ok(true) => {}
        Ok(false) => return Err(there_already(&args.file)),
        Err(error) => return Err(LibraryError::not_kept(&args.file)(error).into()),
    }
    answer.put(json!({
        "file": args.file.to_string_lossy(),
        "width": frame.width,
        "height": frame.height,
        "bit_depth": frame.bit_depth,
        "exposure_ms": frame.exposure.as_secs_f64() * 1e3,
        "objective": objective,
        "at": Place::from(&at),
    }));
    say!(
        answer,
        "wrote {}: {} x {}, {} bit{}, at {at}",
        args.file.display(),
        frame.width,
        frame.height,
        frame.bit_depth,
        objective.map_or(String::new(), |id| format!(", {id}"))
    );
    Ok(true)
}

/// Before anything is opened.
fn check_file(file: &Path) -> Result<(), CliError> {
    let is_png = file
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("png"));
    if !is_png {
        return Err(CliError::Usage(format!(
            "{} must end in .png, which is what is written",
            file.display()
        )));
    }
    if file.symlink_metadata().is_ok() {
        return Err(there_already(file));
    }
    let folder = file.parent().filter(|f| !f.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    let tried = match folder.is_dir() {
        true => try_folder(folder),
        false => Err(std::io::ErrorKind::NotFound.into()),
    };
    tried.map_err(|source| CliError::CannotWrite {
        path: folder.into(),
        source,
        instead: "name a file in another folder",
    })
}

fn there_already(file: &Path) -> CliError {
    CliError::Usage(format!(
        "{} is there already and is not overwritten: move it away, or name another file",
        file.display()
    ))
}

pub(crate) fn objective(args: &ObjectiveArgs, answer: &Answer) -> Result<bool, CliError> {
    let Some(name) = &args.objective else {
        let opened = OpenInstrument::look(&args.instrument, answer)?;
        let gate = opened.scope.gate();
        let current = gate.current_objective()?;
        let all: Vec<&str> = gate.objectives().iter().map(|o| o.id.0.as_str()).collect();
        answer.put(json!({"objective": current, "objectives": all}));
        match &current {
            Some(id) => say!(answer, "{id} is in; there are {}", all.join(", ")),
            None => say!(
                answer,
                "which one is in is not known; there are {}",
                all.join(", ")
            ),
        }
        return Ok(true);
    };
    let id = ObjectiveId(name.clone());
    let opened = OpenInstrument::open(&args.instrument, answer)?;
    opened.tell_what_waits(answer);
    opened.scope.objective(&id)?;
    let shown = bar::spinner(format!("changing to {id}"));
    let changed = opened.scope.select_objective(&id);
    shown.finish_and_clear();
    if let Err(error) = changed {
        beginning::tell(&opened.scope, answer);
        return Err(error.into());
    }
    let at = opened.scope.gate().position()?;
    answer.put(json!({"objective": id, "at": Place::from(&at)}));
    let z = at
        .si(Axis::Z)
        .map_or(String::new(), |z| format!(", z = {:.1} um", z * 1e6));
    say!(answer, "{id} is in{z}");
    Ok(true)
}
