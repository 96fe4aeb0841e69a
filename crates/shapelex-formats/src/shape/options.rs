//! Options of reading and writing a file.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::format::Format;
use super::record::Record;
use super::source::Source;
use crate::error::{FaultKind, FileError, Place};
use crate::series::SeriesImage;
use crate::summary::{BROKEN, Summary};

/// Options of reading. A format refuses those that it does not name in [`Format::options`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReadOptions {
    /// Names of regions or classes to take, as a pattern with `*` and `?`, case ignored; several with commas.
    pub select: Option<String>,
    /// Treatment of rings that bound holes. Default: `skip`.
    pub holes: Option<Holes>,
    /// Whether curves are closed, where the format does not say.
    pub closed: Option<bool>,
    /// Treatment of the `SCALE=` of TPS files. Default: it is applied if every specimen has one.
    pub scale: Option<Scale>,
    /// Treatment of curves beside landmarks. Default: `separate`.
    pub curves: Option<Curves>,
    /// Coordinates of missing points: a number, such as `-999`, or `negative`. `NA` and `NaN` are always missing.
    pub missing: Option<String>,
    /// Number of coordinates of a point, where the format does not say.
    pub dimension: Option<usize>,
    /// Meanings of the columns of a table. Default: recognised by their names.
    pub columns: Option<Columns>,
    /// Treatment of the outlines of nuclei beside those of their cells. Default: `skip`.
    pub nuclei: Option<Nuclei>,
    /// Treatment of contours that were drawn on slices of a volume. Default: `space`.
    pub contours: Option<Contours>,
    /// Source of the names of the shapes of a file. Default: `name`, of DICOM that is stored `id`.
    pub names: Option<Names>,
    /// Which files of a project are read. Default: local particles, else world particles.
    pub files: Option<ProjectFiles>,
    /// Names of attributes to take, as patterns like those of `select`; the others are counted. Default: all.
    pub attributes: Option<String>,
    /// Decimal separator of numbers. Default: a comma where fields are separated otherwise and the first rows have one.
    pub decimal: Option<Decimal>,
    /// Number of cells below which a component of a label is left out and counted. Default: 5, the fewest that enclose a cell.
    pub least_cells: Option<usize>,
    /// Whether only the largest component of each label is taken; the others are counted. Default: all are.
    pub largest: Option<bool>,
    /// Whether holes and cavities of labels are filled, and handles of those in space. Default: they are not.
    pub fill: Option<bool>,
    /// Standard deviation of a Gaussian blur of the cells of a component before its boundary is placed, in the unit of the coordinates.
    pub blur: Option<f64>,
    /// Treatment of an image that looks like a photograph where labels are expected. Default: `refuse`.
    pub photograph: Option<Photograph>,
    /// Demands beside the options, where records become stored shapes. No option by name.
    #[serde(skip)]
    pub storing: Option<Storing>,
}

/// Decimal separator of numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Decimal {
    /// `1.5`.
    Point,
    /// `1,5`.
    Comma,
}

/// Treatment of an image that looks like a photograph where labels are expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Photograph {
    /// It is refused.
    #[default]
    Refuse,
    /// Its grey values are taken for labels.
    Read,
}

/// How records are read that become stored shapes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Storing {
    /// Whether broken records are counted and left out, as far as those after them can be read.
    pub skips_broken: bool,
    /// Whether records say who they are of: [`Record::person`](super::Record::person).
    pub persons: bool,
}

/// Treatment of scales.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scale {
    /// Coordinates are multiplied by them; a file in which some specimens have none is refused.
    Apply,
    /// Coordinates stay as they are, with the scale in the metadata.
    Leave,
}

/// Treatment of curves beside landmarks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Curves {
    /// Each is a separate record after the landmarks.
    #[default]
    Separate,
    /// Their points follow the landmarks as semilandmarks.
    Append,
    /// They are left out and counted.
    Skip,
    /// The landmarks are left out and counted.
    Only,
}

