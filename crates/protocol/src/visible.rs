//! A driver's reply with words that may be shown.

use crate::wire::Object;
use scopeservo_scope::visible;
use serde_json::Value;

/// Writes every text of a reply so that it may be shown ([`visible`]): whatever becomes of it, it goes to no terminal as it came.
pub(crate) fn make_visible(object: &mut Object) {
    object.values_mut().for_each(value);
}

fn value(it: &mut Value) {
    match it {
        Value::String(text) => *text = visible(text),
        // No deeper than the parser goes.
        Value::Array(all) => all.iter_mut().for_each(value),
        Value::Object(object) => make_visible(object),
        _ => {}
    }
}
