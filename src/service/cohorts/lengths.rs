//! The unit of a cohort, and that of shapes from a file.
//!
//! | cohort | file states a length | file counts cells | file says nothing |
//! |---|---|---|---|
//! | a length | converted | refused | as it is |
//! | `pixel`, `voxel`, `none` | refused | as it is | as it is |
//! | never set, without shapes | taken over | taken over | as it is |
//! | never set, with shapes | as it is, with a warning | as it is, with a warning | as it is |

use crate::domain::cohort::Cohort;
use crate::formats::lengths::FileUnits;
use crate::formats::unit::{Ratio, Unit};
use crate::service::app::ServiceError;
use crate::store::UnitOfShapes;

/// What is known of the units of shapes on their way to a cohort.
#[derive(Debug, Clone, Default)]
pub struct Lengths {
    /// Text of the cohort.
    former: Option<String>,
    /// Whether it has no shapes.
    is_empty: bool,
    /// Unit of the first shapes that state one, and the one in which shapes are stored.
    met: Option<(Unit, Unit)>,
}

impl Lengths {
    /// Those of a cohort, to which shapes are to come.
    pub fn of(cohort: &Cohort) -> Self {
        Self { former: cohort.spec.length_unit.clone(), is_empty: cohort.shapes == 0, met: None }
    }

    /// Unit of the cohort; `None` if it was never set, or to a text that is none.
    fn known(&self) -> Option<Unit> {
        self.former.as_deref().and_then(Unit::find)
    }

    /// Whether the cohort takes the unit of the shapes.
    fn adopts(&self) -> bool {
        self.is_empty && self.known().is_none()
    }

    /// The unit in which shapes of this one are stored.
    ///
    /// # Errors
    /// A length where shapes have none, and the other way round.
    pub fn meet(&mut self, unit: Unit) -> Result<Unit, ServiceError> {
        let known = self.known();
        let (_, stored) = *self.met.get_or_insert((unit, known.unwrap_or(unit)));
        if unit.to(stored).is_some() {
            return Ok(stored);
        }
        let of = if known.is_some() { "the length unit of the cohort" } else { "as the shapes before" };
        let detail = format!(
            "expected coordinates in {}, {of}, got {}: the parameter unit says what they are in, whatever the file states",
            stored.word(),
            unit.word()
        );
        Err(ServiceError::invalid("", detail))
    }

    /// The conversion of the first shapes, if their numbers change.
    pub fn ratio(&self) -> Option<Ratio> {
        let (unit, stored) = self.met?;
        unit.to(stored).filter(|ratio| *ratio != Ratio::ONE)
    }

    /// What is answered of them.
    pub fn told(&self) -> Option<FileUnits> {
        self.met.map(|(file, stored)| FileUnits::new(file, stored, self.adopts()))
    }

    /// What should be known of a cohort that has shapes and no unit.
    pub fn warning(&self) -> Option<String> {
        let (_, stored) = self.met.filter(|_| !self.is_empty && self.known().is_none())?;
        Some(format!(
            "the cohort has shapes and no length unit: coordinates are stored in {}, whatever those of the other shapes are in",
            stored.word()
        ))
    }

    /// What the store must find when the shapes become visible.
    pub(super) fn at_commit(&self) -> Option<UnitOfShapes> {
        let (_, stored) = self.met?;
        let (former, unit) = (self.former.clone(), stored.word().to_owned());
        Some(UnitOfShapes { former, unit, adopt: self.adopts() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lengths(former: Option<&str>, is_empty: bool) -> Lengths {
        Lengths { former: former.map(str::to_owned), is_empty, met: None }
    }

    #[test]
    fn a_text_that_names_no_unit_counts_as_none() {
        let mut old = lengths(Some("furlong"), true);
        assert_eq!(old.meet(Unit::Millimetre).unwrap(), Unit::Millimetre);
        let unit = UnitOfShapes { former: Some("furlong".into()), unit: "mm".into(), adopt: true };
        assert_eq!(old.at_commit(), Some(unit));
        assert_eq!(old.told(), Some(FileUnits::new(Unit::Millimetre, Unit::Millimetre, true)));
        // One that does is a unit, under whatever spelling.
        let mut spelt = lengths(Some("µm"), true);
        assert_eq!(spelt.meet(Unit::Millimetre).unwrap(), Unit::Micrometre);
        assert!(!spelt.adopts());
        assert!(lengths(Some("px"), true).meet(Unit::Inch).is_err());
    }

    #[test]
    fn all_shapes_of_a_file_are_in_one_unit() {
        let mut found = lengths(None, false);
        assert_eq!((found.at_commit(), found.warning()), (None, None));
        assert_eq!(found.meet(Unit::Centimetre).unwrap(), Unit::Centimetre);
        assert_eq!(found.meet(Unit::Metre).unwrap(), Unit::Centimetre);
        let refused = found.meet(Unit::Pixel).unwrap_err();
        assert!(matches!(refused, ServiceError::Invalid(_)), "{refused}");
        assert!(found.warning().is_some_and(|warning| warning.contains("stored in cm")));
        assert!(!found.adopts());
    }
}
