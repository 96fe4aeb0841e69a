//! Common data of the operators of a plan.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};

use arrow_array::Array;
use bytes::Bytes;
use datafusion_common::DataFusionError;
use object_store::PutMode;
use object_store::path::Path;
use serde::{Deserialize, Serialize};
#[cfg(feature = "cluster")]
use shapelex_analysis::accumulate::FAN_IN;
use shapelex_analysis::accumulate::PART;
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::dictionary::in_use::Dictionary;
use shapelex_analysis::transformation::Transformation;
use shapelex_analysis::watch::Unwatched;
use tokio::sync::OnceCell;

use super::codes;
use super::learn::Coded;
use super::subject::Subject;
use super::work::{CodedPart, Work, write_files};
use crate::EngineError;
use crate::cohort::part::Numbers;
use crate::cohort::revision::{Revision, Setting};
use crate::cohort::{codes_path, learning_folder};
use crate::dictionary::Named;
use crate::objects::{Length, Objects};

/// Maximum size of a file of codes: all of the shapes of a part with as many atoms as a dictionary may have.
const MAX_CODES: u64 = 4 << 30;

/// Begin of the text of an error of our own within that of an engine.
const BEGIN: &str = "[engine: ";

/// Description of a pass, as a serialisable value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Description {
    /// Id of the cohort.
    pub(crate) cohort: String,
    /// Revision.
    pub(crate) revision: u64,
    /// Digest of the revision: another machine may see another store.
    pub(crate) digest: String,
    /// Class of transformations that is removed.
    pub(crate) transformation: Transformation,
    /// The alignment that was asked for.
    pub(crate) alignment: Option<Alignment>,
    /// The computation.
    pub(crate) work: Work,
}

/// Input of a unit of work.
pub(crate) enum Input {
    /// The numbers of a part.
    Part(Numbers),
    /// The numbers of a part, and the codes from which those of its shapes start.
    Learning(Numbers, Option<Bytes>),
}

/// Result of a unit of work.
pub(crate) enum Made {
    /// Its result.
    State(Vec<u8>),
    /// A file, whose place is its result.
    File {
        /// The file.
        bytes: Bytes,
        /// Number of shapes.
        shapes: u64,
    },
    /// Its result, and codes that the next epoch starts from.
    Learnt(Coded),
}

/// A pass over a revision, which is opened when the first part is read.
#[derive(Debug)]
pub(crate) struct Task {
    pub(crate) description: Description,
    /// Where the revision is; `None` on a machine that reads no parts.
    objects: Option<Objects>,
    opened: OnceCell<Subject>,
    /// The error of the part with the lowest number, among those that were found before the plan ended.
    failure: Mutex<Option<(usize, EngineError)>>,
}

impl Task {
    /// A pass over an open revision.
    pub(crate) fn new(subject: Subject, work: Work) -> Self {
        let Subject { revision, setting, .. } = &subject;
        let cohort = &revision.manifest().cohort;
        let description = Description {
            cohort: cohort.id.clone(),
            revision: cohort.revision,
            digest: revision.digest().into(),
            transformation: setting.transformation.clone(),
            alignment: setting.alignment,
            work,
        };
        let opened = OnceCell::new_with(Some(subject));
        Self { description, objects: None, opened, failure: Mutex::default() }
    }

    /// A pass that another process described.
    #[cfg(feature = "cluster")]
    pub(crate) fn described(description: Description, objects: Option<Objects>) -> Self {
        Self { description, objects, opened: OnceCell::new(), failure: Mutex::default() }
    }

    /// The revision and its surroundings, opened.
    ///
    /// # Errors
    /// [`EngineError::Refused`] for a revision of another digest, and where there is no store; errors of the store.
    async fn opened(&self) -> Result<&Subject, EngineError> {
        self.opened.get_or_try_init(|| self.open()).await
    }

