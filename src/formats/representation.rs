//! A representation as JSON, with the pointer of every field that is wrong.

use serde::{Deserialize, Deserializer};
use serde_json::{Map, Value};

use super::InputError;
use crate::geometry::generator::GeneratorKind;
use crate::geometry::representation::Representation;

/// A representation, or everything that is wrong with it.
#[derive(Debug, Clone)]
pub struct CheckedRepresentation(Result<Representation, Vec<InputError>>);

impl CheckedRepresentation {
    /// The representation; errors go to `errors` below `pointer`.
    pub fn take(self, pointer: &str, errors: &mut Vec<InputError>) -> Option<Representation> {
        match self.0 {
            Ok(representation) => Some(representation),
            Err(found) => {
                errors.extend(found.into_iter().map(|error| error.below(pointer)));
                None
            }
        }
    }
}

impl<'de> Deserialize<'de> for CheckedRepresentation {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self(read(Value::deserialize(deserializer)?)))
    }
}

/// The fields of one object, taken one by one.
struct Fields {
    map: Map<String, Value>,
    errors: Vec<InputError>,
}

impl Fields {
    fn new(value: Value) -> Result<Self, Vec<InputError>> {
        match value {
            Value::Object(map) => Ok(Self { map, errors: Vec::new() }),
            other => Err(vec![InputError::new("", format!("is {other}, not an object"))]),
        }
    }

    fn error(&mut self, name: &str, detail: impl Into<String>) {
        self.errors.push(InputError::new(format!("/{name}"), detail));
    }

    fn take(&mut self, name: &str) -> Option<Value> {
        let value = self.map.remove(name);
        if value.is_none() {
            self.error(name, "is missing");
        }
        value
    }

    fn count(&mut self, name: &str) -> Option<usize> {
        let value = self.take(name)?;
        let count = value.as_u64().and_then(|count| usize::try_from(count).ok());
        if count.is_none() {
            self.error(name, format!("is {value}, not a count"));
        }
        count
    }

    fn text(&mut self, name: &str) -> Option<String> {
        match self.take(name)? {
            Value::String(text) => Some(text),
            other => {
                self.error(name, format!("is {other}, not a text"));
                None
            }
        }
    }

    /// Whatever is left over is unknown.
    fn finish<T>(mut self, value: Option<T>) -> Result<T, Vec<InputError>> {
        let unknown: Vec<String> =
            self.map.keys().map(|key| key.replace('~', "~0").replace('/', "~1")).collect();
        for key in unknown {
            self.error(&key, "is not a field of this object");
        }
        match value {
            Some(value) if self.errors.is_empty() => Ok(value),
            _ => Err(self.errors),
        }
    }
}

/// Reads a representation.
///
/// # Errors
/// All fields that are missing, wrong or unknown.
pub fn read(value: Value) -> Result<Representation, Vec<InputError>> {
    let mut fields = Fields::new(value)?;
    let kind = fields.text("kind");
    let dimension = fields.count("dimension");
    let representation = match kind.as_deref() {
        Some("closed_curve") => {
            let control_points = fields.count("control_points");
            let generator = fields.take("generator").and_then(|value| match read_generator(value) {
                Ok(generator) => Some(generator),
                Err(errors) => {
                    fields.errors.extend(errors.into_iter().map(|error| error.below("/generator")));
                    None
                }
            });
            dimension.zip(control_points).zip(generator).map(|((dimension, control_points), generator)| {
                Representation::ClosedCurve { dimension, control_points, generator }
            })
        }
        Some("landmarks") => {
            let points = fields.count("points");
            dimension.zip(points).map(|(dimension, points)| Representation::Landmarks { dimension, points })
        }
        Some(other) => {
            let detail = format!("is \"{other}\", must be \"closed_curve\" or \"landmarks\"");
            return Err(vec![InputError::new("/kind", detail)]);
        }
        None => return Err(fields.errors),
    };
    fields.finish(representation)
}

fn read_generator(value: Value) -> Result<GeneratorKind, Vec<InputError>> {
    let mut fields = Fields::new(value)?;
    let kind = match fields.text("name").as_deref() {
        Some("trigonometric") => Some(GeneratorKind::Trigonometric {}),
        Some("keys") => Some(GeneratorKind::Keys {}),
        Some("bspline") => fields.count("degree").map(|degree| {
            let degree = u8::try_from(degree).unwrap_or(u8::MAX);
            GeneratorKind::Bspline { degree }
        }),
        Some(other) => {
            let detail = format!("is \"{other}\", must be \"trigonometric\", \"keys\" or \"bspline\"");
            return Err(vec![InputError::new("/name", detail)]);
        }
        None => None,
    };
    fields.finish(kind)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_bad_field_is_named() {
        let errors = read(json!({
            "kind": "closed_curve", "dimension": "two", "generator": {"name": "bspline", "order": 3}, "extra": 1
        }))
        .unwrap_err();
        let pointers: Vec<&str> = errors.iter().map(|error| error.pointer.as_str()).collect();
        assert_eq!(
            pointers,
            ["/dimension", "/control_points", "/generator/degree", "/generator/order", "/extra"]
        );
    }

    #[test]
    fn what_is_written_is_read() {
        for text in [
            r#"{"kind":"closed_curve","dimension":2,"control_points":12,"generator":{"name":"trigonometric"}}"#,
            r#"{"kind":"closed_curve","dimension":3,"control_points":12,"generator":{"name":"bspline","degree":3}}"#,
            r#"{"kind":"landmarks","dimension":2,"points":12}"#,
        ] {
            let value: Value = serde_json::from_str(text).unwrap();
            let read = read(value.clone()).unwrap();
            assert_eq!(serde_json::to_value(&read).unwrap(), value);
        }
    }
}
