//! `target list`, `show`, `rename`, `remove`, `export` and `import`: what is done with saved views without an instrument.

use crate::answer::Answer;
use crate::args::{
    TargetExportArgs, TargetImportArgs, TargetListArgs, TargetRemoveArgs, TargetRenameArgs,
    TargetShowArgs,
};
use crate::commands::library_of;
use crate::error::{CliError, shell};
use crate::output;
use scopeservo_library::{KeptTarget, Targets as _};
use scopeservo_protocol::Place;
use serde_json::{Value, json};
use std::path::Path;

pub(crate) fn list_targets(args: &TargetListArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description)?;
    let names = library.target_names()?;
    answer.put(json!({"targets": []}));
    if names.is_empty() {
        say!(
            answer,
            "no target is saved yet: scopeservo target save NAME"
        );
    }
    for name in names {
        // One that is damaged does not keep the others away.
        let Some(kept) = answer.or_warn(library.target(&name)) else {
            continue;
        };
        let quality = kept.target.quality.as_ref();
        say!(
            answer,
            "{name:24} {:8} {:5} features  {:5} {}  {}",
            kept.target.objective.0,
            kept.target.features.len(),
            quality.map_or("?".into(), |q| format!("{:.0} %", 100.0 * q.chance)),
            kept.saved,
            kept.instrument
        );
        let mut entry = keys(&name, &kept);
        if args.long {
            let file = library.target_path(&name)?;
            say!(answer, "    stage at {}", kept.stage);
            say!(answer, "    {}, {}", scale(&kept), file.display());
            extend(&mut entry, long(&kept, &file));
        }
        answer.push("targets", entry);
    }
    Ok(true)
}

/// What is told of each target.
fn keys(name: &str, kept: &KeptTarget) -> Value {
    json!({
        "name": name,
        "saved": kept.saved,
        "instrument": kept.instrument,
        "objective": kept.target.objective,
        "features": kept.target.features.len(),
        "quality": kept.target.quality.as_ref().map(output::quality),
    })
}

/// What is told besides when somebody wants to know more.
fn long(kept: &KeptTarget, file: &Path) -> Value {
    let taken = kept.target.taken.as_deref();
    json!({
        "id": kept.id,
        "file": file.to_string_lossy(),
        "stage": Place::from(&kept.stage),
        "um_per_px": taken.map(|t| t.um_per_px),
        "size_px": [kept.target.features.width, kept.target.features.height],
        "moved": kept.target.moved,
        "calibrated": taken.map(|t| t.calibration.is_some()),
        "exposure_ms": taken.map(|t| t.frame.exposure.as_secs_f64() * 1e3),
    })
}

fn extend(entry: &mut Value, more: Value) {
    if let (Value::Object(entry), Value::Object(more)) = (entry, more) {
        entry.extend(more);
    }
}

/// The size of its pixels, in words.
fn scale(kept: &KeptTarget) -> String {
    let features = &kept.target.features;
    let size = format!("{} x {} px", features.width, features.height);
    match kept.target.taken.as_deref() {
        Some(taken) => {
            let by = match taken.calibration {
                Some(_) => "calibrated",
                None => "as engraved",
            };
            format!("{size} of {:.4} um, {by}", taken.um_per_px)
        }
        None => size,
    }
}

pub(crate) fn show_target(args: &TargetShowArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description)?;
    let kept = library.target(&args.name)?;
    let file = library.target_path(&args.name)?;
    let mut entry = keys(&args.name, &kept);
    extend(&mut entry, long(&kept, &file));
    answer.put(entry);
    say!(answer, "{}", args.name);
    say!(answer, "  saved      {} on {}", kept.saved, kept.instrument);
    say!(answer, "  objective  {}", kept.target.objective);
    say!(answer, "  stage      {}", kept.stage);
    say!(answer, "  image      {}", scale(&kept));
    let moved = match kept.target.moved {
        Some(moved) => format!("{moved} of them were seen to move with the stage"),
        None => "nothing was moved to see which belong to the specimen".into(),
    };
    say!(
        answer,
        "  features   {}, {moved}",
        kept.target.features.len()
    );
    match &kept.target.quality {
        Some(quality) => say!(
            answer,
            "  coming back is expected in {:.0} % of runs: it {quality}",
            100.0 * quality.chance
        ),
        None => say!(
            answer,
            "  coming back: not predicted, by an earlier version"
        ),
    }
    say!(answer, "  file       {}", file.display());
    if !kept.id.is_empty() {
        say!(answer, "  id         {}", kept.id);
    }
    Ok(true)
}

pub(crate) fn rename_target(args: &TargetRenameArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description)?;
    let file = library.rename_target(&args.name, &args.to)?;
    answer.put(json!({"name": args.to, "before": args.name, "file": file.to_string_lossy()}));
    say!(answer, "'{}' is '{}' now", args.name, args.to);
    Ok(true)
}

pub(crate) fn remove_targets(args: &TargetRemoveArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description)?;
    // All are there before any goes.
    for name in &args.names {
        library.target_path(name)?;
    }
    answer.put(json!({"removed": []}));
    for name in &args.names {
        let file = library.remove_target(name)?;
        answer.push(
            "removed",
            json!({"name": name, "file": file.to_string_lossy()}),
        );
        say!(
            answer,
            "'{name}' is removed. Back again: scopeservo target import {} --name {name}",
            shell(&file.to_string_lossy())
        );
    }
    Ok(true)
}

pub(crate) fn export_target(args: &TargetExportArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description)?;
    library.export_target(&args.name, &args.file)?;
    answer.put(json!({"name": args.name, "file": args.file.to_string_lossy()}));
    say!(
        answer,
        "'{}' is in {}: take it in elsewhere with scopeservo target import {}",
        args.name,
        args.file.display(),
        args.file.display()
    );
    Ok(true)
}

pub(crate) fn import_target(args: &TargetImportArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description)?;
    let stem = || Some(args.file.file_stem()?.to_string_lossy().into_owned());
    let name = args.name.clone().or_else(stem).unwrap_or_default();
    let kept = library.import_target(&args.file, &name)?;
    answer.put(json!({
        "name": name,
        "objective": kept.target.objective,
        "features": kept.target.features.len(),
        "instrument": kept.instrument,
    }));
    say!(
        answer,
        "took in '{name}': {} of {}, {} features, saved {}",
        kept.target.objective,
        kept.instrument,
        kept.target.features.len(),
        kept.saved
    );
    Ok(true)
}
