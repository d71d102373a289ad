//! Text from files and from users, made safe for where it is put: names may hold anything.

use std::borrow::Cow;

/// A text for a terminal: control characters, which could move the cursor or hide what was written, are spelled out.
/// Lines stay lines.
pub fn printable(text: &str) -> Cow<'_, str> {
    let harmful = |c: char| c.is_control() && c != '\n';
    if !text.contains(harmful) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 8);
    for c in text.chars() {
        if harmful(c) {
            out.extend(c.escape_default());
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

/// A text as a cell of a CSV file, in quotes. Spreadsheets take what begins with `=`, `+`, `-` or `@` for a formula, unless
/// an apostrophe comes first.
pub fn csv_cell(text: &str) -> String {
    let formula = text.starts_with(['=', '+', '-', '@', '\t', '\r']);
    let apostrophe = if formula { "'" } else { "" };
    format!("\"{apostrophe}{}\"", text.replace('"', "\"\""))
}

/// A text as the value of an XML attribute. What XML 1.0 does not allow at all becomes the replacement character.
pub fn xml_attribute(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '"' => out.push_str("&quot;"),
            '\t' | '\n' | '\r' | ' '..='\u{fffd}' | '\u{10000}'.. => out.push(c),
            _ => out.push(char::REPLACEMENT_CHARACTER),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_do_not_reach_terminals() {
        assert_eq!(printable("a\u{1b}[2Jb\u{9b}\nc"), "a\\u{1b}[2Jb\\u{9b}\nc");
        assert_eq!(printable("kühl 1\n"), "kühl 1\n");
    }

    #[test]
    fn names_are_no_formulas() {
        for start in ["=", "+", "-", "@"] {
            let cell = csv_cell(&format!("{start}1+\"2\""));
            assert_eq!(cell, format!("\"'{start}1+\"\"2\"\"\""));
        }
        assert_eq!(csv_cell("Key = 1"), "\"Key = 1\"");
    }

    #[test]
    fn xml_has_only_characters_that_it_may_have() {
        let text = xml_attribute("a\u{0}\u{1b}<b & \"c\">\u{ffff}é\u{1f4a1}");
        assert_eq!(
            text,
            "a\u{fffd}\u{fffd}&lt;b &amp; &quot;c&quot;>\u{fffd}é\u{1f4a1}"
        );
    }
}