    async fn open(&self) -> Result<Subject, EngineError> {
        let Description { cohort, revision: number, digest, transformation, alignment, work } =
            &self.description;
        let objects = self.objects.clone();
        let objects =
            objects.ok_or_else(|| EngineError::refused("store", "expected a machine with a store"))?;
        let revision = Revision::open(objects.clone(), cohort, *number).await?;
        if revision.digest() != digest {
            let detail = format!("expected digest {digest}, got {}", revision.digest());
            return Err(EngineError::refused(format!("revision {number} of '{cohort}'"), detail));
        }
        let (dictionary, setting) = match work.dictionary() {
            None => (None, Setting::new(revision.manifest(), transformation, *alignment)?),
            Some(digest) => {
                let (named, setting) = Named::open(&objects, &revision, digest).await?;
                (Some(Arc::new(named)), setting)
            }
        };
        Ok(Subject::new(Arc::new(revision), Arc::new(setting), dictionary))
    }

    /// Folder of the codes of all dictionaries that are being learnt from the revision.
    fn learning(&self) -> Result<Path, EngineError> {
        learning_folder(&self.description.cohort, self.description.revision)
    }

    /// Reads the input of the unit `k`.
    pub(crate) async fn read(&self, k: usize) -> Result<Input, EngineError> {
        let Subject { revision, setting, .. } = self.opened().await?;
        let Work::Learn(learn) = &self.description.work else {
            return revision.read(k, &self.description.work.lists()).await.map(Input::Part);
        };
        let numbers = revision.read(learn.part(k).0, &[]).await?;
        let known = match learn.path_before(setting, &self.learning()?, k)? {
            Some(path) => Some(revision.objects().read(&path, Length::UpTo(MAX_CODES)).await?),
            None => None,
        };
        Ok(Input::Learning(numbers, known))
    }

    /// Result of the work for the unit `k`.
    ///
    /// # Errors
    /// A degenerate shape, with its position in the revision.
    pub(crate) fn make(&self, k: usize, input: Input) -> Result<Made, EngineError> {
        let setting = &*self.subject()?.setting;
        let numbers = match input {
            Input::Part(numbers) => numbers,
            Input::Learning(numbers, known) => return self.learn(k, numbers, known),
        };
        let located = |error| after(error, k * PART);
        match &self.description.work {
            Work::Sum(pass) => {
                let sum =
                    setting.shapes(numbers).and_then(|shapes| Ok(pass.make(&shapes, setting.measured())?));
                sum.map(Made::State).map_err(located)
            }
            Work::Certify(_) => {
                let dictionary = self.dictionary()?;
                let coded =
                    setting.shapes(numbers).and_then(|shapes| Ok(dictionary.coded(&shapes, &Unwatched)?));
                coded.map(|coded| Made::State(coded.to_bytes())).map_err(located)
            }
            Work::Code(digest) => {
                let (dictionary, ids) = (self.dictionary()?, numbers.ids()?);
                let shapes = ids.len() as u64;
                let bytes = setting.shapes(numbers);
                let bytes = bytes.and_then(|shapes| codes::encode(dictionary, digest, &shapes, ids));
                Ok(Made::File { bytes: bytes.map_err(located)?.into(), shapes })
            }
            Work::Regress(regress) => regress.of(setting, k, numbers).map(Made::State).map_err(located),
            Work::Learn(_) => Err(EngineError::refused("pass", "expected codes, got a part alone")),
        }
    }

    fn learn(&self, k: usize, numbers: Numbers, known: Option<Bytes>) -> Result<Made, EngineError> {
        let Work::Learn(learn) = &self.description.work else {
            return Err(EngineError::refused("pass", "expected a part, got codes beside it"));
        };
        let (part, shapes) = learn.part(k);
        let coded = learn.of(&self.subject()?.setting, k, numbers, known.as_deref());
        coded.map(Made::Learnt).map_err(|error| after(error, part * PART + shapes.start))
    }

