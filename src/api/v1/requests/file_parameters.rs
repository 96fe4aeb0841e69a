//! Query parameters of files: format and name, options of reading and of writing, and how records become shapes.

use std::collections::BTreeMap;

use serde::Serialize;
use utoipa::IntoParams;

use crate::api::extract::TWICE;
use crate::api::media_type::is_form;
use crate::api::operation::ANY_FILE;
use crate::api::problem::{Problem, ProblemKind};
use crate::service::app::{Limits, ServiceError};
use crate::service::cohorts::lengths::Lengths;
use crate::service::cohorts::pseudonyms::SubjectFrom;
use crate::service::cohorts::upload_file::FileToAdd;
use crate::service::files::translate::{Asking, FileReading, to_add};
use crate::service::files::{FileFormat, unknown_format};
use crate::service::shapes::outcome::OnError;
use crate::service::shapes::read::attributes;
use crate::wire::fault::Fault;
use crate::wire::files::{self, ReadOptions, WriteOptions};
use crate::wire::json;
use crate::wire::lengths::unit_of;
use crate::wire::record::{Facts, MAX_SAMPLES, Placing, Plane};
use crate::wire::unit::Unit;
use crate::wire::words::plain_sentence;

/// Parameters of files.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; `FileParameters` reads them")]
pub(in crate::api::v1) struct FileQuery {
    /// Format of the file, as an id, a media type or an ending. Default: the media type of the request, else by the first
    /// bytes, else by the name.
    format: Option<String>,
    /// Name of the file, by which its format is known where its bytes do not tell it, and its shapes are named where they are stored.
    name: Option<String>,
}

/// How records of a file become shapes of a cohort.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; `FileParameters` reads them")]
pub(in crate::api::v1) struct PlacingQuery {
    /// Plane onto which curves and points in space are projected, where the cohort is planar. Default: they are refused.
    #[param(inline)]
    plane: Option<Plane>,
    /// Number of points at which curves given by Fourier coefficients are taken, where the representation of the cohort does
    /// not contain them. Default: they are refused.
    #[param(minimum = 3, maximum = 10_000)]
    samples: Option<usize>,
    /// Text before the names of the shapes, which become their external ids. Default: the name of the file without its ending and a
    /// slash; nothing before names that are identities: those of tables, of NDJSON, and unique identifiers of DICOM.
    prefix: Option<String>,
    /// Unit of the coordinates of the file, whatever the file states: `m`, `cm`, `mm`, `um`, `nm`, `inch`, `pixel`,
    /// `voxel` or `none`. Lengths are converted to the unit of the cohort. Default: the unit that the file states.
    unit: Option<String>,
    /// Subject of the shapes of which the file says none.
    subject: Option<String>,
    /// Entry of the file that names the subject of its shapes. The subject is a keyed digest, the same for a patient in
    /// all files of a tenant.
    #[param(inline)]
    subject_from: Option<SubjectFrom>,
    /// Class label of the shapes of which the file says none.
    label: Option<String>,
    /// Attributes of the shapes that the file does not give them: `labels[site]=zrh`, also written `labels.site=zrh`. A value
    /// that is a number or a Boolean of JSON becomes one, unless it stands in quotation marks.
    #[param(style = DeepObject, explode, value_type = Option<BTreeMap<String, String>>, example = json!({}))]
    labels: Option<BTreeMap<String, String>>,
    /// Weight of the shapes of which the file says none.
    #[param(minimum = 1e-100, maximum = 1e100)]
    weight: Option<f64>,
}

/// Options by name, for the document.
#[cfg(feature = "schema")]
pub(in crate::api::v1) use described::{ReadQuery, WriteQuery};

#[cfg(feature = "schema")]
mod described {
    use utoipa::IntoParams;
    use utoipa::openapi::path::{Parameter, ParameterIn};

    use super::{FileFormat, ReadOptions, WRITE, WriteOptions, names_of};
    use crate::api::describe::text_parameter;
    use crate::wire::files::EVERY;

    /// Options of reading by name, with the formats that have them.
    pub(in crate::api) struct ReadQuery;