/// Names of the columns of a table, case ignored.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Columns {
    /// Name of the shape.
    pub id: Option<String>,
    /// Class label.
    pub label: Option<String>,
    /// Subject.
    pub subject: Option<String>,
    /// Weight in means.
    pub weight: Option<String>,
    /// Number or name of a point, in tables with one point a row.
    pub point: Option<String>,
    /// Columns of coordinates: `["x", "y"]` with one point a row; in tables with one shape a row all of them in order,
    /// or one pattern with `*` for all columns that match it; the column or array of lists in Parquet, Arrow and NPZ files.
    pub coordinates: Option<Vec<String>>,
    /// Attributes to take. Default: all other columns.
    pub attributes: Option<Vec<String>>,
}

/// Treatment of rings that bound holes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Holes {
    /// They are left out and counted.
    #[default]
    Skip,
    /// They become separate records.
    Keep,
    /// A file that has some is refused.
    Refuse,
}

/// Treatment of the outlines of nuclei beside those of their cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Nuclei {
    /// They are left out and counted.
    #[default]
    Skip,
    /// They become separate records, named `{cell}/nucleus`.
    Keep,
    /// They are the only outlines that become records.
    Only,
}

/// Treatment of contours that were drawn on slices of a volume.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Contours {
    /// Curves with three coordinates, as in the file.
    #[default]
    Space,
    /// Curves with two coordinates in the plane of their slice, as cohorts of planar curves take them.
    Plane,
    /// One surface for each region, through its slices.
    Stack,
}

/// Source of the names of the shapes of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Names {
    /// Their name; their id where they have none.
    #[default]
    Name,
    /// Their id, for files in which several have one name; their name where they have none.
    Id,
    /// Their place in the file, from 1.
    Number,
}

/// Which files of a project are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ProjectFiles {
    /// Points in correspondence, each shape in its own frame.
    LocalParticles,
    /// Points in correspondence, all shapes in the common frame.
    WorldParticles,
    /// Prepared surfaces, segmentations and contours.
    Groomed,
    /// Surfaces, segmentations and contours as they came.
    Shape,
    /// Landmarks.
    LandmarksFile,
}

/// Options that every format obeys.
pub const EVERY: [&str; 1] = ["names"];

impl ReadOptions {
    /// Counts a broken record that is left out, if it is.
    ///
    /// # Errors
    /// The fault itself, if the file is refused for it.
    pub(super) fn leave_out(&self, error: FileError, summary: &mut Summary) -> Result<(), FileError> {
        if !self.leaves_out(&error) {
            return Err(error);
        }
        let FileError { place, detail, .. } = error;
        summary.drop(BROKEN, Some(&detail), || *place);
        Ok(())
    }

    /// The next line, as [`Source::next_line`] reads it. One of other bytes than text is a broken record.
    pub(super) fn next_line(
        &self,
        source: &mut Source<'_>,
        line: &mut String,
        summary: &mut Summary,
    ) -> Result<bool, FileError> {
        loop {
            match source.next_line(line) {
                // Faults of the stream have no line.
                Err(error) if error.place.line.is_some() => self.leave_out(error, summary)?,
                found => return found,
            }
        }
    }

    /// Whether a record with this fault is left out, and those after it are read.
    pub(super) fn leaves_out(&self, error: &FileError) -> bool {
        matches!(error.kind, FaultKind::Malformed | FaultKind::Unsupported) && self.skips_broken()
    }

    /// Whether broken records are left out.
    pub(super) fn skips_broken(&self) -> bool {
        self.storing.is_some_and(|storing| storing.skips_broken)
    }

