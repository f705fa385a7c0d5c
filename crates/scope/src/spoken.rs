//! Measured amounts in words: what rounds to nothing is less than the last place that is told, as nothing is known to nothing.

/// An amount of that unit to so many decimals, such as `0.26 um`, or `less than 0.01 um`. Its sign is told where it is negative and there is something to
/// tell.
fn amount(value: f64, decimals: usize, unit: &str) -> String {
    let text = format!("{value:.decimals$}");
    match text.bytes().any(|b| matches!(b, b'1'..=b'9')) || !value.is_finite() {
        true => format!("{text} {unit}"),
        false => format!(
            "less than {:.decimals$} {unit}",
            0.1_f64.powi(decimals as i32)
        ),
    }
}

/// How far something is off, has moved or scatters, um, to so many decimals.
pub fn um_in_words(um: f64, decimals: usize) -> String {
    amount(um, decimals, "um")
}

/// How far something is turned, degrees, to so many decimals.
pub fn deg_in_words(deg: f64, decimals: usize) -> String {
    amount(deg, decimals, "deg")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_rounds_to_nothing_is_less_than_the_last_place() {
        for (um, decimals, words) in [
            (0.2649, 2, "0.26 um"),
            (0.005_01, 2, "0.01 um"),
            (0.004_9, 2, "less than 0.01 um"),
            (0.0, 2, "less than 0.01 um"),
            (-0.001, 2, "less than 0.01 um"),
            (-0.3, 1, "-0.3 um"),
            (0.04, 1, "less than 0.1 um"),
            (0.3, 0, "less than 1 um"),
            (177.049, 2, "177.05 um"),
            (f64::NAN, 2, "NaN um"),
        ] {
            assert_eq!(um_in_words(um, decimals), words);
        }
        for (deg, words) in [
            (0.000_04, "less than 0.0001 deg"),
            (0.000_06, "0.0001 deg"),
            (4.003, "4.0030 deg"),
        ] {
            assert_eq!(deg_in_words(deg, 4), words);
        }
    }
}
