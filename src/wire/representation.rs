//! Representations as JSON, with a pointer to every faulty field.

use crate::wire::fault::Fault;
use serde::de::Error;
use serde::{Deserialize, Deserializer};
use serde_json::value::RawValue;
use serde_json::{Map, Value};

use super::checked::take_value;
use super::words::plain;
use crate::geometry::generator::{Exact, GeneratorKind, PoleList};
use crate::geometry::representation::Representation;
use crate::geometry::subdivision::control::ControlMesh;
use crate::geometry::subdivision::{SchemeFields, SchemeName, Subdivision};
use crate::geometry::surface::Topology;
use crate::geometry::surface::seam::Seam;

/// Types read from JSON with all errors collected.
pub trait Readable: Sized {
    /// Reads the value.
    ///
    /// # Errors
    /// All fields that are missing, faulty or unknown.
    fn read(value: Value) -> Result<Self, Vec<Fault>>;
}

/// Maximum length of the text: such values are small, or the faces of a control mesh.
const MAX_BYTES: usize = 1 << 20;
/// Maximum number of braces and quotation marks of the text: it has few fields, and lists of numbers. A small object takes a
/// hundred times its text in memory.
const MAX_MARKS: usize = 1000;

/// A value, or all of its faults.
#[derive(Debug, Clone)]
pub struct Read<T>(Result<T, Vec<Fault>>);

impl<T> Read<T> {
    /// The value, unless it is faulty.
    pub fn get(&self) -> Option<&T> {
        self.0.as_ref().ok()
    }

    /// Takes the value; faults go to `errors` below `pointer`.
    pub fn take(self, pointer: &str, errors: &mut Vec<Fault>) -> Option<T> {
        match self.0 {
            Ok(value) => Some(value),
            Err(found) => {
                errors.extend(found.into_iter().map(|error| error.below(pointer)));
                None
            }
        }
    }
}

impl<'de, T: Readable> Deserialize<'de> for Read<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = <&RawValue>::deserialize(deserializer)?.get();
        if text.len() > MAX_BYTES {
            let detail = format!("expected at most {MAX_BYTES} bytes, got {}", text.len());
            return Ok(Self(Err(vec![Fault::new("", detail)])));
        }
        let marks = memchr::memchr2_iter(b'{', b'"', text.as_bytes()).count();
        if marks > MAX_MARKS {
            let detail = format!("expected at most {MAX_MARKS} braces and quotation marks, got {marks}");
            return Ok(Self(Err(vec![Fault::new("", detail)])));
        }
        let value = serde_json::from_str(text).map_err(|error| D::Error::custom(plain(&error)))?;
        Ok(Self(T::read(value)))
    }
}

/// Target of a fit: a representation, or one with a tolerance in place of the number of control points.
#[derive(Debug, Clone, PartialEq)]
pub struct FitTarget {
    /// Representation; with a tolerance, it has the smallest number of control points.
    pub representation: Representation,
    /// Largest residual allowed.
    pub tolerance: Option<f64>,
}

impl Readable for Representation {
    fn read(value: Value) -> Result<Self, Vec<Fault>> {
        read(value)
    }
}

impl Readable for FitTarget {
    fn read(value: Value) -> Result<Self, Vec<Fault>> {
        let (representation, tolerance) = read_target(value)?;
        Ok(Self { representation, tolerance })
    }
}

fn read_target(mut value: Value) -> Result<(Representation, Option<f64>), Vec<Fault>> {
    // Landmarks are not fitted, and subdivision surfaces only at a given size: for them a tolerance is an unknown field.
    let sized = ["landmarks", "subdivision"];
    let curve = value
        .as_object_mut()
        .filter(|map| !map.get("kind").and_then(Value::as_str).is_some_and(|kind| sized.contains(&kind)));
    let Some((map, tolerance)) = curve.and_then(|map| map.remove("tolerance").map(|found| (map, found)))
    else {
        return read(value).map(|found| (found, None));
    };
    let field =
        if map.get("kind").is_some_and(|kind| kind == "open_curve") { "intervals" } else { "control_points" };
    if map.contains_key(field) {
        let detail = format!("expected either tolerance or {field}, got both");
        return Err(vec![Fault::new("/tolerance", detail)]);
    }
    let surface = map.get("kind").is_some_and(|kind| kind == "surface");
    map.insert(field.to_owned(), if surface { Value::from(vec![1, 1]) } else { Value::from(1) });
    let wrong = || Fault::new("/tolerance", format!("expected a number, got {tolerance}"));
    match (read(value), tolerance.as_f64()) {
        (Ok(found), Some(tolerance)) if surface => Ok((found.of_width(1), Some(tolerance))),
        (Ok(found), Some(tolerance)) => {
            let fewest = found.fewest();
            Ok((found.with_count(fewest), Some(tolerance)))
        }
        (Ok(_), None) => Err(vec![wrong()]),
        (Err(errors), Some(_)) => Err(errors),
        (Err(mut errors), None) => {
            errors.push(wrong());
            Err(errors)
        }
    }
}

