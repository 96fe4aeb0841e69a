//! A group of shapes that is coded with the same atoms, while a sparse dictionary is learnt.
//!
//! A code starts from that of the epoch before, which is kept in the store, a file for each part of a group: the blake3 digest of
//! the rest (32 bytes), the number of codes, and for each the number of its atoms, that of its coefficients, the atoms and the
//! coefficients, little-endian. Equal epochs give equal bytes, so that it does not matter which process wrote them.

use bytes::Bytes;
use object_store::path::Path;
use serde::{Deserialize, Serialize};
use shapelex_analysis::AnalysisError;
use shapelex_analysis::accumulate::{FAN_IN, PART};
use shapelex_analysis::dictionary::learning::Learning;
use shapelex_analysis::dictionary::method::Method;
use shapelex_analysis::preparation::{Posed, Preparation};
use shapelex_analysis::sparse::SparseCode;
use shapelex_analysis::watch::Unwatched;

use crate::EngineError;
use crate::cohort::part::Numbers;
use crate::cohort::revision::Setting;
use crate::objects::Objects;

/// Number of bytes of a digest.
const DIGEST: usize = 32;

/// A group of consecutive shapes, and the atoms for their codes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Learn {
    /// The method, which says how shapes are prepared and coded.
    pub method: Method,
    /// Whitened mean by which shapes are prepared.
    pub mean: Vec<f64>,
    /// Atoms, whitened.
    pub atoms: Vec<f64>,
    /// Position of the first shape.
    pub first: usize,
    /// Position after the last one.
    pub end: usize,
    /// Number of the epoch.
    pub epoch: usize,
    /// Name of the run of learning, which no other process uses.
    pub run: String,
}

/// Results of the shapes of a part: their sums, and their codes as a file unless the next epoch starts afresh.
pub(crate) struct Coded {
    pub(crate) state: Vec<u8>,
    pub(crate) codes: Option<Bytes>,
}

impl Learn {
    /// Number of parts that the group touches.
    pub(crate) fn units(&self) -> usize {
        self.end.div_ceil(PART) - self.first / PART
    }

    /// At most the size of the sums of a group of parts, with as many columns for each atom as a shape has coordinates.
    pub(crate) fn state_bytes(&self, setting: &Setting) -> usize {
        let columns = self.method.atoms() * setting.metric.dimension();
        8 * (columns * columns + self.atoms.len() + FAN_IN * PART)
    }

    /// The part of the unit `k`, and the positions of the group's shapes within it.
    pub(crate) fn part(&self, k: usize) -> (usize, std::ops::Range<usize>) {
        let part = self.first / PART + k;
        let within = |position: usize| position.clamp(part * PART, (part + 1) * PART) - part * PART;
        (part, within(self.first)..within(self.end))
    }

    /// Where the codes of the unit `k` are kept in this epoch, below the folder of all that is learnt from the revision.
    pub(crate) fn path(&self, folder: &Path, k: usize) -> Path {
        self.path_in(self.epoch, folder, k)
    }

    /// Where those of the epoch before are; `None` in the first one, and where codes start afresh.
    ///
    /// # Errors
    /// A method without atoms.
    pub(crate) fn path_before(
        &self,
        setting: &Setting,
        folder: &Path,
        k: usize,
    ) -> Result<Option<Path>, EngineError> {
        match self.epoch.checked_sub(1) {
            Some(before) if self.learning(setting)?.resumes() => Ok(Some(self.path_in(before, folder, k))),
            _ => Ok(None),
        }
    }

    fn path_in(&self, epoch: usize, folder: &Path, k: usize) -> Path {
        let (part, shapes) = self.part(k);
        self.epoch_in(epoch, folder).join(format!("{}.codes", part * PART + shapes.start))
    }

    fn epoch_in(&self, epoch: usize, folder: &Path) -> Path {
        folder.clone().join(self.run.as_str()).join(format!("{epoch:05}"))
    }

    /// Removes, before the first group of an epoch, the codes that neither this epoch nor the next one starts from.
    ///
    /// # Errors
    /// Errors of the store.
    pub async fn remove_old(&self, objects: &Objects, folder: &Path) -> Result<(), EngineError> {
        match self.epoch.checked_sub(2).filter(|_| self.first == 0) {
            Some(old) => objects.remove_all(&self.epoch_in(old, folder)).await,
            None => Ok(()),
        }
    }

    fn learning(&self, setting: &Setting) -> Result<Learning, EngineError> {
        let learning = self.method.learning(&setting.method)?;
        learning.ok_or_else(|| EngineError::refused("method", "expected one with atoms, got components"))
    }