    impl IntoParams for ReadQuery {
        fn into_params(_: impl Fn() -> Option<ParameterIn>) -> Vec<Parameter> {
            let of = |name: &str| {
                if EVERY.contains(&name) {
                    return text_parameter(name, "Option of reading files of every format.".to_owned());
                }
                let formats = FileFormat::all().filter(|format| format.options().contains(&name));
                let formats = formats.map(FileFormat::id).collect::<Vec<_>>().join(", ");
                text_parameter(name, format!("Option of reading files of the formats {formats}."))
            };
            names_of(&ReadOptions::default()).iter().map(|name| of(name)).collect()
        }
    }

    /// Options of writing by name.
    pub(in crate::api) struct WriteQuery;

    impl IntoParams for WriteQuery {
        fn into_params(_: impl Fn() -> Option<ParameterIn>) -> Vec<Parameter> {
            let said = "Option of the format that is written.";
            let of = |name: &String| text_parameter(&format!("{WRITE}{name}"), said);
            names_of(&WriteOptions::default()).iter().map(of).collect()
        }
    }
}

/// Media types of files compressed by gzip, whatever they hold.
const GZIP: [&str; 2] = ["application/gzip", "application/x-gzip"];

/// Prefix of the names of options of writing.
const WRITE: &str = "write_";

/// Names of options.
fn names_of(options: &impl Serialize) -> Vec<String> {
    let options = json::to_value(options).unwrap_or_default();
    options.as_object().into_iter().flatten().map(|(name, _)| name.clone()).collect()
}

/// Parameters of a request with a file.
#[derive(Debug)]
pub(in crate::api::v1) struct FileParameters(Vec<(String, String)>);

impl FileParameters {
    /// Takes the parameters that concern files from `pairs`, and leaves the others.
    pub(in crate::api::v1) fn take(pairs: &mut Vec<(String, String)>) -> Self {
        let known = names_of(&ReadOptions::default());
        let own = ["format", "name", "plane", "samples", "prefix", "unit"];
        let is_own = |name: &str| {
            own.contains(&name)
                || FACTS.contains(&name)
                || attribute_of(name).is_some()
                || name.starts_with(WRITE)
                || known.iter().any(|known| known == name)
        };
        let (taken, rest) = std::mem::take(pairs).into_iter().partition(|(name, _)| is_own(name));
        *pairs = rest;
        Self(taken)
    }

    /// Takes from `pairs` the parameters of a file about whose shapes a request asks, and leaves the others.
    pub(in crate::api::v1) fn take_asking(pairs: &mut Vec<(String, String)>) -> Self {
        let known = names_of(&ReadOptions::default());
        let own = ["name", "prefix", "unit"];
        let is_own = |name: &str| own.contains(&name) || known.iter().any(|known| known == name);
        let (taken, rest) = std::mem::take(pairs).into_iter().partition(|(name, _)| is_own(name));
        *pairs = rest;
        Self(taken)
    }

    /// Whether they say the format, whatever the media type.
    pub(in crate::api::v1) fn is_format_stated(&self) -> bool {
        self.0.iter().any(|(name, _)| name == "format")
    }

    /// Whether there are none.
    pub(in crate::api::v1) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Name of the first one.
    pub(in crate::api::v1) fn first(&self) -> &str {
        self.0.first().map_or("", |(name, _)| name)
    }

    /// Takes the value of one parameter.
    fn value(&mut self, name: &str) -> Result<Option<String>, Problem> {
        let Some(at) = self.0.iter().position(|(found, _)| found == name) else { return Ok(None) };
        let (_, value) = self.0.remove(at);
        match self.0.iter().any(|(found, _)| found == name) {
            true => Err(Problem::of_parameter(name, TWICE)),
            false => Ok(Some(value)),
        }
    }

