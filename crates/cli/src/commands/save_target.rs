//! `scopeservo target save`.

use super::{known_calibrations, library_of};
use crate::answer::Answer;
use crate::args::TargetSaveArgs;
use crate::error::{CliError, Code};
use crate::open_instrument::OpenInstrument;
use crate::output;
use crate::progress::Watcher;
use scopeservo_library::{Label, NewTarget, Targets as _, check_slide};
use scopeservo_scope::ObjectiveId;
use scopeservo_servo::{Event, Target};
use scopeservo_station::jobs::{SaveTargetJob, SaveTargetOutput};
use scopeservo_workbench::{Asked, label_of};
use serde_json::json;

pub(crate) fn save_target(args: &TargetSaveArgs, answer: &Answer) -> Result<bool, CliError> {
    let focusing = args.focusing.options()?;
    let library = library_of(&args.instrument.description, answer)?;
    library.check_new_target(&args.name)?;
    args.slide.as_deref().map_or(Ok(()), check_slide)?;
    let opened = OpenInstrument::open(&args.instrument, answer)?;
    opened.check_nothing_waits()?;
    let objective = args.objective.clone().map(ObjectiveId);
    let known = known_calibrations(&opened, answer);
    let focus = (focusing, args.focus);
    let input = opened.usual().save(objective, focus, args.still, known);
    let asked = Asked {
        inputs: json!({"name": args.name, "slide": args.slide, "note": args.note, "input": input}),
        ..Asked::default()
    };
    run(
        &opened,
        &args.name,
        SaveTargetJob::new(input),
        asked,
        answer,
    )
}

/// Runs the job, from its beginning or from where it was.
pub(super) fn run(
    opened: &OpenInstrument,
    name: &str,
    job: SaveTargetJob,
    asked: Asked,
    answer: &Answer,
) -> Result<bool, CliError> {
    let before = opened.scope.flat_field();
    let label = label_of(&asked.inputs);
    let mut watcher = Watcher::new(None);
    let ran = opened.run(job, asked, &mut watcher, answer)?;
    warn_of_blur(&watcher, answer);
    let kept = match &ran.output {
        Ok(output) => keep(opened, (name, &label), output, answer),
        Err(_) => Ok(()),
    };
    let seen = opened.scope.flat_field();
    if let Some(shadows) = seen.filter(|now| Some(now) != before.as_ref()) {
        say!(
            answer,
            "  {} shadows lie on the camera: they are divided out of what it shows from now on. Better still, clean it",
            shadows.shadows()
        );
    }
    ran.end(None, answer)?;
    kept.map(|()| true)
}

/// A blurred view is told also where it was refused: that may be why.
fn warn_of_blur(watcher: &Watcher, answer: &Answer) {
    for stamped in watcher.recorder.events() {
        if let Event::Blurred {
            objective,
            sharper_by_um,
            features,
            features_there,
        } = &stamped.event
        {
            let way = match *sharper_by_um < 0.0 {
                true => "lower",
                false => "higher",
            };
            let what = format!(
                "the view is blurred: with {objective} it is sharpest {:.0} um {way}, with {:.1} times the features. Save it with --focus",
                sharper_by_um.abs(),
                *features_there as f64 / (*features).max(1) as f64,
            );
            answer.warn(Code::Blurred, what);
        }
    }
}

/// The program was killed after the target was kept, and before it said so.
pub(super) fn was_kept(
    opened: &OpenInstrument,
    name: &str,
    answer: &Answer,
) -> Result<bool, CliError> {
    let target = opened.library.target(name)?.target;
    tell(name, &target, opened, answer);
    let file = opened.library.target_path(name)?;
    answer.put(json!({"file": file.to_string_lossy()}));
    say!(answer, "'{name}' was saved before the program ended");
    opened.end_left()?;
    Ok(true)
}

fn tell(name: &str, target: &Target, opened: &OpenInstrument, answer: &Answer) {
    answer.put(json!({
        "name": name,
        "objective": target.objective,
        "features": target.features.len(),
        "moved_features": target.moved,
        "quality": target.quality.as_ref().map(output::quality),
        "shadows": opened.scope.flat_field().map_or(0, |seen| seen.shadows()),
    }));
}

fn keep(
    opened: &OpenInstrument,
    (name, label): (&str, &Label),
    output: &SaveTargetOutput,
    answer: &Answer,
) -> Result<(), CliError> {
    let SaveTargetOutput {
        target,
        stage,
        frame,
    } = output;
    let (features, moved) = (target.features.len(), target.moved);
    let no_picture = || CliError::Internal("the target has no image".into());
    let frame = frame.as_ref().ok_or_else(no_picture)?;
    tell(name, target, opened, answer);
    let instrument = &opened.config.name;
    let library = &opened.library;
    let file = library.keep_target(NewTarget {
        name,
        instrument,
        stage: *stage,
        target: target.clone(),
        frame,
        label,
    })?;
    answer.put(json!({"file": file.to_string_lossy(), "slide": label.slide, "note": label.note}));
    match moved {
        Some(moved) => say!(
            answer,
            "saved '{name}' at {}: {features} features, {moved} of them seen to move with the stage",
            target.objective
        ),
        None => say!(
            answer,
            "saved '{name}' at {}: {features} features. Nothing was moved, so nobody knows which of them are on the camera: the run must \
             prove it, by a step aside where its own moves do not",
            target.objective
        ),
    }
    if let Some(quality) = &target.quality {
        say!(answer, "  it {quality}");
    }
    if let Some(slide) = &label.slide {
        say!(answer, "  on slide {slide}");
    }
    say!(answer, "  come back with: scopeservo reposition {name}");
    Ok(())
}
