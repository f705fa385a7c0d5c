//! Rust as far as names go: words and punctuation, without comments, texts and tests.

/// Words and numbers whole, `::` whole, other punctuation character by character. Comments are left out; of literal texts
/// only an empty one stays.
pub(crate) fn tokens(source: &str) -> Vec<String> {
    let chars: Vec<char> = source.chars().collect();
    let at = |i: usize| chars.get(i).copied().unwrap_or('\0');
    let mut out = Vec::new();
    let mut i = 0;
    while i < chars.len() {
        let c = at(i);
        if c == '/' && at(i + 1) == '/' {
            while i < chars.len() && at(i) != '\n' {
                i += 1;
            }
        } else if c == '/' && at(i + 1) == '*' {
            i = after_comment(&chars, i);
        } else if let Some(end) = after_text(&chars, i) {
            out.push("\"\"".into());
            i = end;
        } else if c.is_alphanumeric() || c == '_' {
            let start = i;
            while at(i).is_alphanumeric() || at(i) == '_' {
                i += 1;
            }
            out.push(chars[start..i].iter().collect());
        } else if c == ':' && at(i + 1) == ':' {
            out.push("::".into());
            i += 2;
        } else {
            if !c.is_whitespace() {
                out.push(c.into());
            }
            i += 1;
        }
    }
    out
}

/// Behind the comment that begins at `i`; such comments nest.
fn after_comment(chars: &[char], mut i: usize) -> usize {
    let mut depth = 0;
    while i < chars.len() {
        match (chars[i], chars.get(i + 1)) {
            ('/', Some('*')) => depth += 1,
            ('*', Some('/')) => depth -= 1,
            _ => {
                i += 1;
                continue;
            }
        }
        i += 2;
        if depth == 0 {
            break;
        }
    }
    i
}

/// Behind the string or character that begins at `i`, if one does. A lifetime is none.
fn after_text(chars: &[char], i: usize) -> Option<usize> {
    let at = |i: usize| chars.get(i).copied().unwrap_or('\0');
    let mut open = i;
    // b"", c"", r"", br#""#
    while "bcr".contains(at(open)) && open < i + 2 {
        open += 1;
    }
    let raw = chars[i..open].contains(&'r');
    let mut hashes = 0;
    while raw && at(open + hashes) == '#' {
        hashes += 1;
    }
    open += hashes;
    let follows_a_word = i > 0 && (at(i - 1).is_alphanumeric() || at(i - 1) == '_');
    match at(open) {
        '"' if open == i || !follows_a_word => {}
        '\'' if open == i && at(i + 1) == '\\' => {}
        '\'' if open == i && at(i + 2) == '\'' => return Some(i + 3),
        _ => return None,
    }
    let quote = at(open);
    let mut end = open + 1;
    while end < chars.len() {
        if at(end) == '\\' && !raw {
            end += 2;
        } else if at(end) == quote && (1..=hashes).all(|k| at(end + k) == '#') {
            return Some(end + 1 + hashes);
        } else {
            end += 1;
        }
    }
    Some(end)
}

/// What is left without items, fields and statements under `#[cfg(test)]`; nothing of a file that is a test as a whole.
pub(crate) fn without_tests(tokens: &[String]) -> Vec<String> {
    let mut out = Vec::new();
    let mut i = 0;
    while i < tokens.len() {
        if begins(&tokens[i..], &["#", "!", "[", "cfg", "(", "test", ")", "]"]) {
            return Vec::new();
        }
        if begins(&tokens[i..], &["#", "[", "cfg", "(", "test", ")", "]"]) {
            i = after_item(tokens, i);
        } else {
            out.push(tokens[i].clone());
            i += 1;
        }
    }
    out
}

pub(crate) fn begins(tokens: &[String], with: &[&str]) -> bool {
    tokens.len() >= with.len() && tokens.iter().zip(with).all(|(a, b)| a == b)
}

/// Behind the group that opens at `i`.
pub(crate) fn after_group(tokens: &[String], mut i: usize) -> usize {
    let mut depth = 0;
    while i < tokens.len() {
        match tokens[i].as_str() {
            "(" | "[" | "{" => depth += 1,
            ")" | "]" | "}" => depth -= 1,
            _ => {}
        }
        i += 1;
        if depth == 0 {
            break;
        }
    }
    i
}

/// Behind the item, field or statement whose attributes begin at `i`.
fn after_item(tokens: &[String], mut i: usize) -> usize {
    while begins(&tokens[i..], &["#", "["]) {
        i = after_group(tokens, i + 1);
    }
    if begins(&tokens[i..], &["pub", "("]) {
        i = after_group(tokens, i + 1);
    } else if begins(&tokens[i..], &["pub"]) {
        i += 1;
    }
    let items = [
        "fn", "const", "static", "mod", "use", "struct", "enum", "impl", "trait", "type", "unsafe",
        "async", "extern",
    ];
    let is_item = tokens.get(i).is_some_and(|t| items.contains(&t.as_str()));
    let is_use = tokens.get(i).is_some_and(|t| t == "use");
    while i < tokens.len() {
        match tokens[i].as_str() {
            ";" => return i + 1,
            "," if !is_item => return i + 1,
            "}" => return i,
            "{" if !is_use => return after_group(tokens, i),
            "(" | "[" | "{" => i = after_group(tokens, i),
            _ => i += 1,
        }
    }
    i
}
