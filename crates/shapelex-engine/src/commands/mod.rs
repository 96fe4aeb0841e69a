//! The commands of the program.

#[cfg(feature = "cluster")]
pub(crate) mod cluster;
pub(crate) mod dictionary;
#[cfg(feature = "approximate")]
pub(crate) mod index;
pub(crate) mod machines;
pub(crate) mod maintenance;
pub(crate) mod pass;
pub(crate) mod regression;
pub(crate) mod search;
pub(crate) mod selection;
pub(crate) mod statistics;

use std::io::Write;
use std::time::Instant;

use serde::Serialize;
use shapelex_analysis::transformation::Transformation;
use shapelex_engine::EngineError;
use shapelex_engine::pass::engine::Took;
use shapelex_engine::pass::source::AtRest;

/// Reads a word of the API.
fn json_word<T: serde::de::DeserializeOwned>(word: &str) -> Result<T, String> {
    serde_json::from_value(word.into()).map_err(|error| error.to_string())
}

/// Reads a class of transformations: its name, or an object.
fn transformation(text: &str) -> Result<Transformation, String> {
    if text.trim_start().starts_with('{') {
        return serde_json::from_str(text).map_err(|error| error.to_string());
    }
    json_word(text)
}

/// A result over a revision, where it comes from, and what it took.
#[derive(Debug, Serialize)]
pub(crate) struct Answer<T> {
    cohort: String,
    revision: u64,
    revision_digest: String,
    seconds: f64,
    passes: Vec<Took>,
    #[serde(flatten)]
    found: T,
}

impl<T> Answer<T> {
    /// What was found over the shapes of `source` since `began`.
    fn new(source: &AtRest<'_>, began: Instant, found: T) -> Self {
        let revision = source.revision();
        let cohort = &revision.manifest().cohort;
        Self {
            cohort: cohort.id.clone(),
            revision: cohort.revision,
            revision_digest: revision.digest().into(),
            seconds: began.elapsed().as_secs_f64(),
            passes: source.took(),
            found,
        }
    }
}

/// Writes an answer to standard output.
pub(crate) fn print(value: &impl Serialize) -> Result<(), EngineError> {
    let mut out = std::io::stdout().lock();
    serde_json::to_writer_pretty(&mut out, value).map_err(std::io::Error::from)?;
    writeln!(out)?;
    Ok(())
}