    /// Options by name, as texts of a query or of a command line.
    ///
    /// # Errors
    /// [`FaultKind::Option`], at the name of an option that does not exist, is given twice or has another type.
    pub fn from_pairs<'a>(pairs: impl IntoIterator<Item = (&'a str, &'a str)>) -> Result<Self, FileError> {
        from_pairs("reading", pairs)
    }

    /// Refuses options that the format does not have.
    pub(super) fn check(&self, format: &Format) -> Result<(), FileError> {
        let given = serde_json::to_value(self).unwrap_or_default();
        let given = given.as_object().into_iter().flatten().filter(|(_, value)| !value.is_null());
        for (name, _) in given {
            if !format.options.contains(&name.as_str())
                && !EVERY.contains(&name.as_str())
                && format.options != ["*"]
            {
                let known = if format.options.is_empty() { "none".into() } else { format.options.join(", ") };
                let detail = format!("expected options of {} ({known}), got {name}", format.name);
                return Err(FileError::of(FaultKind::Option, Place::tag(name), detail));
            }
        }
        Ok(())
    }

    /// Name of the column or array that holds the points, in files that have one for all coordinates.
    pub(super) fn points_column(&self) -> Option<&str> {
        self.columns.as_ref()?.coordinates.as_ref()?.first().map(String::as_str)
    }

    /// Whether a name is selected. `*` stands for any text and `?` for one character.
    pub fn selects(&self, name: &str) -> bool {
        self.select.as_ref().is_none_or(|select| has_match(select, name))
    }

    /// Takes the attributes that are not wanted from a record, and counts them.
    pub(super) fn thin(&self, record: &mut Record, summary: &mut Summary) {
        let Some(wanted) = &self.attributes else { return };
        let Record { labels, place, .. } = record;
        labels.retain(|name, _| {
            let is_wanted = has_match(wanted, name);
            if !is_wanted {
                summary.drop("attributes that are not selected", Some(name), || place.clone());
            }
            is_wanted
        });
    }
}

/// Whether one of the patterns, with commas between them, matches a name; case does not count.
fn has_match(patterns: &str, name: &str) -> bool {
    let name = name.to_lowercase();
    let matches = |pattern: &str| matches_pattern(pattern.trim().to_lowercase().as_bytes(), name.as_bytes());
    patterns.split(',').any(matches)
}

/// Linear in the lengths, up to the length of the text that the last star covers.
pub(super) fn matches_pattern(pattern: &[u8], text: &[u8]) -> bool {
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

impl WriteOptions {
    /// Whether numbers are written as text, where a format has both.
    pub(super) fn is_text(&self) -> bool {
        self.encoding == Some(Encoding::Text)
    }

    /// Options by name, as texts of a query or of a command line.
    ///
    /// # Errors
    /// As [`ReadOptions::from_pairs`].
    pub fn from_pairs<'a>(pairs: impl IntoIterator<Item = (&'a str, &'a str)>) -> Result<Self, FileError> {
        let options: Self = from_pairs("writing", pairs)?;
        options.check()?;
        Ok(options)
    }

    /// Refuses numbers beyond their bounds.
    pub(super) fn check(&self) -> Result<(), FileError> {
        let is_outside = |harmonics: &usize| !(1..=MAX_HARMONICS).contains(harmonics);
        match self.harmonics.filter(is_outside) {
            Some(harmonics) => {
                let detail = format!("expected 1 to {MAX_HARMONICS} harmonics, got {harmonics}");
                Err(FileError::of(FaultKind::Option, Place::tag("harmonics"), detail))
            }
            None => Ok(()),
        }
    }
}