    /// The options of writing.
    pub(in crate::api::v1) fn writing(&mut self) -> Result<WriteOptions, Problem> {
        let Self(writing) = take_writing(&mut self.0);
        let pairs = writing.iter().map(|(name, value)| (&name[WRITE.len()..], value.as_str()));
        WriteOptions::from_pairs(pairs).map_err(|mut error| {
            if let Some(name) = &mut error.place.tag {
                name.insert_str(0, WRITE);
            }
            ServiceError::from(error).into()
        })
    }

    /// Unit of the coordinates of the file, whatever it states.
    fn unit(&mut self) -> Result<Option<Unit>, Problem> {
        let unit = self.value("unit")?.map(|word| unit_of(&word)).transpose();
        unit.map_err(|detail| Problem::of_parameter("unit", detail))
    }

    /// How the shapes of the file become those of a request.
    ///
    /// # Errors
    /// Parameters with values that they cannot have.
    pub(in crate::api::v1) fn asking(
        &mut self,
        on_error: OnError,
        lengths: Lengths,
    ) -> Result<Asking, Problem> {
        Ok(Asking { unit: self.unit()?, prefix: self.value("prefix")?, on_error, lengths })
    }

    /// How a file is read whose request has a media type.
    ///
    /// # Errors
    /// An unknown format; a media type of none without the parameters that tell it.
    pub(in crate::api::v1) fn reading(&mut self, media_type: &str) -> Result<FileReading, Problem> {
        let (format, name) = (self.value("format")?, self.value("name")?);
        let found = match &format {
            Some(word) => {
                let format = FileFormat::find(word).filter(|format| format.is_read());
                Some(format.ok_or_else(|| Problem::of_parameter("format", unknown_format(word).detail))?)
            }
            // The compressed file tells.
            None if media_type == ANY_FILE || GZIP.contains(&media_type) => None,
            None => {
                let mut named = FileFormat::of_media_type(media_type);
                match (named.next(), named.next()) {
                    (Some(format), None) => Some(format),
                    // Several formats: the first bytes tell.
                    (Some(_), Some(_)) => None,
                    // Programs send their own type where they know none of the file: curl that of a web form.
                    (None, _) if name.is_some() && !is_form(media_type) => None,
                    (None, _) => return Err(unsupported(media_type)),
                }
            }
        };
        let options = self.0.iter().map(|(name, value)| (name.as_str(), value.as_str()));
        let options = ReadOptions::from_pairs(options).map_err(ServiceError::from)?;
        Ok(FileReading { format: found, name, options })
    }

    /// The file that a request adds to a cohort.
    ///
    /// # Errors
    /// Parameters with values that they cannot have; as for the format.
    pub(in crate::api::v1) fn into_file(
        mut self,
        media_type: &str,
        on_error: OnError,
        limits: &Limits,
    ) -> Result<FileToAdd, Problem> {
        let plane = self.value("plane")?.map(|word| word_of::<Plane>("plane", &word)).transpose()?;
        let samples =
            self.value("samples")?.map(|text| count_of("samples", &text, MAX_SAMPLES)).transpose()?;
        let prefix = self.value("prefix")?;
        let unit = self.unit()?;
        let subject_from =
            self.value("subject_from")?.map(|word| word_of("subject_from", &word)).transpose()?;
        let facts = self.facts()?;
        let reading = self.reading(media_type)?;
        let name = reading.name.clone();
        let metadata_bytes = limits.metadata_bytes;
        let placing =
            Placing { plane, samples, prefix, unit, name, facts, metadata_bytes, ..Placing::default() };
        check_facts(&placing)?;
        Ok(to_add(reading, placing, (on_error, subject_from), limits))
    }

    /// Facts of all shapes of a file.
    fn facts(&mut self) -> Result<Facts, Problem> {
        let weight = self.value("weight")?.map(|text| {
            let wrong = || Problem::of_parameter("weight", format!("expected a number, got '{text}'"));
            text.parse().map_err(|_| wrong())
        });
        let mut facts = Facts {
            subject: self.value("subject")?,
            label: self.value("label")?,
            weight: weight.transpose()?,
            ..Facts::default()
        };
        let (named, rest): (Vec<_>, _) =
            std::mem::take(&mut self.0).into_iter().partition(|(name, _)| attribute_of(name).is_some());
        self.0 = rest;
        for (parameter, value) in named {
            let Some(name) = attribute_of(&parameter).filter(|name| !facts.labels.contains_key(*name)) else {
                return Err(Problem::of_parameter(&parameter, TWICE));
            };
            facts.add(name, &value);
        }
        Ok(facts)
    }
}

