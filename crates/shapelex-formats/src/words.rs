//! Messages of parsers in words that clients know: types of Rust and the grammar of a parser mean nothing to them.

/// Most bytes of a name that many shapes repeat, sixteen times those of DICOM: longer ones would make a small file a large work.
pub(crate) const MAX_NAME: usize = 1024;

/// Message of an error in words that clients know, without the place in the text.
pub fn plain(error: &serde_json::Error) -> String {
    let text = error.to_string();
    let place = format!(" at line {} column {}", error.line(), error.column());
    let text = text.strip_suffix(&place).unwrap_or(&text);
    if error.is_data() { plain_sentence(text) } else { plain_syntax(text).into() }
}

/// Translates the message of the parser about text that is not JSON.
fn plain_syntax(text: &str) -> &'static str {
    match text {
        "EOF while parsing a list" => "expected the end of a list, got the end of the text",
        "EOF while parsing an object" => "expected the end of an object, got the end of the text",
        "EOF while parsing a string" => "expected the end of a string, got the end of the text",
        "EOF while parsing a value" => "expected a value, got the end of the text",
        "expected `:`" => "expected a colon after the name of a field, got another character",
        "expected `,` or `]`" => "expected a comma or the end of the list, got another character",
        "expected `,` or `}`" => "expected a comma or the end of the object, got another character",
        "expected ident" => "expected true, false or null, got another word",
        "invalid escape" => "expected a known escape after a backslash, got another character",
        "unexpected end of hex escape"
        | "lone leading surrogate in hex escape"
        | "invalid unicode code point" => "expected text in UTF-8, got other bytes",
        "invalid number" => "expected a number, got another text",
        "number out of range" => "expected a number within the range of double precision, got a larger one",
        "key must be a string" => "expected the name of a field in quotation marks, got another character",
        "trailing comma" => "expected another entry after a comma, got the end",
        "trailing characters" => "expected the end of the text, got more",
        "recursion limit exceeded" => "expected at most 127 levels of lists and objects, got more",
        _ if text.starts_with("control character") => {
            "expected an escape such as \\n, got a control character"
        }
        _ => "expected a value, got another character",
    }
}

/// Translates a message of serde: Rust type names and backticks mean nothing to clients. Other texts stay as they are.
pub fn plain_sentence(text: &str) -> String {
    let quoted = |text: &str| text.replace('`', "\"");
    if let Some(rest) = text.strip_prefix("invalid type: ").or_else(|| text.strip_prefix("invalid value: "))
        && let Some((found, wanted)) = rest.rsplit_once(", expected ")
    {
        return format!("expected {}, got {}", plain_wanted(wanted), plain_found(found));
    }
    if let Some((found, wanted)) =
        text.strip_prefix("invalid length ").and_then(|rest| rest.split_once(", expected "))
    {
        return format!("expected {}, got length {found}", plain_wanted(wanted));
    }
    if let Some((found, wanted)) =
        text.strip_prefix("unknown variant `").and_then(|rest| rest.rsplit_once("`, expected "))
    {
        return format!("expected {}, got \"{found}\"", quoted(wanted));
    }
    if let Some((found, wanted)) =
        text.strip_prefix("unknown field `").and_then(|rest| rest.rsplit_once("`, expected "))
    {
        return format!("expected {} as the name of a field, got \"{found}\"", quoted(wanted));
    }
    if let Some(name) = text.strip_prefix("missing field ") {
        return format!("required field {} is missing", quoted(name));
    }
    if let Some(name) = text.strip_prefix("duplicate field ") {
        return format!("expected the field {} once, got it twice", quoted(name));
    }
    if text.starts_with("data did not match any variant of untagged enum") {
        return "expected another form of this value".into();
    }
    text.to_owned()
}

/// The type that serde expected.
fn plain_wanted(wanted: &str) -> String {
    match wanted {
        "usize" | "u64" => "a non-negative whole number".into(),
        "u32" => format!("a whole number from 0 to {}", u32::MAX),
        "u16" => format!("a whole number from 0 to {}", u16::MAX),
        "u8" => format!("a whole number from 0 to {}", u8::MAX),
        "isize" | "i64" | "i32" | "i16" | "i8" => "a whole number".into(),
        "f64" | "f32" => "a number".into(),
        "a sequence" => "a list".into(),
        "a map" => "an object".into(),
        "fewer elements in array" => "a shorter list".into(),
        "string or map" | "variant identifier" => "a name".into(),
        _ if wanted.starts_with("struct ") || wanted.starts_with("internally tagged enum ") => {
            "an object".into()
        }
        _ if wanted.starts_with("enum ") => "a name".into(),
        _ => wanted.replace("an array of length", "a list of length").replace('`', "\""),
    }
}

/// The value that serde found.
fn plain_found(found: &str) -> String {
    let quoted = ["boolean `", "integer `", "floating point `"]
        .iter()
        .find_map(|kind| found.strip_prefix(kind)?.strip_suffix('`'));
    match (quoted, found) {
        (Some(value), _) => value.into(),
        (None, "sequence") => "a list".into(),
        (None, "map") => "an object".into(),
        (None, "unit value") => "null".into(),
        (None, _) => found.strip_prefix("string ").unwrap_or(found).into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_of_serde_are_translated() {
        let said = |text: &str| plain(&serde_json::from_str::<u8>(text).unwrap_err());
        assert_eq!(said("300"), "expected a whole number from 0 to 255, got 300");
        assert_eq!(said("\"two\""), "expected a whole number from 0 to 255, got \"two\"");
        assert_eq!(said("[]"), "expected a whole number from 0 to 255, got a list");
        assert_eq!(
            plain_sentence("unknown variant `rose`, expected one of `circle`, `line`"),
            "expected one of \"circle\", \"line\", got \"rose\""
        );
        assert_eq!(
            plain_sentence("unknown field `colour`, expected `north` or `south`"),
            "expected \"north\" or \"south\" as the name of a field, got \"colour\""
        );
        assert_eq!(plain_sentence("missing field `matrices`"), "required field \"matrices\" is missing");
        assert_eq!(
            plain_sentence("invalid length 1, expected an array of length 2"),
            "expected a list of length 2, got length 1"
        );
    }
}
