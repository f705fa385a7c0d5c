//! What a text says that its types would take, and that nobody can have meant: lists with more values than are read, and paths whose
//! backslashes began an escape. And on which line it says something.

use crate::tables::Unreadable;
use serde_json::Value;
use std::ops::Range;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// The cure of a path in double quotes.
pub(crate) const ESCAPES: &str = ". In double quotes a backslash begins an escape: use single quotes for paths, as in 'C:\\lab\\x', or write them \
                                  with /";

/// Whether an error at a place of the text is about an escape.
pub(crate) fn is_escape(text: &str, at: usize) -> bool {
    let line = text[..at].rfind('\n').map_or(0, |k| k + 1);
    let before = &text.as_bytes()[line.max(at.saturating_sub(3))..];
    before.iter().take(5).any(|&b| b == b'\\')
}

/// Refuses what is read otherwise than it was written. `schema` is that of the whole text, as editors read it.
pub(crate) fn spelled(text: &str, schema: &str) -> Result<(), Unreadable> {
    let root = DeTable::parse(text)?;
    // One that is no JSON knows no lengths.
    let schema = serde_json::from_str(schema).unwrap_or(Value::Null);
    table(root.get_ref(), &schema, text)
}

fn table(table: &DeTable<'_>, schema: &Value, text: &str) -> Result<(), Unreadable> {
    for (key, value) in table {
        let key = key.get_ref().as_ref();
        let own = [schema].into_iter().chain(alternatives(schema));
        let known = own.into_iter().find_map(|s| s["properties"].get(key));
        look(
            value,
            known.unwrap_or(&schema["additionalProperties"]),
            text,
        )?;
    }
    Ok(())
}

fn alternatives(schema: &Value) -> impl Iterator<Item = &Value> {
    let lists = ["oneOf", "anyOf", "allOf"].map(|key| schema[key].as_array());
    lists.into_iter().flatten().flatten()
}

fn look(value: &Spanned<DeValue<'_>>, schema: &Value, text: &str) -> Result<(), Unreadable> {
    match value.get_ref() {
        DeValue::Table(inner) => table(inner, schema, text),
        DeValue::Array(items) => {
            let (least, most) = (schema["minItems"].as_u64(), schema["maxItems"].as_u64());
            if let (Some(least), Some(most)) = (least, most)
                && !(least..=most).contains(&(items.len() as u64))
            {
                let n = items.len();
                let must = match least == most {
                    true => format!("exactly {most}"),
                    false => format!("{least} to {most}"),
                };
                return Err(wrong(
                    value.span(),
                    format!("there must be {must} values, and there are {n}"),
                ));
            }
            let of_item = &schema["items"];
            items.iter().try_for_each(|item| look(item, of_item, text))
        }
        DeValue::String(said) => match is_garbled_path(said, &text[value.span()]) {
            true => Err(wrong(
                value.span(),
                format!(
                    "this reads as {said:?}{ESCAPES}. What is meant to read so stands between three double quotes"
                ),
            )),
            false => Ok(()),
        },
        _ => Ok(()),
    }
}

/// Whether a string in double quotes came to something else by its backslashes: no path has control characters, and none begins like one of
/// Windows and names characters by their numbers.
fn is_garbled_path(said: &str, written: &str) -> bool {
    let in_one_line = written.starts_with('"') && !written.starts_with("\"\"\"");
    let mut escapes = Vec::new();
    let mut characters = written.chars();
    while let Some(c) = characters.next() {
        if c == '\\' {
            escapes.extend(characters.next());
        }
    }
    let drive = said
        .get(..2)
        .is_some_and(|d| d.ends_with(':') && d.as_bytes()[0].is_ascii_alphabetic());
    let by_number = escapes.iter().any(|c| "xuU".contains(*c));
    let control = escapes.iter().any(|c| "btnfre".contains(*c));
    in_one_line && (control || by_number && (drive || said.starts_with('\\')))
}

fn wrong(span: Range<usize>, message: String) -> Unreadable {
    Unreadable {
        message,
        span: Some(span),
    }
}

/// The line on which a text says something, counted from 1; of what is not there, the line where what should hold it begins. Items of a list are
/// named by their number, from 0.
pub(crate) fn line_of(text: &str, keys: &[&str]) -> usize {
    let Ok(root) = DeTable::parse(text) else {
        return 1;
    };
    let mut at = 0;
    let mut inside: Option<&DeValue<'_>> = None;
    for (depth, key) in keys.iter().enumerate() {
        let tables = match (depth, inside) {
            (0, _) => Some(root.get_ref()),
            (_, Some(DeValue::Table(table))) => Some(table),
            _ => None,
        };
        let items = match inside {
            Some(DeValue::Array(items)) => key.parse().ok().and_then(|k: usize| items.get(k)),
            _ => None,
        };
        let member = tables.and_then(|t| t.iter().find(|(k, _)| k.get_ref() == *key));
        let Some((start, value)) = member
            .map(|(key, value)| (key.span().start, value))
            .or(items.map(|item| (item.span().start, item)))
        else {
            break;
        };
        (at, inside) = (start, Some(value.get_ref()));
    }
    text.as_bytes()[..at.min(text.len())]
        .iter()
        .filter(|&&b| b == b'\n')
        .count()
        + 1
}