/// Fields of one object, taken one by one.
struct Fields {
    map: Map<String, Value>,
    errors: Vec<Fault>,
}

impl Fields {
    fn new(value: Value) -> Result<Self, Vec<Fault>> {
        match value {
            Value::Object(map) => Ok(Self { map, errors: Vec::new() }),
            other => Err(vec![Fault::new("", format!("expected an object, got {other}"))]),
        }
    }

    fn error(&mut self, name: &str, detail: impl Into<String>) {
        self.errors.push(Fault::new(format!("/{name}"), detail));
    }

    fn take(&mut self, name: &str) -> Option<Value> {
        let value = self.map.remove(name);
        if value.is_none() {
            self.error(name, "required field is missing");
        }
        value
    }

    fn count(&mut self, name: &str) -> Option<usize> {
        let value = self.take(name)?;
        let count = value.as_u64().and_then(|count| usize::try_from(count).ok());
        if count.is_none() {
            self.error(name, format!("expected a non-negative whole number, got {value}"));
        }
        count
    }

    fn text(&mut self, name: &str) -> Option<String> {
        match self.take(name)? {
            Value::String(text) => Some(text),
            other => {
                self.error(name, format!("expected a string, got {other}"));
                None
            }
        }
    }

    fn given(&self, name: &str) -> bool {
        self.map.contains_key(name)
    }

    /// Takes a small value whose type reports its own faults.
    fn value<T: serde::de::DeserializeOwned>(&mut self, name: &str) -> Option<T> {
        let value = self.take(name)?;
        take_value(&value, &format!("/{name}"), &mut self.errors)
    }

    fn generator(&mut self) -> Option<GeneratorKind> {
        let value = self.take("generator")?;
        self.generator_at("/generator", value)
    }

    fn generator_at(&mut self, pointer: &str, value: Value) -> Option<GeneratorKind> {
        match read_generator(value) {
            Ok(generator) => Some(generator),
            Err(errors) => {
                self.errors.extend(errors.into_iter().map(|error| error.below(pointer)));
                None
            }
        }
    }

    /// Takes the generators, one per direction.
    fn generators(&mut self) -> Option<[GeneratorKind; 2]> {
        match self.take("generators")? {
            Value::Array(values) if values.len() == 2 => {
                let mut values = values.into_iter();
                let [u, v] = ["/generators/0", "/generators/1"]
                    .map(|pointer| values.next().and_then(|value| self.generator_at(pointer, value)));
                Some([u?, v?])
            }
            other => {
                let found =
                    other.as_array().map_or("another value".into(), |list| format!("{} entries", list.len()));
                self.error(
                    "generators",
                    format!("expected a list of two generators (along u and v), got {found}"),
                );
                None
            }
        }
    }

    fn surface(&mut self) -> Option<Representation> {
        let topology: Option<Topology> = self.value("topology");
        let seam = if self.given("seam") { self.value("seam") } else { Some(Seam::Straight) };
        let control_points = self.value::<[usize; 2]>("control_points");
        let from_pole_to_pole = topology.is_some_and(Topology::has_poles);
        if from_pole_to_pole {
            self.rename_meridian_poles();
        }
        let generators = if self.given("generators") {
            self.generators()
        } else {
            topology.map(Topology::usual_generators)
        };
        let generators =
            generators.map(|[u, v]| if from_pole_to_pole { [u, v.of_meridian()] } else { [u, v] });
        Some(Representation::Surface {
            topology: topology?,
            seam: seam?,
            control_points: control_points?,
            generators: generators?,
        })
    }

