//! Computations on each part, and how the results of parts become one.

use serde::{Deserialize, Serialize};
use shapelex_analysis::accumulate::{FAN_IN, PART};
use shapelex_analysis::dictionary::model::Coded;
use shapelex_analysis::pass::Pass;

use super::learn::Learn;
use super::regress::Regress;
use crate::EngineError;
use crate::cohort::part::IDS;
use crate::cohort::revision::Setting;

/// Computation on each part. The results of consecutive parts are merged in their order into that of all: sums are added,
/// lists joined.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Work {
    /// A sum over the shapes.
    Sum(Pass),
    /// How well a dictionary describes each shape; the dictionary is named by its digest.
    Certify(String),
    /// The codes of the shapes in a dictionary, written to the store as a file for each part.
    Code(String),
    /// A pass of a regression.
    Regress(Box<Regress>),
    /// The codes of a group of shapes in atoms that are being learnt: their sums. The codes are kept in the store.
    Learn(Box<Learn>),
}

/// Bytes of how well a shape is described.
const CERTIFIED_BYTES: usize = 48;

/// The codes of a part, as a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CodedPart {
    /// Digest of the part.
    pub part: String,
    /// Number of shapes.
    pub shapes: u64,
    /// blake3 digest of the file, hexadecimal.
    pub digest: String,
    /// Its size in bytes.
    pub size_bytes: u64,
}

impl Work {
    /// Number of units of the work in a revision of `parts` parts: the parts that it touches.
    pub fn units(&self, parts: usize) -> usize {
        match self {
            Self::Learn(learn) => learn.units(),
            _ => parts,
        }
    }

    /// About the largest size in bytes of a sorted state: the result of a part, or where results are joined, of a group of them. That
    /// of a sum is the square of the numbers of a shape.
    pub(crate) fn state_bytes(&self, setting: &Setting) -> usize {
        let length = setting.metric.len();
        match self {
            Self::Sum(_) | Self::Code(_) => 8 * length * length,
            Self::Certify(_) => FAN_IN * PART * CERTIFIED_BYTES,
            Self::Regress(regress) => regress.state_bytes(length),
            Self::Learn(learn) => learn.state_bytes(setting),
        }
    }

    /// The lists of a part that are read beside its numbers.
    pub(crate) fn lists(&self) -> Vec<&'static str> {
        match self {
            Self::Sum(_) | Self::Certify(_) | Self::Learn(_) => Vec::new(),
            Self::Code(_) => vec![IDS],
            Self::Regress(regress) => regress.lists(),
        }
    }

    /// The digest of the dictionary that is used.
    pub fn dictionary(&self) -> Option<&str> {
        match self {
            Self::Sum(_) | Self::Regress(_) | Self::Learn(_) => None,
            Self::Certify(digest) | Self::Code(digest) => Some(digest),
        }
    }

    /// The result of consecutive parts from their results, in this order.
    ///
    /// # Errors
    /// Bytes that are not a result of this work.
    pub(crate) fn merge(&self, states: &[&[u8]], setting: &Setting) -> Result<Vec<u8>, EngineError> {
        match self {
            Self::Sum(pass) => Ok(pass.merge(states, setting.measured())?),
            Self::Certify(_) => {
                let mut joined = Coded::default();
                states.iter().try_for_each(|state| joined.append(state))?;
                Ok(joined.to_bytes())
            }
            Self::Regress(regress) => regress.merge(states, setting.metric.len()),
            Self::Learn(learn) => learn.merge(states, setting),
            Self::Code(_) => join(states),
        }
    }
}

/// A list of files of codes as bytes.
pub(crate) fn write_files(files: &[CodedPart]) -> Result<Vec<u8>, EngineError> {
    serde_json::to_vec(files).map_err(|error| EngineError::refused("files", error.to_string()))
}

/// The files of codes of a pass, from its result.
///
/// # Errors
/// Bytes that are not such a result.
pub fn read_files(bytes: &[u8]) -> Result<Vec<CodedPart>, EngineError> {
    serde_json::from_slice(bytes).map_err(|error| EngineError::refused("files", error.to_string()))
}

fn join(lists: &[&[u8]]) -> Result<Vec<u8>, EngineError> {
    let lists: Vec<Vec<CodedPart>> = lists.iter().map(|list| read_files(list)).collect::<Result<_, _>>()?;
    write_files(&lists.concat())
}
