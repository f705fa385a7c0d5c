//! `library check`, `backup`, `restore`, `export` and `rebuild`: looking after what is kept.

use crate::answer::Answer;
use crate::args::{
    LibraryBackupArgs, LibraryCheckArgs, LibraryExportArgs, LibraryRebuildArgs, LibraryRestoreArgs,
};
use crate::bar::Parts;
use crate::commands::library_of;
use crate::error::{CliError, Code};
use scopeservo_library::{Database, restore as unpack};
use scopeservo_setup::Config;
use serde_json::json;

fn in_gb(bytes: u64) -> String {
    match bytes {
        0..1_000_000 => format!("{:.0} kB", bytes as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.0} MB", bytes as f64 / 1e6),
        _ => format!("{:.1} GB", bytes as f64 / 1e9),
    }
}

pub(crate) fn check(args: &LibraryCheckArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description, answer)?;
    let shown = Parts::new("reading all that was kept");
    let checked = library.check(args.repair, &mut |done, all| shown.done(done, all));
    drop(shown);
    let checked = checked?;
    answer.put(json!(checked));
    say!(
        answer,
        "{} targets, {} calibrations and the like, {} runs with {} events; {} files of {}",
        checked.targets,
        checked.measurements,
        checked.runs,
        checked.events,
        checked.objects,
        in_gb(checked.bytes)
    );
    for fault in &checked.faults {
        answer.warn(Code::Damaged, fault);
    }
    match (checked.litter.len(), checked.mended) {
        (0, _) => {}
        (n, true) => say!(answer, "{n} files that killed programs left are removed"),
        (n, false) => say!(
            answer,
            "{n} files were left by killed programs: scopeservo library check --repair removes them"
        ),
    }
    if checked.faults.is_empty() {
        say!(answer, "all of it is as it was kept");
    } else {
        say!(
            answer,
            "what is damaged comes back from a backup only; the rest is as it was kept"
        );
    }
    Ok(checked.faults.is_empty())
}

pub(crate) fn back_up(args: &LibraryBackupArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description, answer)?;
    let shown = Parts::new("copying");
    let done = library.back_up(&args.file, &mut |done, all| shown.done(done, all));
    drop(shown);
    let done = done?;
    answer.put(json!({"file": args.file.to_string_lossy(), "backup": done}));
    for missing in &done.missing {
        answer.warn(Code::Damaged, missing);
    }
    say!(
        answer,
        "{} holds the library, {}: bring it back with scopeservo library restore",
        args.file.display(),
        in_gb(done.bytes)
    );
    Ok(done.missing.is_empty())
}

pub(crate) fn restore(args: &LibraryRestoreArgs, answer: &Answer) -> Result<bool, CliError> {
    let config = Config::read(&args.kept.description.config)?;
    let folder = config.resolve(&config.data_folder);
    let brought = unpack(&args.file, &folder, args.without_sums)?;
    let files = brought.objects;
    answer.put(json!({
        "folder": folder.to_string_lossy(),
        "files": files,
        "missing": brought.missing,
        "summed": brought.summed,
    }));
    say!(
        answer,
        "the library is in {}, with {files} files",
        folder.display()
    );
    if !brought.summed {
        say!(
            answer,
            "the backup told no sums: nobody knows whether all that was in it is there"
        );
    }
    if !brought.missing.is_empty() {
        let what = format!(
            "{} files are not in the backup, of which the library knows: scopeservo library check tells whose they are",
            brought.missing.len()
        );
        answer.warn(Code::Damaged, what);
    }
    Ok(brought.missing.is_empty())
}

pub(crate) fn export(args: &LibraryExportArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description, answer)?;
    let shown = Parts::new("writing");
    let done = library.export(&args.folder, &mut |done, all| shown.done(done, all));
    drop(shown);
    let done = done?;
    answer.put(json!({"folder": args.folder.to_string_lossy(), "exported": done}));
    let whole = done.left.is_empty();
    say!(
        answer,
        "{} targets, {} calibrations and the like, {} runs and {} pictures are in {} as plain files",
        done.targets,
        done.measurements,
        done.runs,
        done.pictures,
        args.folder.display()
    );
    for left in done.left {
        answer.or_warn::<()>(Err(left));
    }
    Ok(whole)
}

pub(crate) fn rebuild(args: &LibraryRebuildArgs, answer: &Answer) -> Result<bool, CliError> {
    let config = Config::read(&args.kept.description.config)?;
    let library = Database::new(config.resolve(&config.data_folder));
    let shown = Parts::new("reading the files");
    let done = library.rebuild(&mut |done, all| shown.done(done, all));
    drop(shown);
    let done = done?;
    answer.put(json!(done));
    say!(
        answer,
        "found {} targets and {} calibrations and the like. Notes, slides, later names and runs are gone; what lay in the bin is back",
        done.targets.len(),
        done.measurements
    );
    Ok(true)
}