    /// The result of the unit `k`; a file is written first.
    ///
    /// # Errors
    /// Errors of the store.
    pub(crate) async fn keep(&self, k: usize, made: Made) -> Result<Vec<u8>, EngineError> {
        self.count(1);
        let revision = &self.subject()?.revision;
        let (bytes, shapes) = match made {
            Made::State(state) => return Ok(state),
            Made::File { bytes, shapes } => (bytes, shapes),
            Made::Learnt(Coded { state, codes }) => {
                if let (Some(codes), Work::Learn(learn)) = (codes, &self.description.work) {
                    let path = learn.path(&self.learning()?, k);
                    revision.objects().write(&path, codes, PutMode::Overwrite).await?;
                }
                return Ok(state);
            }
        };
        let Description { cohort, work, .. } = &self.description;
        let dictionary = work.dictionary().unwrap_or_default();
        let (digest, size_bytes) = (blake3::hash(&bytes).to_hex().to_string(), bytes.len() as u64);
        let part = revision.manifest().parts[k].digest.clone();
        let path = codes_path(cohort, dictionary, &part)?;
        let state = write_files(&[CodedPart { part, shapes, digest, size_bytes }])?;
        revision.objects().write(&path, bytes, PutMode::Overwrite).await?;
        Ok(state)
    }

    /// Counts units that are done.
    pub(crate) fn count(&self, units: usize) {
        if let Some(subject) = self.opened.get() {
            subject.done.fetch_add(units, Ordering::Relaxed);
            subject.revision.objects().counters().units.fetch_add(units as u64, Ordering::Relaxed);
        }
    }

    /// The result of consecutive parts from their results, in this order.
    ///
    /// # Errors
    /// Bytes that are not a result of this work.
    pub(crate) fn merge(&self, states: &[&[u8]]) -> Result<Vec<u8>, EngineError> {
        self.description.work.merge(states, &self.subject()?.setting)
    }

    /// The result of all parts from those of consecutive parts or groups, by the tree of all passes: 64 become one until one is
    /// left.
    #[cfg(feature = "cluster")]
    pub(crate) fn fold(&self, mut states: Vec<Vec<u8>>) -> Result<Option<Vec<u8>>, EngineError> {
        while states.len() > 1 {
            let group = |group: &[Vec<u8>]| self.merge(&group.iter().map(Vec::as_slice).collect::<Vec<_>>());
            states = states.chunks(FAN_IN).map(group).collect::<Result<_, _>>()?;
        }
        Ok(states.pop())
    }

    fn subject(&self) -> Result<&Subject, EngineError> {
        self.opened.get().ok_or_else(|| EngineError::refused("pass", "nothing was read yet"))
    }

    fn dictionary(&self) -> Result<&Dictionary, EngineError> {
        let named = self.subject()?.dictionary.as_ref();
        named
            .map(|named| &named.dictionary)
            .ok_or_else(|| EngineError::refused("pass", "expected a dictionary, got none"))
    }

    /// Keeps the error of a part, which DataFusion would wrap in others, and tells DataFusion to end.
    pub(crate) fn fail(&self, part: usize, error: EngineError) -> DataFusionError {
        if let Some(objects) = &self.objects {
            objects.counters().failures.fetch_add(1, Ordering::Relaxed);
        }
        let text = format!("{BEGIN}{error}]");
        let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        if failure.as_ref().is_none_or(|(before, _)| part < *before) {
            *failure = Some((part, error));
        }
        DataFusionError::Execution(text)
    }

    /// The error that was kept, else that of DataFusion.
    pub(crate) fn error(&self, error: DataFusionError) -> EngineError {
        let failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner).take();
        failure.map_or_else(|| error.into(), |(_, own)| own)
    }
}

/// The error of a shape whose position is counted from the shape at `first`, counted from the first of the revision.
fn after(error: EngineError, first: usize) -> EngineError {
    match error {
        EngineError::Analysis(error) => error.after(first).into(),
        other => other,
    }
}

/// Our own error in the text of an engine, as [`Task::fail`] wrote it on another machine.
#[cfg(feature = "cluster")]
pub(crate) fn own_error(text: &str) -> Option<&str> {
    let own = &text[text.rfind(BEGIN)? + BEGIN.len()..];
    own.rfind(']').map(|end| &own[..end])
}

#[cfg(all(test, feature = "cluster"))]
mod tests {
    use super::own_error;

    #[test]
    fn an_error_of_our_own_is_found_within_others() {
        let text = "Task failed: Execution(\"[engine: shape [7] has no extent]\")";
        assert_eq!(own_error(text), Some("shape [7] has no extent"));
        assert_eq!(own_error("Task failed: out of memory"), None);
    }
}
