//! `target list`, `target export` and `target import`: what is done with saved views without an instrument.

use crate::answer::Answer;
use crate::args::{TargetExportArgs, TargetImportArgs, TargetListArgs};
use crate::commands::library_of;
use crate::error::CliError;
use crate::output;
use scopeservo_library::Targets as _;
use serde_json::json;

pub(crate) fn list_targets(args: &TargetListArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.description)?;
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
        let entry = json!({
            "name": name,
            "saved": kept.saved,
            "instrument": kept.instrument,
            "objective": kept.target.objective,
            "features": kept.target.features.len(),
            "quality": quality.map(output::quality),
        });
        answer.push("targets", entry);
    }
    Ok(true)
}

pub(crate) fn export_target(args: &TargetExportArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.description)?;
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
    let library = library_of(&args.description)?;
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
