//! Faults of a request, collected over several checks.

use super::error::ServiceError;
use crate::wire::fault::Fault;

/// Maximum number of faults in a response: a broken export of a million shapes has a fault in each of them.
pub const MAX_FAULTS: usize = 100;

/// Faults of a request, collected over several checks so that one response names all of them: the first
/// [`MAX_FAULTS`], and the number of those that follow.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Faults {
    listed: Vec<Fault>,
    unlisted: usize,
    /// Whether one fault is listed for all that say the same.
    joins: bool,
}

impl Faults {
    /// Faults of a file: of those that say the same, the first one is listed with their number.
    pub fn of_file() -> Self {
        Self { joins: true, ..Self::default() }
    }

    /// Adds a fault.
    pub fn add(&mut self, pointer: impl Into<String>, detail: impl Into<String>) {
        self.extend([Fault::new(pointer, detail)]);
    }

    /// Value of a check; its faults are added to the others.
    ///
    /// # Errors
    /// Errors other than faults of the input.
    pub fn keep<T>(&mut self, checked: Result<T, ServiceError>) -> Result<Option<T>, ServiceError> {
        match checked {
            Ok(value) => Ok(Some(value)),
            Err(ServiceError::Invalid(found)) => {
                self.append(found);
                Ok(None)
            }
            Err(other) => Err(other),
        }
    }

    /// Value of a reader below a pointer; its faults are added to the others.
    pub fn keep_below<T>(&mut self, pointer: &str, read: Result<T, Vec<Fault>>) -> Option<T> {
        read.map_err(|found| self.extend(found.into_iter().map(|fault| fault.below(pointer)))).ok()
    }

    /// Adds the faults of another collection.
    pub fn append(&mut self, other: Self) {
        self.extend(other.listed);
        self.unlisted += other.unlisted;
    }

    /// Number of faults, including those that are not listed.
    pub fn count(&self) -> usize {
        self.listed.iter().map(|fault| fault.alike.as_ref().map_or(1, |alike| alike.count)).sum::<usize>()
            + self.unlisted
    }

    /// The listed faults.
    pub fn listed(&self) -> &[Fault] {
        &self.listed
    }

    /// The listed faults.
    pub fn into_listed(self) -> Vec<Fault> {
        self.listed
    }

    /// The same faults, each changed by `change`: placed below a pointer, or given an index.
    pub fn map(self, change: impl Fn(Fault) -> Fault) -> Self {
        Self { listed: self.listed.into_iter().map(change).collect(), ..self }
    }

    /// Succeeds if there are no faults; otherwise fails with all of them.
    ///
    /// # Errors
    /// [`ServiceError::Invalid`].
    pub fn unless_any(self) -> Result<(), ServiceError> {
        if self.count() == 0 { Ok(()) } else { Err(ServiceError::Invalid(self)) }
    }
}

impl Extend<Fault> for Faults {
    fn extend<I: IntoIterator<Item = Fault>>(&mut self, faults: I) {
        for fault in faults {
            if self.joins && self.listed.iter_mut().any(|listed| listed.joins(&fault)) {
                continue;
            }
            if self.listed.len() < MAX_FAULTS {
                self.listed.push(fault);
            } else {
                self.unlisted += 1;
            }
        }
    }
}

impl FromIterator<Fault> for Faults {
    fn from_iter<I: IntoIterator<Item = Fault>>(faults: I) -> Self {
        let mut all = Self::default();
        all.extend(faults);
        all
    }
}

impl From<Vec<Fault>> for Faults {
    fn from(faults: Vec<Fault>) -> Self {
        faults.into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::files::Place;

    #[test]
    fn all_faults_are_counted_and_the_first_are_listed() {
        let fault = |i: usize| Fault::new(format!("/{i}"), "wrong");
        let (mut all, more): (Faults, Faults) =
            ((0..70).map(fault).collect(), (70..150).map(fault).collect());
        assert_eq!(all.keep(Ok(1)).unwrap(), Some(1));
        assert_eq!(all.keep::<()>(Err(ServiceError::Invalid(more))).unwrap(), None);
        assert_eq!((all.count(), all.listed().len()), (150, MAX_FAULTS));
        assert_eq!(all.listed()[99].pointer, "/99");
        let at = |i: u64| Fault::new("/points", "wrong").at_place(&Place::item(i));
        let mut of_file = Faults::of_file();
        of_file.extend((0..177).map(at).chain([fault(0)]));
        assert_eq!((of_file.count(), of_file.listed().len()), (178, 2));
        let first = &of_file.listed()[0];
        let alike = first.alike.as_ref().unwrap();
        assert_eq!((alike.count, alike.more.len(), alike.more[0].item), (177, 4, Some(1)));
        assert!(all.keep::<()>(Err(ServiceError::Cancelled)).is_err());
        assert!(matches!(all.unless_any(), Err(ServiceError::Invalid(all)) if all.count() == 150));
        assert!(Faults::default().unless_any().is_ok());
    }
}
