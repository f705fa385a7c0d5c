//! What things are called on disk, and when they were made.

use crate::LibraryError;
use crate::files::checksum;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// Names that some systems give to devices, whatever follows a dot.
const DEVICES: [&str; 4] = ["CON", "PRN", "AUX", "NUL"];
/// With it a file's name stays within what every file system takes.
const LONGEST_NAME: usize = 100;

/// Whether some systems have a device of that name, whatever follows a dot.
fn is_device(name: &str) -> bool {
    let stem = name.split('.').next().unwrap_or(name).to_ascii_uppercase();
    let port = |s: &str| {
        let number = s.strip_prefix("COM").or_else(|| s.strip_prefix("LPT"));
        number.is_some_and(|n| n.len() == 1 && n.chars().all(|c| c.is_ascii_digit()))
    };
    DEVICES.contains(&stem.as_str()) || port(&stem)
}

/// Refuses a name that no target can have.
pub(crate) fn plain_name(name: &str) -> Result<(), LibraryError> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    if name.is_empty() || name.starts_with('.') || !name.chars().all(plain) {
        return Err(LibraryError::BadName(format!(
            "'{name}' is no name for a target: use letters, digits, '-', '_' and '.', like mitosis-3"
        )));
    }
    Ok(())
}

/// No slide has a longer name, characters.
const LONGEST_SLIDE: usize = 200;

/// Refuses a name that nobody could read on a slide.
///
/// # Errors
/// [`LibraryError::BadName`].
pub fn check_slide(name: &str) -> Result<(), LibraryError> {
    let fits = (1..=LONGEST_SLIDE).contains(&name.chars().count());
    match fits && name.trim() == name && !name.chars().any(char::is_control) {
        true => Ok(()),
        false => Err(LibraryError::BadName(format!(
            "{name:?} is no name for a slide: use up to {LONGEST_SLIDE} characters on one line, without blanks at its ends, like 17-B"
        ))),
    }
}

/// Refuses a name under which a target could not be found again: on another system, or by a command line.
pub(crate) fn check_name(name: &str) -> Result<(), LibraryError> {
    let why = if name.len() > LONGEST_NAME {
        format!("it has more than {LONGEST_NAME} characters")
    } else if name.starts_with('-') {
        "a command would take it for an option".into()
    } else if name.ends_with('.') {
        "some systems drop a dot at the end".into()
    } else if is_device(name) {
        "some systems have a device of that name".into()
    } else {
        return Ok(());
    };
    Err(LibraryError::BadName(format!(
        "this target could not be found again everywhere under the name '{}': {why}. Give another, like mitosis-3",
        name.chars().take(LONGEST_NAME).collect::<String>()
    )))
}

/// The last number that files are given.
const LAST: u64 = 999_999_999;

/// The number after the `last` one that is taken; `None` when none is left.
pub(crate) fn next_number(last: Option<u64>) -> Option<u64> {
    let next = last.unwrap_or(0) + 1;
    (next <= LAST).then_some(next)
}

/// The number before a file's time; 0 for one without, and for one that no counting comes to.
pub(crate) fn number_of(path: &Path) -> u64 {
    let stem = path.file_stem().and_then(|s| s.to_str());
    let number = stem.and_then(|s| s.split_once('_')).map(|(n, _)| n.parse());
    let counted = number.and_then(Result::ok).filter(|n| *n <= LAST);
    counted.unwrap_or(0)
}

/// A name as a file's: what is no letter or digit as its number, so that two names are never one file where case counts. One that would be a
/// device's, or is longer than file systems take, ends in its checksum.
pub(crate) fn file_name(name: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    let whole: String = name
        .chars()
        .map(|c| match plain(c) {
            true => c.to_string(),
            false => format!("%{:x}", u32::from(c)),
        })
        .collect();
    match whole.len() > LONGEST_NAME || is_device(&whole) || whole.is_empty() {
        true => {
            let begins: String = whole.chars().take(LONGEST_NAME / 2).collect();
            format!("{begins}%{}", &checksum(name.as_bytes())[..16])
        }
        false => whole,
    }
}

/// The name whose file is called so, where that can be told: a number in it may end anywhere.
pub(crate) fn name_of(file: &str) -> Option<String> {
    (!file.is_empty() && !file.contains('%')).then(|| file.into())
}

/// A moment in UTC, to the second: 2026-11-24T20:15:00Z.
pub fn utc(at: SystemTime) -> String {
    let seconds = at.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    // Days since 0000-03-01, in eras of 400 years (Hinnant, "chrono-compatible low-level date algorithms").
    let z = days + 719_468;
    let (era, day_of_era) = (z / 146_097, z % 146_097);
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = (month_from_march + 2) % 12 + 1;
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    let (h, m, s) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!("{year:04}-{month:02}-{day:02}T{h:02}:{m:02}:{s:02}Z")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn times_are_those_of_the_calendar() {
        for (seconds, text) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_399, "2000-02-28T23:59:59Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_709_251_199, "2024-02-29T23:59:59Z"),
            (1_795_551_300, "2026-11-24T20:15:00Z"),
            (4_107_542_400, "2100-03-01T00:00:00Z"),
        ] {
            assert_eq!(utc(UNIX_EPOCH + Duration::from_secs(seconds)), text);
        }
    }

    #[test]
    fn a_name_that_could_not_be_found_again_is_refused() {
        let long = "a".repeat(251);
        for bad in [
            "-rf", "--json", "a.", "CON", "con.", "nul.json", "com1", &long,
        ] {
            assert!(check_name(bad).is_err(), "{bad}");
        }
        for good in ["t1", "mitosis-3.b_2", "console", "COM10", "com"] {
            assert!(check_name(good).is_ok(), "{good}");
        }
    }

    #[test]
    fn what_things_are_called_on_disk_is_a_name_everywhere_and_their_own() {
        let long = "ö".repeat(200);
        let longer = format!("{long}x");
        let names = [
            "40x",
            "40X",
            "Plan 40x/0.65",
            "CON",
            "con",
            "nul",
            "COM1",
            "..",
            ".",
            "",
            "-rf",
            "a.",
            "a ",
            "mikroskop \u{1f52c}",
            "e\u{301}",
            "\u{e9}",
            "a\u{7}b",
            "a/b",
            "a\\b",
            &long,
            &longer,
        ];
        let mut files: Vec<String> = names.iter().map(|name| file_name(name)).collect();
        for (name, file) in names.iter().zip(&files) {
            let portable = |c: char| c.is_ascii_alphanumeric() || "-_%".contains(c);
            assert!(
                file.chars().all(portable) && (1..=120).contains(&file.len()),
                "{name:?}: {file}"
            );
            assert!(!is_device(file), "{name:?}: {file}");
        }
        assert_eq!(files[2], "Plan%2040x%2f0%2e65");
        files.sort();
        files.dedup();
        assert_eq!(files.len(), names.len());
    }

    #[test]
    fn a_number_that_no_counting_comes_to_is_none() {
        assert_eq!(number_of(Path::new("000042_2026.json")), 42);
        for none in [
            "2026-11-24.json",
            "18446744073709551615_x.json",
            "18446744073709551616_x.json",
            "1000000000_x.json",
            "-1_x.json",
            "x_1.json",
        ] {
            assert_eq!(number_of(Path::new(none)), 0, "{none}");
        }
        assert_eq!(next_number(None), Some(1));
        assert_eq!(next_number(Some(41)), Some(42));
        assert_eq!(next_number(Some(LAST - 1)), Some(LAST));
        assert_eq!(next_number(Some(LAST)), None);
    }
}
