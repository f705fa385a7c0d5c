//! Text for people: escaping and numbers with sensible digits.

/// Safe as HTML text and inside a double-quoted attribute.
pub(crate) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c if c.is_control() && c != '\n' => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

/// The same for a sentence that was written in ASCII, as events are: a page has one sign for each unit.
pub(crate) fn prose(text: &str) -> String {
    escape(&units(text))
}

/// " um" and " deg" behind a number or a word as their signs.
pub(crate) fn units(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while !rest.is_empty() {
        let sign = [(" um", " µm"), (" deg", "°")]
            .into_iter()
            .find(|(ascii, _)| {
                let after = rest.strip_prefix(ascii).map(|r| r.chars().next());
                after.is_some_and(|c| !c.is_some_and(|c| c.is_alphanumeric() || c == '_'))
            });
        match sign {
            Some((ascii, sign)) => {
                out.push_str(sign);
                rest = &rest[ascii.len()..];
            }
            None => {
                let one = rest.chars().next().map_or(0, char::len_utf8);
                out.push_str(&rest[..one]);
                rest = &rest[one..];
            }
        }
    }
    out
}

/// A number with this many decimals and a true minus sign; a dash when it is not a number.
pub(crate) fn fixed(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "–".into();
    }
    let digits = format!("{:.decimals$}", value.abs());
    let zero = digits.bytes().all(|b| matches!(b, b'0' | b'.'));
    if value < 0.0 && !zero {
        format!("\u{2212}{digits}")
    } else {
        digits
    }
}

/// A number with about three significant digits.
pub(crate) fn short(value: f64) -> String {
    let size = value.abs();
    let decimals = match size {
        s if s >= 100.0 => 0,
        s if s >= 10.0 => 1,
        s if s >= 0.095 => 2,
        s if s >= 0.0095 => 3,
        0.0 => 0,
        _ => 4,
    };
    fixed(value, decimals)
}

/// A length in micrometres, or in millimetres from 10 mm on.
pub(crate) fn um(value: f64) -> String {
    if value.abs() >= 10_000.0 {
        format!("{} mm", short(value / 1000.0))
    } else {
        format!("{} µm", short(value))
    }
}

/// An angle in degrees.
pub(crate) fn deg(value: f64) -> String {
    let decimals = if value.abs() >= 10.0 {
        1
    } else if value.abs() >= 0.1 {
        2
    } else {
        4
    };
    format!("{}°", fixed(value, decimals))
}

/// A duration.
pub(crate) fn seconds(value: f64) -> String {
    if value >= 120.0 {
        let whole = value.round();
        format!("{} min {:02} s", (whole / 60.0).floor(), whole % 60.0)
    } else if value >= 10.0 || value == 0.0 {
        format!("{} s", fixed(value, 0))
    } else {
        format!("{} s", fixed(value, 1))
    }
}

/// "1 frame", "2 frames".
pub(crate) fn count(n: usize, one: &str) -> String {
    let s = if n == 1 { "" } else { "s" };
    format!("{} {one}{s}", group(n as f64, 0))
}

/// A number with thin spaces between groups of three digits.
pub(crate) fn group(value: f64, decimals: usize) -> String {
    let plain = fixed(value, decimals);
    let (whole, rest) = plain.split_once('.').map_or((&*plain, ""), |(w, r)| (w, r));
    let digits = whole.chars().filter(char::is_ascii_digit).count();
    let mut out = String::new();
    let mut left = digits;
    for c in whole.chars() {
        if c.is_ascii_digit() {
            if left != digits && left % 3 == 0 && digits > 4 {
                out.push('\u{202f}');
            }
            left -= 1;
        }
        out.push(c);
    }
    if !rest.is_empty() {
        out.push('.');
        out.push_str(rest);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_is_harmless() {
        assert_eq!(
            escape("<a b=\"c\">&'"),
            "&lt;a b=&quot;c&quot;&gt;&amp;&#39;"
        );
        assert_eq!(escape("a\u{0}b"), "a b");
    }

    #[test]
    fn a_sentence_has_the_signs_of_its_units_and_a_command_keeps_its_words() {
        for (ascii, shown) in [
            ("0.36 um off", "0.36 µm off"),
            ("by 2 um", "by 2 µm"),
            ("(-40 to 40 um), 3 deg.", "(-40 to 40 µm), 3°."),
            ("0.5 um; 1 deg/s", "0.5 µm; 1°/s"),
            ("rz = 0.01 deg", "rz = 0.01°"),
            (
                "um_per_px, --within-um 2, an umbrella, a degree",
                "um_per_px, --within-um 2, an umbrella, a degree",
            ),
            ("\u{1f52c} um", "\u{1f52c} µm"),
        ] {
            assert_eq!(units(ascii), shown);
        }
    }

    #[test]
    fn numbers_have_the_digits_that_matter() {
        assert_eq!(fixed(-0.001, 2), "0.00");
        assert_eq!(fixed(-1.5, 1), "\u{2212}1.5");
        assert_eq!(fixed(f64::NAN, 1), "–");
        assert_eq!(um(0.4237), "0.42 µm");
        assert_eq!(um(0.0421), "0.042 µm");
        assert_eq!(um(1234.4), "1234 µm");
        assert_eq!(um(125_403.1), "125 mm");
        assert_eq!(deg(0.00312), "0.0031°");
        assert_eq!(seconds(154.0), "2 min 34 s");
        assert_eq!(group(-1_953_155.0, 0), "\u{2212}1\u{202f}953\u{202f}155");
        assert_eq!(group(1234.5, 1), "1234.5");
        assert_eq!(count(1, "frame"), "1 frame");
    }
}
