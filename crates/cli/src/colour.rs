//! Verdicts in colour, for people at a terminal who did not ask for none (`NO_COLOR`, `TERM=dumb`, `CLICOLOR=0`; `CLICOLOR_FORCE=1` colours what
//! goes elsewhere, too).

use anstream::{AutoStream, ColorChoice};
use anstyle::{AnsiColor, Style};
use scopeservo_servo::Verdict;

/// What became of what was hoped for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Hope {
    /// It came.
    Held,
    /// Something has to be done soon, or somebody has to look.
    Partly,
    /// It did not come.
    Failed,
}

impl From<Verdict> for Hope {
    fn from(verdict: Verdict) -> Self {
        match verdict {
            Verdict::Arrived => Self::Held,
            Verdict::Ambiguous => Self::Partly,
            Verdict::NotFound | Verdict::Refused => Self::Failed,
        }
    }
}

/// A verdict as it goes to stdout.
pub(crate) fn verdict(word: &str, hope: Hope) -> String {
    painted(word, hope, AutoStream::choice(&std::io::stdout()))
}

fn painted(word: &str, hope: Hope, choice: ColorChoice) -> String {
    let colour = match hope {
        Hope::Held => AnsiColor::Green,
        Hope::Partly => AnsiColor::Yellow,
        Hope::Failed => AnsiColor::Red,
    };
    let style = Style::new().fg_color(Some(colour.into())).bold();
    match choice {
        ColorChoice::Never => word.into(),
        _ => format!("{style}{word}{style:#}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_verdict_has_a_colour_where_colours_are_wanted_and_its_words_alone_elsewhere() {
        for (word, hope, code) in [
            ("arrived", Hope::Held, "32"),
            ("ambiguous", Hope::Partly, "33"),
            ("not found", Hope::Failed, "31"),
        ] {
            assert_eq!(painted(word, hope, ColorChoice::Never), word);
            let shown = painted(word, hope, ColorChoice::Always);
            assert!(shown.contains(code) && shown.contains(word), "{shown:?}");
            assert!(
                shown.starts_with('\u{1b}') && shown.ends_with("[0m"),
                "{shown:?}"
            );
        }
    }
}