    /// Poles along the meridian of a sphere are answered as `meridian_poles`, and are read under both names.
    fn rename_meridian_poles(&mut self) {
        let along_v = self.map.get_mut("generators").and_then(|generators| generators.get_mut(1));
        if let Some(generator) = along_v.and_then(Value::as_object_mut)
            && !generator.contains_key("domain_poles")
            && let Some(poles) = generator.remove("meridian_poles")
        {
            generator.insert("domain_poles".into(), poles);
        }
    }

    /// Takes an optional number.
    fn number(&mut self, name: &str) -> Option<f64> {
        self.given(name).then(|| self.value(name)).flatten()
    }

    fn subdivision(&mut self) -> Option<Representation> {
        let name: Option<SchemeName> = self.value("scheme");
        let before = self.errors.len();
        let fields = name.map(|name| SchemeFields {
            lambda: self.number("lambda"),
            lambda_imaginary: self.number("lambda_imaginary"),
            v0: self.number("v0"),
            weights: self.given("weights").then(|| self.value("weights")).flatten(),
            tension: self.number("tension"),
            balance: self.number("balance"),
            ..SchemeFields::named(name)
        });
        let numbers_are_right = self.errors.len() == before;
        let scheme = fields.and_then(|fields| match fields.scheme() {
            Ok(scheme) => Some(scheme),
            Err(faults) if numbers_are_right => {
                faults.into_iter().for_each(|(field, detail)| self.error(field, detail));
                None
            }
            Err(_) => None,
        });
        let level = self.count("level");
        let connectivity = self.connectivity();
        let (scheme, level, connectivity) = (scheme?, level?, connectivity?);
        Some(Representation::Subdivision(Subdivision { scheme, level, connectivity }))
    }

    fn connectivity(&mut self) -> Option<ControlMesh> {
        match self.take("connectivity")? {
            Value::String(text) => match text.parse() {
                Ok(start) => Some(ControlMesh::Named(start)),
                Err(detail) => {
                    self.error("connectivity", format!("unknown mesh: {detail}"));
                    None
                }
            },
            value @ Value::Array(_) => {
                take_value(&value, "/connectivity", &mut self.errors).map(ControlMesh::Faces)
            }
            other => {
                self.error(
                    "connectivity",
                    format!("expected the name of a mesh or a list of faces, got {other}"),
                );
                None
            }
        }
    }

    /// Takes `poles` or `domain_poles`.
    fn poles(&mut self) -> Option<PoleList> {
        match (self.given("poles"), self.given("domain_poles")) {
            (true, true) => {
                self.map.remove("poles");
                self.map.remove("domain_poles");
                self.error("domain_poles", "expected either poles or domain_poles, got both");
                None
            }
            (false, true) => {
                self.value::<Vec<[f64; 2]>>("domain_poles").map(|list| PoleList::from_domain(&list))
            }
            _ => self.value::<Vec<[f64; 2]>>("poles").map(|list| PoleList::on_grid(&list)),
        }
    }

    /// Reports remaining fields as unknown.
    fn finish<T>(mut self, value: Option<T>) -> Result<T, Vec<Fault>> {
        let unknown: Vec<String> =
            self.map.keys().map(|key| key.replace('~', "~0").replace('/', "~1")).collect();
        for key in unknown {
            self.error(&key, "expected no field with this name");
        }
        match value {
            Some(value) if self.errors.is_empty() => Ok(value),
            _ => Err(self.errors),
        }
    }
}

/// Accepted values of `kind`.
const KINDS: &str = "\"closed_curve\", \"open_curve\", \"surface\", \"subdivision\" or \"landmarks\"";