/// Reads each option alone, so that a fault has its name. A value that is not a number, list or Boolean of the right type is a text.
fn from_pairs<'a, T: Default + Serialize + DeserializeOwned>(
    of: &str,
    pairs: impl IntoIterator<Item = (&'a str, &'a str)>,
) -> Result<T, FileError> {
    let fault = |name: &str, detail: String| {
        Err(FileError { kind: FaultKind::Option, place: Box::new(Place::tag(name)), detail })
    };
    let mut options = Map::new();
    let known = serde_json::to_value(T::default()).unwrap_or_default();
    for (name, text) in pairs {
        if known.get(name).is_none() {
            let known = known.as_object().into_iter().flatten().map(|(name, _)| name.as_str());
            let known = known.collect::<Vec<_>>().join(", ");
            return fault(name, format!("expected an option of {of} ({known}), got {name}"));
        }
        let typed = serde_json::from_str::<Value>(text).ok();
        let fits = |value: &Value| {
            let one = Map::from_iter([(name.to_owned(), value.clone())]);
            serde_json::from_value::<T>(Value::Object(one)).map(drop)
        };
        let value = match typed.filter(|value| fits(value).is_ok()) {
            Some(value) => value,
            None => Value::String(text.to_owned()),
        };
        if let Err(error) = fits(&value) {
            return fault(name, format!("expected {}, got '{text}'", wanted(&error.to_string())));
        }
        if options.insert(name.to_owned(), value).is_some() {
            return fault(name, "expected one value, got several".into());
        }
    }
    serde_json::from_value(Value::Object(options)).or_else(|error| fault("options", error.to_string()))
}

/// Expected value, by the message of its reader: the words of a list, or a type.
fn wanted(message: &str) -> String {
    let wanted = message.split_once("expected ").map_or("another value", |(_, wanted)| wanted);
    let wanted = wanted.split(" at line ").next().unwrap_or(wanted);
    match wanted {
        "usize" | "u64" | "u32" => "a whole number from 0".into(),
        "a boolean" => "true or false".into(),
        wanted if wanted.starts_with("struct ") || wanted.starts_with('`') && wanted.contains(":") => {
            "an object".into()
        }
        wanted => wanted.replace('`', "").trim_start_matches("one of ").to_owned(),
    }
}

/// Maximum number of harmonics that can be asked for.
pub const MAX_HARMONICS: usize = 1024;

/// Options of writing.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WriteOptions {
    /// Unit of the coordinates, where a format has a place for it.
    pub unit: Option<String>,
    /// Text or binary, where a format has both. Default: `binary`.
    pub encoding: Option<Encoding>,
    /// Shape of tables. Default: one shape a row.
    pub layout: Option<Layout>,
    /// Number of harmonics of Fourier coefficients, 1 to 1024. Default: as many as the shape with most of them has.
    pub harmonics: Option<usize>,
    /// Headers of the images that a structure set refers to, all of one series (`dicom::series` reads them).
    /// They identify a patient, and are not an option by name: a query must not carry them.
    #[serde(skip)]
    pub series: Vec<SeriesImage>,
    /// When the file is made, where a format has a place for it: `2026-11-26T03:00:00`. No date if absent.
    pub created: Option<String>,
    /// Number of shapes that will be written, where it is known: formats that begin with it then hold none of them.
    #[serde(skip)]
    pub shapes: Option<u64>,
    /// Further facts about the shapes, by name, where a format has a place for it: representation, cohort, revision.
    #[serde(skip)]
    pub facts: std::collections::BTreeMap<String, String>,
}

/// How numbers are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Encoding {
    /// As text, with all digits.
    Text,
    /// As bytes.
    Binary,
}

/// Shape of tables of points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// One shape a row.
    #[default]
    Wide,
    /// One point a row.
    Long,
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

    #[test]
    fn options_are_read_from_texts() {
        let read = |pairs: &[(&'static str, &'static str)]| ReadOptions::from_pairs(pairs.iter().copied());
        let options =
            read(&[("select", "12"), ("holes", "keep"), ("closed", "true")]).expect("valid options");
        let expected = (Some("12"), Some(Holes::Keep), Some(true));
        assert_eq!((options.select.as_deref(), options.holes, options.closed), expected);
        for (pairs, message) in [
            (&[("colour", "red")][..], "colour: expected an option of reading ("),
            (&[("closed", "perhaps")], "closed: expected true or false, got 'perhaps'"),
            (&[("closed", "true"), ("closed", "true")], "closed: expected one value, got several"),
        ] {
            let error = read(pairs).expect_err("a fault");
            assert_eq!(error.kind, FaultKind::Option);
            assert!(error.to_string().starts_with(message), "{error}");
        }
    }
}
