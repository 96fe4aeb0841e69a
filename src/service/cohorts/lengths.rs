//! The unit of a cohort or of a dictionary, and that of shapes from a file.
//!
//! | cohort | file states a length | file counts cells | file says nothing |
//! |---|---|---|---|
//! | a length | converted | refused | as it is |
//! | `pixel`, `voxel`, `none` | refused | as it is | as it is |
//! | never set, without shapes | taken over | taken over | as it is |
//! | never set, with shapes | as it is, with a warning | as it is, with a warning | as it is |
//!
//! A dictionary is as a cohort with shapes.

use crate::domain::cohort::Cohort;
use crate::store::UnitOfShapes;
use crate::wire::files::{FaultKind, FileError, Record};
use crate::wire::lengths::FileUnits;
use crate::wire::unit::{Ratio, Unit};

/// Taker of the shapes of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Taker {
    /// A cohort without shapes.
    EmptyCohort,
    /// A cohort with shapes.
    Cohort,
    /// A dictionary, which answers a request about the shapes.
    Dictionary,
    /// An answer that depends on no stored shapes.
    #[default]
    Answer,
}

/// Known units of shapes on their way to a cohort, or to the dictionary that answers a request about them.
#[derive(Debug, Clone, Default)]
pub struct Lengths {
    /// Text of the cohort, of the dictionary or of the request.
    former: Option<String>,
    taker: Taker,
    /// Unit of the first shapes that state one, and the one in which shapes are stored.
    met: Option<(Unit, Unit)>,
}

impl Lengths {
    /// Those of a cohort, to which shapes are to come.
    pub fn of(cohort: &Cohort) -> Self {
        let taker = if cohort.shapes == 0 { Taker::EmptyCohort } else { Taker::Cohort };
        Self { former: cohort.spec.length_unit.clone(), taker, met: None }
    }

    /// Those of a dictionary with this length unit, which is asked about shapes.
    pub fn of_dictionary(length_unit: Option<String>) -> Self {
        Self { former: length_unit, taker: Taker::Dictionary, met: None }
    }

    /// Those of a request whose answer has this length unit.
    pub fn of_answer(length_unit: Option<String>) -> Self {
        Self { former: length_unit, taker: Taker::Answer, met: None }
    }

    /// Unit of the taker; `None` if it was never set, or to a text that is none.
    fn known(&self) -> Option<Unit> {
        self.former.as_deref().and_then(Unit::find)
    }

    /// Whether the cohort takes the unit of the shapes.
    fn adopts(&self) -> bool {
        self.taker == Taker::EmptyCohort && self.known().is_none()
    }

    /// The unit to which shapes of this one are converted.
    ///
    /// # Errors
    /// A length where shapes have none, and the other way round.
    pub fn meet(&mut self, unit: Unit) -> Result<Unit, FileError> {
        let known = self.known();
        let (_, stored) = *self.met.get_or_insert((unit, known.unwrap_or(unit)));
        if unit.to(stored).is_some() {
            return Ok(stored);
        }
        let of = match self.taker {
            _ if known.is_none() => "as the shapes before",
            Taker::Dictionary => "the length unit of the dictionary",
            Taker::Answer => "the length unit of the answer",
            Taker::EmptyCohort | Taker::Cohort => "the length unit of the cohort",
        };
        let detail = format!(
            "expected coordinates in {}, {of}, got {}: the parameter unit says what they are in, whatever the file states",
            stored.word(),
            unit.word()
        );
        Err(FileError::new(FaultKind::Unsupported, detail))
    }

    /// A record in the unit of the taker. `given` is its unit, whatever the file states.
    ///
    /// # Errors
    /// As [`meet`](Self::meet), at the place of the record; coordinates beyond the limits in the other unit.
    pub fn convert(&mut self, record: Record, given: Option<Unit>) -> Result<Record, FileError> {
        let Some(unit) = given.or(record.unit) else { return Ok(record) };
        let place = record.place.clone();
        let stored = self.meet(unit);
        stored.and_then(|stored| record.converted(unit, stored)).map_err(|error| error.at(place))
    }

    /// The conversion of the first shapes, if their numbers change.
    pub fn ratio(&self) -> Option<Ratio> {
        let (unit, stored) = self.met?;
        unit.to(stored).filter(|ratio| *ratio != Ratio::ONE)
    }

    /// Answer about them.
    pub fn told(&self) -> Option<FileUnits> {
        self.met.map(|(file, stored)| FileUnits::new(file, stored, self.adopts()))
    }

    /// Warning about a cohort that has shapes and no unit, and about a dictionary without one.
    pub fn warning(&self) -> Option<String> {
        let (_, stored) = self.met.filter(|_| self.known().is_none())?;
        let stored = stored.word();
        match self.taker {
            Taker::Cohort => Some(format!(
                "the cohort has shapes and no length unit: coordinates are stored in {stored}, whatever those of the other shapes are in"
            )),
            Taker::Dictionary => Some(format!(
                "the dictionary has no length unit: coordinates are taken in {stored}, whatever those of its own shapes are in"
            )),
            Taker::EmptyCohort | Taker::Answer => None,
        }
    }

    /// State that the store must find when the shapes become visible.
    pub(super) fn at_commit(&self) -> Option<UnitOfShapes> {
        let (_, stored) = self.met?;
        let (former, unit) = (self.former.clone(), stored.word().to_owned());
        Some(UnitOfShapes { former, unit, adopt: self.adopts() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lengths(former: Option<&str>, taker: Taker) -> Lengths {
        Lengths { former: former.map(str::to_owned), taker, met: None }
    }

    #[test]
    fn a_text_that_names_no_unit_counts_as_none() {
        let mut old = lengths(Some("furlong"), Taker::EmptyCohort);
        assert_eq!(old.meet(Unit::Millimetre).unwrap(), Unit::Millimetre);
        let unit = UnitOfShapes { former: Some("furlong".into()), unit: "mm".into(), adopt: true };
        assert_eq!(old.at_commit(), Some(unit));
        assert_eq!(old.told(), Some(FileUnits::new(Unit::Millimetre, Unit::Millimetre, true)));
        // One that does is a unit, under whatever spelling.
        let mut spelt = lengths(Some("µm"), Taker::EmptyCohort);
        assert_eq!(spelt.meet(Unit::Millimetre).unwrap(), Unit::Micrometre);
        assert!(!spelt.adopts());
        assert!(lengths(Some("px"), Taker::EmptyCohort).meet(Unit::Inch).is_err());
    }

    #[test]
    fn all_shapes_of_a_file_are_in_one_unit() {
        let mut found = lengths(None, Taker::Cohort);
        assert_eq!((found.at_commit(), found.warning()), (None, None));
        assert_eq!(found.meet(Unit::Centimetre).unwrap(), Unit::Centimetre);
        assert_eq!(found.meet(Unit::Metre).unwrap(), Unit::Centimetre);
        let refused = found.meet(Unit::Pixel).unwrap_err();
        assert_eq!(refused.kind, FaultKind::Unsupported, "{refused}");
        assert!(found.warning().is_some_and(|warning| warning.contains("stored in cm")));
        assert!(!found.adopts());
    }
}
