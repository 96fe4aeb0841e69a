//! Attributes of shapes, addressed by their names in requests: `label`, `labels.<attribute>`, `measures.area`, ….

use std::borrow::Cow;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::shape::{ShapeDescription, ShapeMeasures};

/// An attribute of shapes.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Attribute {
    /// The identifier assigned by the client.
    ExternalId,
    /// The subject.
    Subject,
    /// The class label.
    Label,
    /// A further attribute, by its name.
    Labels(String),
    /// A measure.
    Measure(Measure),
    /// The time of creation.
    CreatedAt,
}

/// A measure of shapes, computed when they arrive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Measure {
    /// Number of points as received.
    Points,
    /// Centroid size.
    CentroidSize,
    /// Length of a curve.
    Length,
    /// Enclosed area of a closed planar curve, or area of a surface.
    Area,
    /// Volume that a surface encloses.
    Volume,
    /// Whether a planar curve intersects itself.
    SelfIntersecting,
    /// Whether a closed planar curve runs clockwise.
    Clockwise,
    /// Mean distance of a mesh from the surface fitted to it.
    FitMean,
    /// Largest distance of a mesh from the surface fitted to it.
    FitLargest,
    /// Relative error of the area of a surface fitted to a mesh.
    FitArea,
}

impl Measure {
    /// All measures.
    pub const ALL: [Self; 10] = [
        Self::Points,
        Self::CentroidSize,
        Self::Length,
        Self::Area,
        Self::Volume,
        Self::SelfIntersecting,
        Self::Clockwise,
        Self::FitMean,
        Self::FitLargest,
        Self::FitArea,
    ];

    /// Name in requests and of the column in the store.
    pub fn name(self) -> &'static str {
        match self {
            Self::Points => "points",
            Self::CentroidSize => "centroid_size",
            Self::Length => "length",
            Self::Area => "area",
            Self::Volume => "volume",
            Self::SelfIntersecting => "self_intersecting",
            Self::Clockwise => "clockwise",
            Self::FitMean => "fit_mean",
            Self::FitLargest => "fit_largest",
            Self::FitArea => "fit_area",
        }
    }

    /// Whether its values are true and false.
    pub fn is_flag(self) -> bool {
        matches!(self, Self::SelfIntersecting | Self::Clockwise)
    }

    /// Value, if it is true or false.
    pub fn flag(self, measures: &ShapeMeasures) -> Option<bool> {
        match self {
            Self::SelfIntersecting => measures.self_intersecting,
            Self::Clockwise => measures.clockwise,
            _ => None,
        }
    }

    /// The measure with this name.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|measure| measure.name() == name)
    }

    /// Value, if it is a number.
    pub fn number(self, measures: &ShapeMeasures) -> Option<f64> {
        match self {
            Self::Points => measures.points.map(|points| points as f64),
            Self::CentroidSize => measures.centroid_size,
            Self::Length => measures.length,
            Self::Area => measures.area,
            Self::Volume => measures.volume,
            Self::FitMean => measures.fit.map(|fit| fit.mean),
            Self::FitLargest => measures.fit.map(|fit| fit.largest),
            Self::FitArea => measures.fit.map(|fit| fit.area),
            Self::SelfIntersecting | Self::Clockwise => None,
        }
    }
}

/// Prefix of the names of further attributes.
const LABELS: &str = "labels.";
/// Prefix of the names of measures.
const MEASURES: &str = "measures.";

/// Value of an attribute.
#[derive(Debug, Clone, PartialEq)]
pub enum AttributeValue<'a> {
    /// Text.
    Text(Cow<'a, str>),
    /// A finite number.
    Number(f64),
    /// A Boolean.
    Flag(bool),
    /// A time, in milliseconds since 1970 UTC.
    Time(i64),
}

/// The largest whole number up to which doubles hold each one: 2⁵³ − 1. Larger ones are compared by their digits.
pub const LARGEST_WHOLE: u64 = (1 << 53) - 1;

/// Whether a number is written as a whole one that doubles do not tell from its neighbours.
pub fn is_beyond(number: &serde_json::Number) -> bool {
    number.as_i128().is_some_and(|whole| whole.unsigned_abs() > u128::from(LARGEST_WHOLE))
}

impl Attribute {
    /// Parses the name of an attribute.
    pub fn parse(text: &str) -> Option<Self> {
        match text {
            "external_id" => Some(Self::ExternalId),
            "subject" => Some(Self::Subject),
            "label" => Some(Self::Label),
            "created_at" => Some(Self::CreatedAt),
            other => match other.strip_prefix(MEASURES) {
                Some(name) => Measure::parse(name).map(Self::Measure),
                None => other
                    .strip_prefix(LABELS)
                    .filter(|name| !name.is_empty() && !name.contains('\0'))
                    .map(|name| Self::Labels(name.into())),
            },
        }
    }

    /// Form that [`Self::parse`] expects.
    pub const WANTED: &str = "expected 'external_id', 'label', 'subject', 'labels.<attribute>', 'measures.<measure>' or 'created_at'";

    /// Name of a further attribute.
    pub fn label_name(&self) -> Option<&str> {
        match self {
            Self::Labels(name) => Some(name),
            Self::ExternalId | Self::Subject | Self::Label | Self::Measure(_) | Self::CreatedAt => None,
        }
    }

