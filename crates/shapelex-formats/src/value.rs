//! Values of attributes.

/// An attribute. In JSON, whole numbers are written without a fraction.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// Yes or no.
    Bool(bool),
    /// A finite number.
    Number(f64),
    /// A text.
    Text(String),
}

/// The largest whole number up to which doubles hold each one, 2⁵³ − 1. Numbers beyond are identifiers, and kept as text.
const LARGEST_WHOLE: i128 = (1 << 53) - 1;

impl Value {
    /// A whole number: a number where doubles hold each one, else its digits.
    pub fn whole(number: i128) -> Self {
        if number.abs() <= LARGEST_WHOLE {
            Self::Number(number as f64)
        } else {
            Self::Text(number.to_string())
        }
    }

    /// A number of JSON.
    pub fn number(number: &serde_json::Number) -> Option<Self> {
        match number.as_i128() {
            Some(whole) => Some(Self::whole(whole)),
            None => number.as_f64().filter(|number| number.is_finite()).map(Self::Number),
        }
    }
}

impl serde::Serialize for Value {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Bool(yes) => serializer.serialize_bool(*yes),
            // The cast is exact in this range.
            Self::Number(number) if number.fract() == 0.0 && number.abs() <= LARGEST_WHOLE as f64 => {
                serializer.serialize_i64(*number as i64)
            }
            Self::Number(number) => serializer.serialize_f64(*number),
            Self::Text(text) => serializer.serialize_str(text),
        }
    }
}

impl<'de> serde::Deserialize<'de> for Value {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl serde::de::Visitor<'_> for Visitor {
            type Value = Value;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a text, a number or a Boolean")
            }

            fn visit_bool<E>(self, yes: bool) -> Result<Value, E> {
                Ok(Value::Bool(yes))
            }

            fn visit_i64<E>(self, number: i64) -> Result<Value, E> {
                Ok(Value::whole(number.into()))
            }

            fn visit_u64<E>(self, number: u64) -> Result<Value, E> {
                Ok(Value::whole(number.into()))
            }

            fn visit_f64<E>(self, number: f64) -> Result<Value, E> {
                Ok(Value::Number(number))
            }

            fn visit_str<E>(self, text: &str) -> Result<Value, E> {
                Ok(text.into())
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

impl From<String> for Value {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.into())
    }
}
