//! What devices say of themselves, as it may be shown to people.

/// Longer names and messages than this are cut, characters.
const MOST: usize = 500;

/// A device's words for people: control characters, and those that hide in a text or turn it round, are written as their codes, so that none
/// reaches a terminal; what is longer than a paragraph is cut.
pub fn visible(text: &str) -> String {
    let mut shown = String::with_capacity(text.len().min(4 * MOST));
    for (count, c) in text.chars().enumerate() {
        if count == MOST {
            shown.push_str(" ...");
            break;
        }
        match c.is_control() || hides(c) {
            true => shown.extend(c.escape_default()),
            false => shown.push(c),
        }
    }
    shown
}

/// Marks of direction, of joining, and ends of lines that are no control characters.
fn hides(c: char) -> bool {
    matches!(c, '\u{61c}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_devices_say_is_shown_and_commands_no_terminal() {
        for plain in ["Acme XY", "µm, Größe, 顕微鏡", "", "C:\\temp"] {
            assert_eq!(visible(plain), plain);
        }
        for (text, shown) in [
            ("\x1b[2J\x1b]0;mine\x07x", r"\u{1b}[2J\u{1b}]0;mine\u{7}x"),
            ("two\nlines\tand\r", r"two\nlines\tand\r"),
            ("\u{9b}2J\u{7f}\0", r"\u{9b}2J\u{7f}\u{0}"),
            (
                "a\u{202e}b\u{200b}c\u{2028}",
                r"a\u{202e}b\u{200b}c\u{2028}",
            ),
        ] {
            assert_eq!(visible(text), shown);
        }
    }

    #[test]
    fn what_is_endless_is_cut() {
        assert_eq!(visible(&"n".repeat(MOST)), "n".repeat(MOST));
        let cut = visible(&"n".repeat(50_000));
        assert_eq!(cut, format!("{} ...", "n".repeat(MOST)));
    }
}