    /// Whether its values are numbers or times, so that bounds and values must be such.
    pub fn is_numeric(&self) -> bool {
        match self {
            Self::Measure(measure) => !measure.is_flag(),
            Self::CreatedAt => true,
            Self::ExternalId | Self::Subject | Self::Label | Self::Labels(_) => false,
        }
    }

    /// Value, if the shape has it.
    pub fn value<'a>(&self, shape: &'a ShapeDescription) -> Option<AttributeValue<'a>> {
        let text = |text: &'a Option<String>| text.as_deref().map(|text| AttributeValue::Text(text.into()));
        match self {
            Self::ExternalId => text(&shape.external_id),
            Self::Subject => text(&shape.subject),
            Self::Label => text(&shape.label),
            Self::CreatedAt => Some(AttributeValue::Time(shape.created_at_ms)),
            Self::Measure(measure) if measure.is_flag() => {
                measure.flag(&shape.measures).map(AttributeValue::Flag)
            }
            Self::Measure(measure) => measure.number(&shape.measures).map(AttributeValue::Number),
            Self::Labels(name) => match shape.labels.get(name)? {
                Value::String(text) => Some(AttributeValue::Text(text.into())),
                Value::Bool(flag) => Some(AttributeValue::Flag(*flag)),
                Value::Number(number) if is_beyond(number) => {
                    Some(AttributeValue::Text(number.to_string().into()))
                }
                Value::Number(number) => {
                    number.as_f64().filter(|number| number.is_finite()).map(AttributeValue::Number)
                }
                Value::Null | Value::Array(_) | Value::Object(_) => None,
            },
        }
    }

    /// Value as a number, of a value as [`Store::values`](crate::store::Store::values) reads it: that of [`Self::number`].
    pub fn number_of(&self, value: &Value) -> Option<f64> {
        match (self, value) {
            (Self::CreatedAt, _) => None,
            (Self::Labels(_), Value::Number(number)) if is_beyond(number) => None,
            (_, Value::Number(number)) => number.as_f64().filter(|number| number.is_finite()),
            _ => None,
        }
    }

    /// Value as text, of a value as [`Store::values`](crate::store::Store::values) reads it: that of [`Self::text`].
    pub fn text_of(&self, value: &Value) -> Option<String> {
        match (self, value) {
            (_, Value::Null) => None,
            (_, Value::String(text)) => Some(text.clone()),
            (Self::Measure(_), Value::Number(number)) => number.as_f64().map(|number| number.to_string()),
            (_, other) => Some(other.to_string()),
        }
    }

    /// Value as text, as filters compare it.
    pub fn text(&self, shape: &ShapeDescription) -> Option<String> {
        match self {
            Self::Labels(name) => match shape.labels.get(name)? {
                Value::Null => None,
                Value::String(text) => Some(text.clone()),
                other => Some(other.to_string()),
            },
            other => match other.value(shape)? {
                AttributeValue::Text(text) => Some(text.into_owned()),
                AttributeValue::Number(number) => Some(number.to_string()),
                AttributeValue::Flag(flag) => Some(flag.to_string()),
                AttributeValue::Time(ms) => Some(ms.to_string()),
            },
        }
    }

    /// Value, if it is a finite number.
    pub fn number(&self, shape: &ShapeDescription) -> Option<f64> {
        match self.value(shape)? {
            AttributeValue::Number(number) => Some(number),
            AttributeValue::Text(_) | AttributeValue::Flag(_) | AttributeValue::Time(_) => None,
        }
    }
}

impl std::fmt::Display for Attribute {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::ExternalId => f.write_str("external_id"),
            Self::Subject => f.write_str("subject"),
            Self::Label => f.write_str("label"),
            Self::CreatedAt => f.write_str("created_at"),
            Self::Measure(measure) => write!(f, "{MEASURES}{}", measure.name()),
            Self::Labels(name) => write!(f, "{LABELS}{name}"),
        }
    }
}

impl From<Attribute> for String {
    fn from(attribute: Attribute) -> Self {
        attribute.to_string()
    }
}

impl TryFrom<String> for Attribute {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        Self::parse(&name).ok_or_else(|| format!("{}, got '{name}'", Self::WANTED))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attributes_are_read_by_name() {
        assert_eq!(Attribute::parse("labels.age"), Some(Attribute::Labels("age".into())));
        assert_eq!(Attribute::parse("labels."), None);
        assert_eq!(Attribute::parse("labels.age\0other"), None);
        assert_eq!(Attribute::parse("age"), None);
        assert_eq!(Attribute::parse("measures.area"), Some(Attribute::Measure(Measure::Area)));
        assert_eq!(Attribute::parse("measures.mass"), None);
    }

    #[test]
    fn names_are_written_as_they_are_read() {
        let measures = Measure::ALL.map(Attribute::Measure);
        let own = [Attribute::ExternalId, Attribute::Subject, Attribute::Label, Attribute::CreatedAt];
        for attribute in measures.into_iter().chain(own).chain([Attribute::Labels("a.b".into())]) {
            assert_eq!(Attribute::parse(&attribute.to_string()), Some(attribute));
        }
    }
}
