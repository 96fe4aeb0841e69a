//! What a caller may say about a file.

use serde::{Deserialize, Serialize};

use super::error::{FaultKind, FileError};
use super::format::Format;

/// Options of reading. A format refuses those that it does not name in [`Format::options`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReadOptions {
    /// Names of regions or classes to take, as a pattern with `*` and `?`, case ignored; several with commas.
    pub select: Option<String>,
    /// What becomes of rings that bound holes. Default: `skip`.
    pub holes: Option<Holes>,
    /// Whether curves are closed, where the format does not say.
    pub closed: Option<bool>,
    /// Name of the column that holds the points, of tables by other programs.
    pub column: Option<String>,
    /// Number of coordinates of a point, where the format does not say.
    pub dimension: Option<usize>,
}

/// What becomes of rings that bound holes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Holes {
    /// They are left out and counted.
    #[default]
    Skip,
    /// They become records of their own.
    Keep,
    /// A file that has some is refused.
    Refuse,
}

impl ReadOptions {
    /// Refuses options that the format does not have.
    pub(super) fn check(&self, format: &Format) -> Result<(), FileError> {
        let given = serde_json::to_value(self).unwrap_or_default();
        let given = given.as_object().into_iter().flatten().filter(|(_, value)| !value.is_null());
        for (name, _) in given {
            if !format.options.contains(&name.as_str()) {
                let known = if format.options.is_empty() { "none".into() } else { format.options.join(", ") };
                let detail = format!("expected options of {} ({known}), got {name}", format.name);
                return Err(FileError::new(FaultKind::Option, detail));
            }
        }
        Ok(())
    }

    /// Whether a name is selected. `*` stands for any text and `?` for one character.
    pub fn selects(&self, name: &str) -> bool {
        let name = name.to_lowercase();
        let matches =
            |pattern: &str| matches_pattern(pattern.trim().to_lowercase().as_bytes(), name.as_bytes());
        self.select.as_ref().is_none_or(|select| select.split(',').any(matches))
    }
}

/// Linear in the lengths, up to the length of what the last star covers.
fn matches_pattern(pattern: &[u8], text: &[u8]) -> bool {
    let (mut p, mut t, mut star) = (0, 0, None);
    while t < text.len() {
        match pattern.get(p) {
            Some(b'*') => {
                star = Some((p, t));
                p += 1;
            }
            Some(c) if *c == b'?' || *c == text[t] => (p, t) = (p + 1, t + 1),
            _ => match star {
                Some((at, covered)) => {
                    star = Some((at, covered + 1));
                    (p, t) = (at + 1, covered + 1);
                }
                None => return false,
            },
        }
    }
    pattern[p..].iter().all(|c| *c == b'*')
}

/// Options of writing.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WriteOptions {
    /// Unit of the coordinates, where a format has a place for it.
    pub unit: Option<String>,
    /// What else is known of the shapes, by name, where a format has a place for it: representation, cohort, revision.
    pub facts: std::collections::BTreeMap<String, String>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns() {
        let options = |text: &str| ReadOptions { select: Some(text.into()), ..ReadOptions::default() };
        for (pattern, name, expected) in [
            ("heart", "Heart", true),
            ("lung*", "Lung left", true),
            ("*left", "Lung left", true),
            ("l?ng*", "lung", true),
            ("lung, heart", "heart", true),
            ("lung", "lung left", false),
            ("*a*b", "aab", true),
            ("*a*b", "aabc", false),
            ("", "x", false),
        ] {
            assert_eq!(options(pattern).selects(name), expected, "{pattern} {name}");
        }
        assert!(ReadOptions::default().selects("anything"));
    }
}
