//! The page as a whole.

use crate::picture::Gallery;
use crate::recorder::SHOWN_ITERATIONS;
use crate::story::Story;
use crate::text::escape;
use crate::{Context, Recorder, Truth};
use crate::{answer, calibration, focus, making, matches, views};
use scopeservo_servo::Verdict;
use std::fmt::Write as _;

const STYLE: &str = include_str!("style.css");

/// All that the parts of the page read.
pub(crate) struct Report<'a> {
    pub(crate) story: Story<'a>,
    pub(crate) gallery: Gallery,
    pub(crate) truth: Option<&'a Truth>,
    pub(crate) context: &'a Context,
}

impl Report<'_> {
    /// Columns and rows of the target, as good as known: its picture's, else those of its calibration.
    pub(crate) fn target_size(&self) -> Option<[f64; 2]> {
        let picture = self.gallery.size("target").map(|(w, h)| [w, h]);
        picture.or_else(|| {
            let calibration = self.story.target_calibration()?;
            Some(calibration.image_size_px.map(|v| v as f64))
        })
    }

    /// What the simulation knows of a frame.
    pub(crate) fn true_at(&self, sequence: u64) -> Option<&crate::TrueIteration> {
        self.truth?
            .iterations
            .iter()
            .find(|t| t.sequence == sequence)
    }
}

/// The name of a view in the gallery.
pub(crate) fn view_name(sequence: u64) -> String {
    format!("view{sequence}")
}

/// The whole page.
///
/// `truth` is what a simulation knows and a microscope does not; without it the page says how the error was estimated.
pub fn html(recorder: &Recorder, truth: Option<&Truth>, context: &Context) -> String {
    let story = Story::read(recorder.events());
    let gallery = gallery(recorder, &story);
    let report = Report {
        story,
        gallery,
        truth,
        context,
    };
    let title = match context.title.as_str() {
        "" => "A repositioning run",
        title => title,
    };
    let mut out = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n\
         <meta name=\"color-scheme\" content=\"light dark\"/>\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'\"/>\n\
         <title>{}: {}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n",
        escape(verdict_word(&report.story)),
        escape(title)
    );
    out.push_str(&answer::section(&report, title));
    let parts = [
        ("The way there", views::section(&report)),
        ("What was recognised", matches::section(&report)),
        ("Focus", focus::section(&report)),
        ("Calibration", calibration::section(&report)),
        ("Where the time went", making::time(&report)),
        ("How this was made", making::section(&report)),
    ];
    for (i, (heading, body)) in parts.iter().enumerate() {
        let _ = write!(
            out,
            "<section aria-labelledby=\"h{i}\">\n<h2 id=\"h{i}\">{heading}</h2>\n{body}</section>\n"
        );
    }
    out.push_str("</main>\n");
    out.push_str(&report.gallery.embed());
    out.push_str("</body>\n</html>\n");
    out
}

/// The answer in a word or two.
pub(crate) fn verdict_word(story: &Story<'_>) -> &'static str {
    match story.outcome.map(|o| o.verdict) {
        Some(Verdict::Arrived) => "Arrived",
        Some(Verdict::NotFound) => "Not found",
        Some(Verdict::Refused) => "Refused",
        Some(Verdict::Ambiguous) => "Ambiguous",
        None => "Unfinished",
    }
}

/// The pictures that the page shows.
fn gallery(recorder: &Recorder, story: &Story<'_>) -> Gallery {
    let mut gallery = Gallery::default();
    if let Some(jpeg) = recorder.target().and_then(|t| t.jpeg()) {
        gallery.add("target", jpeg);
    }
    for magnification in &story.magnifications {
        let frames = magnification.frames();
        let last = frames.last().map(|f| f.1);
        for (iteration, sequence) in frames {
            if (SHOWN_ITERATIONS.contains(&iteration) || last == Some(sequence))
                && let Some(jpeg) = recorder.view(sequence)
            {
                gallery.add(view_name(sequence), jpeg);
            }
        }
    }
    let same_objective = story.magnifications.last().map(|m| m.objective) == story.target_objective;
    if let (true, Some(target), Some((_, view))) =
        (same_objective, recorder.target(), recorder.last_view())
        && let Some(jpeg) = target.blend(view).and_then(|b| b.jpeg())
    {
        gallery.add("blend", jpeg);
    }
    if story.magnifications.is_empty() {
        let unfocused = story.sweeps.last().is_some_and(|s| s.result.is_none());
        let (name, picture) = if unfocused {
            ("sharpest", recorder.sharpest())
        } else {
            ("newest", recorder.newest())
        };
        if let Some(jpeg) = picture.and_then(|p| p.jpeg()) {
            gallery.add(name, jpeg);
        }
    }
    gallery
}