/// Reads a representation.
///
/// # Errors
/// All fields that are missing, faulty or unknown.
pub fn read(value: Value) -> Result<Representation, Vec<Fault>> {
    let mut fields = Fields::new(value)?;
    let kind = fields.text("kind");
    if let Some("surface" | "subdivision") = kind.as_deref() {
        let made = if kind.as_deref() == Some("surface") { fields.surface() } else { fields.subdivision() };
        return fields.finish(made);
    }
    let dimension = fields.count("dimension");
    let representation = match kind.as_deref() {
        Some("closed_curve") => {
            let (control_points, generator) = (fields.count("control_points"), fields.generator());
            dimension.zip(control_points).zip(generator).map(|((dimension, control_points), generator)| {
                Representation::ClosedCurve { dimension, control_points, generator }
            })
        }
        Some("open_curve") => {
            let (intervals, generator) = (fields.count("intervals"), fields.generator());
            dimension.zip(intervals).zip(generator).map(|((dimension, intervals), generator)| {
                Representation::OpenCurve { dimension, intervals, generator }
            })
        }
        Some("landmarks") => {
            let points = fields.count("points");
            dimension.zip(points).map(|(dimension, points)| Representation::Landmarks { dimension, points })
        }
        Some(other) => {
            let detail = format!("expected {KINDS}, got \"{other}\"");
            return Err(vec![Fault::new("/kind", detail)]);
        }
        None => return Err(fields.errors),
    };
    fields.finish(representation)
}

