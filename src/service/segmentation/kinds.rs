//! Representations of the objects of a request: one for all, others that are named for single objects, and the finer control meshes of
//! stages that split them.

use super::request::StageInput;
use crate::geometry::representation::Representation;
use crate::segmentation::run::nested::Nested;
use crate::service::app::{App, Limits, ServiceError};
use crate::service::statistics::{CheckedSettings, Setup};
use crate::wire::fault::Fault;

/// Most different representations of a request: each is prepared, with its inner product and its refinement.
const MAX_KINDS: usize = 16;

/// Settings of all objects of a request, each different representation once.
#[derive(Debug)]
pub struct Kinds {
    usual: CheckedSettings,
    /// Further ones, each with the position of the first object that has it.
    others: Vec<(usize, CheckedSettings)>,
    /// For every object, the position among the others, from 1; 0 is the usual one. Empty: all objects have that.
    of_objects: Vec<usize>,
}

impl Kinds {
    /// The usual settings, for all objects.
    pub fn new(usual: CheckedSettings) -> Self {
        Self { usual, others: Vec::new(), of_objects: Vec::new() }
    }

    /// Adds an object: one of another representation with the settings that `other` makes of it.
    ///
    /// # Errors
    /// Those of `other`.
    pub fn push<E>(
        &mut self,
        representation: Option<Representation>,
        other: impl FnOnce(Representation) -> Result<CheckedSettings, E>,
    ) -> Result<(), E> {
        let is = |settings: &CheckedSettings, wanted: &Representation| *settings.representation == *wanted;
        let position = match representation {
            None => 0,
            Some(wanted) if is(&self.usual, &wanted) => 0,
            Some(wanted) => match self.others.iter().position(|(_, known)| is(known, &wanted)) {
                Some(known) => known + 1,
                // Refused by their number: no more are kept.
                None if self.others.len() >= MAX_KINDS => self.others.len(),
                None => {
                    self.others.push((self.of_objects.len(), other(wanted)?));
                    self.others.len()
                }
            },
        };
        self.of_objects.push(position);
        Ok(())
    }

    /// The settings of objects that name no representation, and of the prior.
    pub fn usual(&self) -> &CheckedSettings {
        &self.usual
    }

    /// Position of the settings of an object among all.
    pub fn position(&self, index: usize) -> usize {
        self.of_objects.get(index).copied().unwrap_or(0)
    }

    /// The settings of an object.
    pub fn of(&self, index: usize) -> &CheckedSettings {
        let other = self.position(index).checked_sub(1).and_then(|other| self.others.get(other));
        other.map_or(&self.usual, |(_, settings)| settings)
    }

    /// All settings, with the pointers of their representations.
    fn all(&self) -> impl Iterator<Item = (String, &CheckedSettings)> {
        let others = self.others.iter().map(|(at, settings)| (format!("/representations/{at}"), settings));
        std::iter::once(("/representation".to_owned(), &self.usual)).chain(others)
    }

    /// Faults of `objects` objects of an image with so many axes, in these stages.
    pub fn faults(&self, objects: usize, axes: usize, stages: &[StageInput], limits: &Limits) -> Vec<Fault> {
        let mut faults = Vec::new();
        let named = self.of_objects.len();
        if named > 0 && named != objects {
            let detail = format!("expected one for each of {objects} objects, got {named}");
            faults.push(Fault::new("/representations", detail));
        }
        let kinds = self.others.len() + 1;
        if kinds > MAX_KINDS {
            let detail = format!("expected at most {MAX_KINDS} different representations, got more");
            faults.push(Fault::new("/representations", detail));
        }
        let dimension = self.usual.representation.dimension();
        if axes != dimension {
            let detail = format!("expected an image of {dimension} dimensions, as the shapes, got {axes}");
            faults.push(Fault::new("/image", detail));
        }
        for (place, settings) in self.all().skip(1) {
            let other = settings.representation.dimension();
            if other != dimension {
                let detail = format!("expected shapes of {dimension} dimensions, as the others, got {other}");
                faults.push(Fault::new(place, detail));
            }
        }
        faults.extend(self.fault_of_splits(stages, limits));
        faults
    }

    /// The first split that a representation does not allow.
    fn fault_of_splits(&self, stages: &[StageInput], limits: &Limits) -> Option<Fault> {
        let (at, _) = stages.iter().enumerate().find(|(_, stage)| stage.splits > 0)?;
        let total = splits(stages);
        let detail = self.all().find_map(|(place, settings)| {
            let (most, points) = (limits.control_points, settings.representation.size_after(total));
            match settings.representation.most_splits() {
                None => Some(format!("expected 0, as {place} has no control mesh to split, got {total}")),
                Some(level) if total > level => {
                    Some(format!("expected at most {level} in all stages, the level of {place}, got {total}"))
                }
                Some(_) => {
                    (points > most).then(|| format!("expected at most {most} control points, got {points}"))
                }
            }
        });
        detail.map(|detail| Fault::new(format!("/stages/{at}/splits"), detail))
    }

    /// Whether all objects and all stages have one space of shapes.
    pub fn is_one(&self, stages: &[StageInput]) -> bool {
        self.others.is_empty() && splits(stages) == 0
    }

    /// Prepares all kinds.
    ///
    /// # Errors
    /// Shapes that enclose nothing, at their representation.
    pub(super) fn prepared(&self, app: &App, stages: &[StageInput]) -> Result<Vec<Kind>, ServiceError> {
        self.all().map(|(place, settings)| Kind::new(app, settings, splits(stages), place)).collect()
    }
}

/// Number of splits of all stages.
pub(super) fn splits(stages: &[StageInput]) -> usize {
    stages.iter().fold(0, |sum: usize, stage| sum.saturating_add(stage.splits))
}

/// Objects of one representation, ready to be segmented.
pub(super) struct Kind {
    /// Pointer of the representation.
    pub place: String,
    /// The space of the initial shapes.
    pub setup: Setup,
    /// The models, from the control points of the initial shapes to those of the results.
    pub nested: Nested,
}

impl Kind {
    fn new(
        app: &App,
        settings: &CheckedSettings,
        splits: usize,
        place: String,
    ) -> Result<Self, ServiceError> {
        let setup = Setup::new(app, settings.clone().of_a_prior())?;
        let nested = Nested::new(&setup.space, splits);
        let nested = nested.map_err(|fault| ServiceError::below(vec![Fault::from(fault)], &place))?;
        Ok(Self { place, setup, nested })
    }
}
