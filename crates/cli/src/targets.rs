//! `target list`, `show`, `note`, `rename`, `remove`, `restore`, `purge`, `export` and `import`: what is done with saved views without an instrument.

use crate::answer::Answer;
use crate::args::{
    TargetExportArgs, TargetImportArgs, TargetListArgs, TargetNoteArgs, TargetPurgeArgs,
    TargetRemoveArgs, TargetRenameArgs, TargetRestoreArgs, TargetShowArgs,
};
use crate::commands::library_of;
use crate::error::{CliError, shell};
use crate::{output, runs};
use scopeservo_library::{
    KeptTarget, Label, Purged, RunQuery, TargetQuery, TargetRow, Targets as _,
};
use scopeservo_protocol::Place;
use serde_json::{Value, json};
use std::path::Path;

/// So many visits are told of a target.
const VISITS: usize = 10;

pub(crate) fn list_targets(args: &TargetListArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description, answer)?;
    let rows = library.find_targets(&TargetQuery {
        text: args.text.as_deref().unwrap_or_default(),
        slide: args.slide.as_deref(),
        binned: args.bin,
        ..TargetQuery::default()
    })?;
    answer.put(json!({"targets": []}));
    if rows.is_empty() {
        let wanted = args.text.is_some() || args.slide.is_some();
        match (args.bin, wanted) {
            (true, _) => say!(answer, "nothing lies in the bin"),
            (false, true) => say!(
                answer,
                "no target is like that: scopeservo target list tells all"
            ),
            (false, false) => say!(
                answer,
                "no target is saved yet: scopeservo target save NAME"
            ),
        }
    }
    for row in rows {
        // One that is damaged does not keep the others away.
        if let Some(wrong) = library.target_is_damaged(&row) {
            answer.or_warn::<()>(Err(wrong));
            continue;
        }
        let TargetRow { name, label, .. } = &row;
        say!(
            answer,
            "{name:24} {:8} {:5} features  {:5} {}  {}{}",
            row.objective,
            row.features,
            row.quality
                .as_ref()
                .map_or("?".into(), |q| format!("{:.0} %", 100.0 * q.chance)),
            row.saved,
            row.instrument,
            label
                .slide
                .as_ref()
                .map_or(String::new(), |slide| format!("  on {slide}")),
        );
        let mut entry = keys(&row);
        if args.long {
            let kept = library.target_in(&row)?;
            let file = library.target_file(&row);
            if !label.note.is_empty() {
                say!(answer, "    {}", label.note);
            }
            say!(answer, "    stage at {}", kept.stage);
            say!(answer, "    {}, {}", scale(&kept), file.display());
            extend(&mut entry, long(&kept, &file));
        }
        answer.push("targets", entry);
    }
    Ok(true)
}

/// What is told of each target.
fn keys(row: &TargetRow) -> Value {
    let mut keys = json!({
        "name": row.name,
        "saved": row.saved,
        "instrument": row.instrument,
        "objective": row.objective,
        "features": row.features,
        "quality": row.quality.as_ref().map(output::quality),
        "slide": row.label.slide,
        "note": row.label.note,
    });
    if let Some(binned) = &row.binned {
        keys["removed"] = json!(binned);
    }
    keys
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
    let library = library_of(&args.kept.description, answer)?;
    let row = library.target_row(&args.name)?;
    let kept = library.target_in(&row)?;
    let file = library.target_file(&row);
    let visits = library.runs(&RunQuery {
        limit: VISITS,
        target: Some(&args.name),
        ..RunQuery::default()
    })?;
    let mut entry = keys(&row);
    entry["visits"] = json!(visits);
    extend(&mut entry, long(&kept, &file));
    answer.put(entry);
    say!(answer, "{}", args.name);
    say!(answer, "  saved      {} on {}", kept.saved, kept.instrument);
    if let Some(slide) = &row.label.slide {
        say!(answer, "  slide      {slide}");
    }
    if !row.label.note.is_empty() {
        say!(answer, "  note       {}", row.label.note);
    }
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
    for visit in &visits {
        say!(answer, "  {}  {}", visit.id, runs::outcome(visit));
    }
    Ok(true)
}

pub(crate) fn note_target(args: &TargetNoteArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description, answer)?;
    let before = library.target_label(&args.name)?;
    let label = Label {
        note: args.text.clone().unwrap_or(before.note),
        slide: match (args.no_slide, &args.slide) {
            (true, _) => None,
            (false, Some(slide)) => Some(slide.clone()),
            (false, None) => before.slide,
        },
    };
    library.label_target(&args.name, &label)?;
    answer.put(json!({"name": args.name, "slide": label.slide, "note": label.note}));
    let on = label
        .slide
        .map_or(String::new(), |slide| format!(", on slide {slide}"));
    say!(answer, "'{}'{on}: {}", args.name, label.note);
    Ok(true)
}

pub(crate) fn restore_target(args: &TargetRestoreArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description, answer)?;
    library.restore_target(&args.name, args.to.as_deref())?;
    let name = args.to.as_deref().unwrap_or(&args.name);
    answer.put(json!({"restored": name}));
    say!(answer, "'{name}' is there again");
    Ok(true)
}

pub(crate) fn purge_targets(args: &TargetPurgeArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description, answer)?;
    let names = (!args.all).then_some(args.names.as_slice());
    let purged = library.purge_targets(names)?;
    answer.put(json!({"purged": purged}));
    if purged.is_empty() {
        say!(answer, "nothing lies in the bin");
    }
    for Purged { name, runs } in &purged {
        say!(
            answer,
            "'{name}' is deleted for good, with {} runs",
            runs.len()
        );
    }
    Ok(true)
}

pub(crate) fn rename_target(args: &TargetRenameArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description, answer)?;
    let file = library.rename_target(&args.name, &args.to)?;
    answer.put(json!({"name": args.to, "before": args.name, "file": file.to_string_lossy()}));
    say!(answer, "'{}' is '{}' now", args.name, args.to);
    Ok(true)
}

pub(crate) fn remove_targets(args: &TargetRemoveArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description, answer)?;
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
            "'{name}' is in the bin. Back again: scopeservo target restore {}; for good: scopeservo target purge {}",
            shell(name),
            shell(name)
        );
    }
    Ok(true)
}

pub(crate) fn export_target(args: &TargetExportArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description, answer)?;
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
    let library = library_of(&args.kept.description, answer)?;
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