/// Reads a generator.
///
/// # Errors
/// All fields that are missing, faulty or unknown.
pub fn read_generator(value: Value) -> Result<GeneratorKind, Vec<Fault>> {
    let mut fields = Fields::new(value)?;
    let kind = match fields.text("name").as_deref() {
        Some("trigonometric") => Some(GeneratorKind::Trigonometric {}),
        Some("cubic" | "keys") => Some(GeneratorKind::Cubic {}),
        Some("bspline") => fields.count("degree").map(|degree| {
            let degree = u8::try_from(degree).unwrap_or(u8::MAX);
            GeneratorKind::Bspline { degree }
        }),
        Some("exponential") => fields.poles().map(|poles| GeneratorKind::Exponential { poles }),
        Some("shifted_exponential") => {
            fields.poles().map(|poles| GeneratorKind::ShiftedExponential { poles })
        }
        Some("interpolator") => {
            let (family, poles) = (fields.value("family"), fields.poles());
            let support = fields.given("support").then(|| fields.count("support")).flatten();
            let weights = fields.given("weights").then(|| fields.value::<Vec<f64>>("weights")).flatten();
            let weights = weights.unwrap_or_default().into_iter().map(Exact::new).collect();
            family.zip(poles).map(|(family, poles)| GeneratorKind::Interpolator {
                family,
                poles,
                support,
                weights,
            })
        }
        Some(other) => {
            let known = "\"trigonometric\", \"cubic\", \"bspline\", \"exponential\", \"shifted_exponential\" or \"interpolator\"";
            return Err(vec![Fault::new("/name", format!("expected {known}, got \"{other}\""))]);
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

    /// `domain_poles` along a meridian are those of functions of `v`, and are read again as they are written.
    #[test]
    fn poles_along_a_meridian_keep_their_meaning() {
        let of = |name: &str, poles: Value| {
            let circle = json!({"name": "exponential", "domain_poles": [[0, 0], [0, 2], [0, -2]]});
            let along = json!({"name": "exponential", name: poles});
            read(
                json!({"kind": "surface", "topology": "sphere", "control_points": [8, 6], "generators": [circle, along]}),
            )
        };
        let posted = of("domain_poles", json!([[0.0, 0.0], [0.0, 3.0], [0.0, -3.0]])).unwrap();
        let answered = serde_json::to_value(&posted).unwrap();
        assert_eq!(answered["generators"][1]["meridian_poles"][1], json!([0.0, 3.0]));
        assert_eq!(read(answered.clone()).unwrap(), posted);
        assert_eq!(serde_json::from_value::<Representation>(answered.clone()).unwrap(), posted);
        // Spheres of version 0.1.0 are stored with poles of the whole circle.
        let mut stored = answered;
        let poles = stored["generators"][1].as_object_mut().unwrap().remove("meridian_poles").unwrap();
        stored["generators"][1]["domain_poles"] = poles;
        assert_ne!(serde_json::from_value::<Representation>(stored).unwrap(), posted);
    }

    #[test]
    fn generators_of_surfaces_follow_from_the_topology() {
        let of = |topology: &str| {
            let read =
                read(json!({"kind": "surface", "topology": topology, "control_points": [8, 6]})).unwrap();
            serde_json::to_value(read).unwrap()["generators"].clone()
        };
        assert_eq!(of("sphere"), json!([{"name": "trigonometric"}, {"name": "trigonometric"}]));
        assert_eq!(of("cylinder"), json!([{"name": "trigonometric"}, {"name": "cubic"}]));
        assert_eq!(of("plane"), json!([{"name": "cubic"}, {"name": "cubic"}]));
        let errors = read(json!({
            "kind": "surface", "topology": "ball", "control_points": [8], "generators": [{"name": "cubic"}], "dimension": 3
        }))
        .unwrap_err();
        let pointers: Vec<&str> = errors.iter().map(|error| error.pointer.as_str()).collect();
        assert_eq!(pointers, ["/topology", "/control_points", "/generators", "/dimension"]);
    }

    #[test]
    fn every_bad_field_of_a_subdivision_is_named() {
        let pointers = |value: Value| {
            let errors = read(value).unwrap_err();
            errors.iter().map(|error| error.pointer.clone()).collect::<Vec<_>>()
        };
        let bad = json!({"kind": "subdivision", "scheme": "blob", "lambda": 4, "weights": "original", "level": -1,
            "connectivity": "cube", "dimension": 3});
        assert_eq!(pointers(bad), ["/weights", "/lambda", "/level", "/connectivity", "/dimension"]);
        let bad = json!({"kind": "subdivision", "scheme": "spline", "connectivity": [[0, 1, -2]]});
        assert_eq!(pointers(bad), ["/scheme", "/level", "/connectivity/0/2"]);
        let bad = json!({"kind": "subdivision", "scheme": "loop", "level": 1, "tension": "much"});
        assert_eq!(pointers(bad), ["/tension", "/connectivity"]);
    }

    #[test]
    fn what_is_written_is_read() {
        for text in [
            r#"{"kind":"closed_curve","dimension":2,"control_points":12,"generator":{"name":"trigonometric"}}"#,
            r#"{"kind":"closed_curve","dimension":3,"control_points":12,"generator":{"name":"bspline","degree":3}}"#,
            r#"{"kind":"open_curve","dimension":2,"intervals":12,"generator":{"name":"exponential","poles":[[0.0,0.0],[0.0,0.5],[0.0,-0.5]]}}"#,
            r#"{"kind":"open_curve","dimension":2,"intervals":12,"generator":{"name":"interpolator","family":"integer_shifts","domain_poles":[[0.0,0.0],[0.0,0.0],[0.0,0.0]],"support":6,"weights":[-0.5]}}"#,
            r#"{"kind":"landmarks","dimension":2,"points":12}"#,
            r#"{"kind":"surface","topology":"sphere","control_points":[8,5],"generators":[{"name":"trigonometric"},{"name":"cubic"}]}"#,
            r#"{"kind":"subdivision","scheme":"blob","lambda":1.5,"level":3,"connectivity":"octahedron/2"}"#,
            r#"{"kind":"subdivision","scheme":"loop","level":0,"connectivity":[[0,1,3],[0,3,2],[0,2,1],[1,2,3]]}"#,
            r#"{"kind":"subdivision","scheme":"normal_based","balance":0.5,"level":2,"connectivity":"icosahedron"}"#,
            r#"{"kind":"surface","topology":"torus","seam":"half_turn","control_points":[8,6],"generators":[{"name":"cubic"},{"name":"cubic"}]}"#,
        ] {
            let value: Value = serde_json::from_str(text).unwrap();
            let read = read(value.clone()).unwrap();
            assert_eq!(serde_json::to_value(&read).unwrap(), value);
            // as the store reads it
            assert_eq!(serde_json::from_str::<Representation>(text).unwrap(), read);
        }
    }

    #[test]
    fn small_objects_in_place_of_faces_are_refused_before_they_are_read() {
        let faces = vec![r#"{"a":1}"#; 400].join(",");
        let text = format!(r#"{{"kind":"subdivision","scheme":"loop","level":1,"connectivity":[{faces}]}}"#);
        let read: super::Read<Representation> = serde_json::from_str(&text).unwrap();
        let mut errors = Vec::new();
        assert!(read.take("/representation", &mut errors).is_none());
        assert_eq!(errors.len(), 1);
        // Three of each small object; twelve quotation marks and a brace around them.
        assert_eq!(errors[0].detail, "expected at most 1000 braces and quotation marks, got 1213");
    }
}
