//! Attributes of shapes, addressed by their names in requests: `subject`, `label`, `labels.<attribute>`.

use serde_json::Value;

use super::shape::ShapeDescription;

/// An attribute of shapes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Attribute {
    /// The subject.
    Subject,
    /// The class label.
    Label,
    /// A further attribute, by its name.
    Labels(String),
}

impl Attribute {
    /// Parses `subject`, `label` or `labels.<attribute>`.
    pub fn parse(text: &str) -> Option<Self> {
        match text {
            "subject" => Some(Self::Subject),
            "label" => Some(Self::Label),
            other => other
                .strip_prefix("labels.")
                .filter(|name| !name.is_empty())
                .map(|name| Self::Labels(name.into())),
        }
    }

    /// What [`Self::parse`] wants.
    pub const WANTED: &str = "expected 'subject', 'label' or 'labels.<attribute>'";

    /// Value as text, as filters compare it.
    pub fn text(&self, shape: &ShapeDescription) -> Option<String> {
        match self {
            Self::Subject => shape.subject.clone(),
            Self::Label => shape.label.clone(),
            Self::Labels(name) => match shape.labels.get(name)? {
                Value::Null => None,
                Value::String(text) => Some(text.clone()),
                other => Some(other.to_string()),
            },
        }
    }

    /// Value, if it is a finite number.
    pub fn number(&self, shape: &ShapeDescription) -> Option<f64> {
        match self {
            Self::Subject | Self::Label => None,
            Self::Labels(name) => shape.labels.get(name)?.as_f64().filter(|value| value.is_finite()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attributes_are_read_by_name() {
        assert_eq!(Attribute::parse("labels.age"), Some(Attribute::Labels("age".into())));
        assert_eq!(Attribute::parse("labels."), None);
        assert_eq!(Attribute::parse("age"), None);
    }
}