    /// Codes the shapes of the unit `k`, from `known` codes if there are any.
    ///
    /// # Errors
    /// A shape that cannot be coded, with its position in the unit; codes that are not those that were written.
    pub(crate) fn of(
        &self,
        setting: &Setting,
        k: usize,
        numbers: Numbers,
        known: Option<&[u8]>,
    ) -> Result<Coded, EngineError> {
        let (learning, (_, shapes)) = (self.learning(setting)?, self.part(k));
        let known = known.map(read).transpose()?;
        if let Some(codes) = known.as_ref().filter(|codes| codes.len() != shapes.len()) {
            let (expected, got) = (format!("{} of them", shapes.len()), codes.len().to_string());
            return Err(EngineError::damaged("codes of the epoch before", expected, got));
        }
        let preparation =
            Preparation { pose: self.method.pose(&setting.method)?, ..setting.aligned_to(&self.mean, false) };
        let shapes = setting.shapes(numbers.within(shapes))?;
        let posed = Posed { source: &shapes, preparation: &preparation };
        let (coding, codes) = learning.coded(&self.atoms, &posed, known.unwrap_or_default(), &Unwatched)?;
        Ok(Coded { state: coding.to_bytes(), codes: learning.resumes().then(|| write(&codes)) })
    }

    /// The sums of consecutive units from theirs, in this order.
    ///
    /// # Errors
    /// Bytes that are not sums of this group.
    pub(crate) fn merge(&self, states: &[&[u8]], setting: &Setting) -> Result<Vec<u8>, EngineError> {
        let mut all = self.learning(setting)?.coding(setting.metric.len());
        states.iter().try_for_each(|state| all.append(state))?;
        Ok(all.to_bytes())
    }
}

fn write(codes: &[SparseCode]) -> Bytes {
    let mut bytes = vec![0; DIGEST];
    let mut number = |number: usize| bytes.extend((number as u64).to_le_bytes());
    number(codes.len());
    for code in codes {
        number(code.indices.len());
        number(code.values.len());
        code.indices.iter().for_each(|index| number(*index));
        code.values.iter().for_each(|value| number(value.to_bits() as usize));
    }
    let digest = blake3::hash(&bytes[DIGEST..]);
    bytes[..DIGEST].copy_from_slice(digest.as_bytes());
    bytes.into()
}

/// Codes from which others start: without their measurements.
fn read(bytes: &[u8]) -> Result<Vec<SparseCode>, EngineError> {
    let not = || EngineError::from(AnalysisError::NotAnAccumulator);
    let (digest, content) = bytes.split_at_checked(DIGEST).ok_or_else(not)?;
    if blake3::hash(content).as_bytes() != digest {
        return Err(EngineError::damaged("codes of the epoch before", "their digest", "another one"));
    }
    let (numbers, []) = content.as_chunks::<8>() else { return Err(not()) };
    let mut numbers = numbers.iter().map(|number| u64::from_le_bytes(*number));
    let count = numbers.next().ok_or_else(not)?;
    let mut codes = Vec::new();
    for _ in 0..count {
        let lengths = [numbers.next(), numbers.next()].map(|length| length.map(|length| length as usize));
        let [Some(indices), Some(values)] = lengths else { return Err(not()) };
        let indices: Vec<usize> = numbers.by_ref().take(indices).map(|index| index as usize).collect();
        let values: Vec<f64> = numbers.by_ref().take(values).map(f64::from_bits).collect();
        codes.push(SparseCode { indices, values, objective: 0.0, duality_gap: None, relative_error: 0.0 });
    }
    Ok(codes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_the_pieces_of_parts_in_a_group() {
        let group = |first, end| {
            let (mean, atoms, run) = (Vec::new(), Vec::new(), "run".into());
            let learn = Learn { method: Method::sparse(2, 0.1), mean, atoms, first, end, epoch: 0, run };
            (0..learn.units()).map(|k| learn.part(k)).collect::<Vec<_>>()
        };
        assert_eq!(group(0, 100), [(0, 0..100)]);
        assert_eq!(group(128, PART), [(0, 128..PART)]);
        assert_eq!(group(PART - 64, 2 * PART + 1), [(0, PART - 64..PART), (1, 0..PART), (2, 0..1)]);
    }

    #[test]
    fn codes_are_read_as_they_were_written_and_nothing_else_is() {
        let code = |indices: &[usize], values: &[f64]| SparseCode {
            indices: indices.to_vec(),
            values: values.to_vec(),
            objective: 0.0,
            duality_gap: None,
            relative_error: 0.0,
        };
        let codes = [code(&[1, 7], &[0.5, -2.0]), code(&[], &[]), code(&[3], &[1e-300])];
        let bytes = write(&codes);
        assert_eq!(read(&bytes).unwrap(), codes);
        for damaged in [&bytes[..bytes.len() - 8], &bytes[..20], &[bytes.to_vec(), vec![0]].concat()] {
            assert!(read(damaged).is_err());
        }
    }
}