/// Parameters that say something of all shapes of a file, beside their attributes.
const FACTS: [&str; 4] = ["subject", "subject_from", "label", "weight"];

/// Name of the attribute that a parameter gives: `site` of `labels.site` and `labels[site]`.
fn attribute_of(parameter: &str) -> Option<&str> {
    let rest = parameter.strip_prefix("labels")?;
    rest.strip_prefix('.').or_else(|| rest.strip_prefix('[')?.strip_suffix(']'))
}

/// Refuses facts that no shape can have, before the file is read.
fn check_facts(placing: &Placing) -> Result<(), Problem> {
    let Err(faults) = attributes(placing.said()) else { return Ok(()) };
    let named = |fault: Fault| {
        let parameter =
            fault.pointer.trim_start_matches('/').replace('/', ".").replace("~1", "/").replace("~0", "~");
        Fault::of_parameter(parameter, fault.detail)
    };
    Err(ServiceError::Parameters(faults.into_iter().map(named).collect()).into())
}

/// Refusal of a body whose format is not known.
fn unsupported(media_type: &str) -> Problem {
    let known: Vec<&str> =
        FileFormat::all().filter_map(|format| format.media_types().first().copied()).collect();
    let detail = format!(
        "expected application/json for a document, or for a file a media type of a format ({}), application/octet-stream, or the parameter name, got '{media_type}'",
        known.join(", ")
    );
    Problem::new(ProblemKind::UnsupportedMediaType, detail)
}

/// The value that a word of a parameter names.
pub(in crate::api::v1) fn word_of<T: serde::de::DeserializeOwned>(
    name: &str,
    word: &str,
) -> Result<T, Problem> {
    let read = json::from_value(&word.into());
    read.map_err(|error| Problem::of_parameter(name, plain_sentence(&error.to_string())))
}

/// A parameter that is a number of points on a curve.
pub(in crate::api::v1) fn count_of(name: &str, text: &str, most: usize) -> Result<usize, Problem> {
    match text.parse() {
        Ok(count) if (3..=most).contains(&count) => Ok(count),
        _ => Err(Problem::of_parameter(
            name,
            format!("expected a whole number from 3 to {most}, got '{text}'"),
        )),
    }
}

/// Takes the options of writing from `pairs`, and leaves the others.
pub(in crate::api::v1) fn take_writing(pairs: &mut Vec<(String, String)>) -> FileParameters {
    let (taken, rest) = std::mem::take(pairs).into_iter().partition(|(name, _)| name.starts_with(WRITE));
    *pairs = rest;
    FileParameters(taken)
}

/// The format that a word names, if it is written.
pub(in crate::api::v1) fn written(word: &str, parameter: &str) -> Result<&'static files::Format, Problem> {
    written_format(word).ok_or_else(|| unwritten(parameter, word, None))
}

/// The written format with an id, a media type or an ending.
pub(in crate::api::v1) fn written_format(word: &str) -> Option<&'static files::Format> {
    files::find(word).filter(|format| format.is_written())
}

/// All formats that are written.
pub(in crate::api::v1) fn written_formats() -> impl Iterator<Item = &'static files::Format> {
    files::FORMATS.iter().copied().filter(|format| format.is_written())
}

/// Refusal of a word that names no format among those that are written and perhaps another one.
pub(in crate::api::v1) fn unwritten(parameter: &str, word: &str, other: Option<&str>) -> Problem {
    let known: Vec<&str> = other.into_iter().chain(written_formats().map(|format| format.id)).collect();
    let known = known.join(", ");
    let detail = format!("expected one of the formats that are written ({known}), got '{word}'");
    Problem::of_parameter(parameter, detail)
}
