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

/// A length with its standard deviation, both with the digits that this leaves; without one where it is no number.
pub(crate) fn um_within(value: f64, sigma: f64) -> String {
    within(value, sigma).map_or_else(|| um(value), |text| format!("{text} µm"))
}

/// The same of an angle.
pub(crate) fn deg_within(value: f64, sigma: f64) -> String {
    within(value, sigma).map_or_else(|| deg(value), |text| format!("{text}°"))
}

/// Two significant digits of the standard deviation, four decimals at most.
fn within(value: f64, sigma: f64) -> Option<String> {
    if !(sigma.is_finite() && sigma > 0.0 && value.is_finite()) {
        return None;
    }
    let decimals = (1.0 - sigma.log10().floor()).clamp(0.0, 4.0) as usize;
    let known = match fixed(sigma, decimals) {
        none if none.bytes().all(|b| matches!(b, b'0' | b'.')) => "0.0001".into(),
        known => known,
    };
    Some(format!("{} ± {known}", fixed(value, decimals)))
}

/// Text of the program with the units of print. Events are written in ASCII; a page need not be.
pub(crate) fn units(text: &str) -> String {
    let mut out = String::with_capacity(text.len() + 8);
    let mut words = text.split(' ').peekable();
    let mut after_number = false;
    while let Some(word) = words.next() {
        let stem = word.trim_end_matches([',', '.', ';', ':', ')', '?', '!']);
        let tail = &word[stem.len()..];
        match stem {
            "um" => out.push_str(&format!("µm{tail}")),
            "deg" if after_number => {
                out.pop();
                out.push_str(&format!("°{tail}"));
            }
            _ => match word.strip_prefix('-') {
                Some(rest) if rest.starts_with(|c: char| c.is_ascii_digit()) => {
                    out.push_str(&format!("\u{2212}{rest}"));
                }
                _ => out.push_str(word),
            },
        }
        after_number = word.ends_with(|c: char| c.is_ascii_digit());
        if words.peek().is_some() {
            out.push(' ');
        }
    }
    out
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
    fn units_are_those_of_print_and_words_stay() {
        assert_eq!(
            units("3 um and -0.5 deg off, from 0.25 um"),
            "3 µm and \u{2212}0.5° off, from 0.25 µm"
        );
        assert_eq!(units("within 7 um, 2 deg."), "within 7 µm, 2°.");
        assert_eq!(
            units("--lambda 0.2, album 3, a deg of freedom, x-1"),
            "--lambda 0.2, album 3, a deg of freedom, x-1"
        );
    }

    #[test]
    fn numbers_have_the_digits_that_matter() {
        assert_eq!(fixed(-0.001, 2), "0.00");
        assert_eq!(fixed(-1.5, 1), "\u{2212}1.5");
        assert_eq!(fixed(f64::NAN, 1), "–");
        assert_eq!(um(0.4237), "0.42 µm");
        assert_eq!(um_within(0.0642, 0.0271), "0.064 ± 0.027 µm");
        assert_eq!(um_within(12.34, 3.1), "12.3 ± 3.1 µm");
        assert_eq!(um_within(0.4237, f64::NAN), "0.42 µm");
        assert_eq!(deg_within(0.00012, 0.00037), "0.0001 ± 0.0004°");
        assert_eq!(deg_within(0.0, 0.000004), "0.0000 ± 0.0001°");
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
