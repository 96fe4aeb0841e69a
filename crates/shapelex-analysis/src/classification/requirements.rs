//! Requirements of the settings of a classifier on one another, on the dictionary, and on the labelled shapes.

use super::candidates::MAX_STORED;
use super::labels::ClassLabels;
use crate::classifier_record::{ClassifierKind, ClassifierSettings, Feature};
use crate::dictionary::method::Method;
use crate::dictionary::procedure::ParameterFault;

/// Maximum number of classes named in a fault.
const NAMED: usize = 5;

/// Maximum number of classes: a confusion matrix must stay readable.
const MAX_CLASSES: usize = 1000;

/// Maximum count of numbers of evidence kept by a validation.
const MAX_EVIDENCE: usize = 1 << 25;

fn fault(field: &'static str, detail: impl Into<String>) -> ParameterFault {
    ParameterFault { field, detail: detail.into() }
}

/// Properties that set a kind of classifier apart from the others.
struct Needs {
    /// Codes in few of many atoms.
    sparse: bool,
    /// Atoms that are shapes.
    atoms_are_shapes: bool,
    /// Whether the size may be one of its features.
    may_see_size: bool,
    /// Whether it divides the training shapes once more.
    divides_again: bool,
}

impl ClassifierKind {
    fn needs(self) -> Needs {
        let none =
            Needs { sparse: false, atoms_are_shapes: false, may_see_size: false, divides_again: false };
        match self {
            Self::MeanSpace | Self::Ensemble => none,
            Self::NearestAtom => Needs { atoms_are_shapes: true, ..none },
            Self::SparseResidual => Needs { sparse: true, ..none },
            Self::Discriminant | Self::NearestNeighbours => Needs { may_see_size: true, ..none },
            Self::Best => Needs { may_see_size: true, divides_again: true, ..none },
        }
    }
}

impl ClassifierSettings {
    /// Faults that do not depend on the shapes, at fields of `classifier`; `names_classes`: whether the attribute can name
    /// classes.
    pub fn faults(&self, method: &Method, names_classes: bool) -> Vec<ParameterFault> {
        let needs = self.kind.needs();
        let (kind, features) = ("classifier.kind", "classifier.features");
        let ensemble = "expected best or one of the other kinds, got ensemble: only best makes ensembles";
        let atoms = "nearest_atom requires atoms that are shapes, but components about a centre are differences: \
                     learn sparse atoms, or components without centre";
        let attribute = format!("expected label or labels.<attribute>, got '{}'", self.attribute);
        let twice =
            self.features.len() > 2 || self.features.len() == 2 && self.features[0] == self.features[1];
        let checks: [(bool, &'static str, &str); 7] = [
            (self.kind == ClassifierKind::Ensemble, kind, ensemble),
            (needs.sparse && !method.is_sparse(), kind, "sparse_residual requires a sparse dictionary"),
            (needs.atoms_are_shapes && !method.atoms_are_shapes(), kind, atoms),
            (!names_classes, "classifier.attribute", attribute.as_str()),
            (!self.features.contains(&Feature::Shape), features, "expected shape among the features"),
            (twice, features, "expected different entries, got one twice"),
            (
                self.sees_size() && !needs.may_see_size,
                features,
                "the feature size requires the kind discriminant, nearest_neighbours or best",
            ),
        ];
        let wrong = checks.into_iter().filter(|(wrong, ..)| *wrong);
        let mut faults: Vec<ParameterFault> = wrong.map(|(_, field, detail)| fault(field, detail)).collect();
        faults.extend(self.foreign_fields());
        faults.extend(self.range_faults(method.atoms()));
        faults
    }

    /// Fields that belong to another kind.
    fn foreign_fields(&self) -> impl Iterator<Item = ParameterFault> {
        let (discriminant, neighbours) = (ClassifierKind::Discriminant, ClassifierKind::NearestNeighbours);
        let fields = [
            (self.components.is_some(), discriminant, "classifier.components", "discriminant"),
            (self.pooling.is_some(), discriminant, "classifier.pooling", "discriminant"),
            (self.shrinkage.is_some(), discriminant, "classifier.shrinkage", "discriminant"),
            (self.neighbours.is_some(), neighbours, "classifier.neighbours", "nearest_neighbours"),
        ];
        let kind = self.kind;
        let foreign = fields.into_iter().filter(move |(given, owner, ..)| *given && kind != *owner);
        foreign.map(|(_, _, field, name)| fault(field, format!("this field belongs to the kind {name}")))
    }

    /// Numbers out of range, for a dictionary of `atoms` atoms.
    fn range_faults(&self, atoms: usize) -> Vec<ParameterFault> {
        let mut faults = Vec::new();
        if let Some(components) = self.components.filter(|components| !(1..=atoms).contains(components)) {
            let detail = format!("expected a number between 1 and {atoms}, got {components}");
            faults.push(fault("classifier.components", detail));
        }
        for (field, value) in [("classifier.pooling", self.pooling), ("classifier.shrinkage", self.shrinkage)]
        {
            if let Some(value) = value.filter(|value| !(0.0..=1.0).contains(value)) {
                faults.push(fault(field, format!("expected a number between 0 and 1, got {value}")));
            }
        }
        if self.neighbours == Some(0) {
            faults.push(fault("classifier.neighbours", "expected at least 1, got 0"));
        }
        if !(2..=100).contains(&self.folds) {
            let detail = format!("expected a number between 2 and 100, got {}", self.folds);
            faults.push(fault("classifier.folds", detail));
        }
        if !(1..=100).contains(&self.repeats) {
            let detail = format!("expected a number between 1 and 100, got {}", self.repeats);
            faults.push(fault("classifier.repeats", detail));
        }
        faults
    }

    /// Size of the smallest training set in the validation on `shapes` shapes.
    pub fn fewest_training(&self, shapes: usize) -> usize {
        let fewest = shapes - shapes.div_ceil(self.folds);
        if self.kind.needs().divides_again { fewest - fewest.div_ceil(2) } else { fewest }
    }

    /// Count of numbers stored in a classifier of `shapes` shapes of `length` numbers in `classes` classes. `best` chooses only
    /// kinds that are small enough.
    fn stored(&self, method: &Method, shapes: usize, classes: usize, length: usize) -> usize {
        let described = method.described(shapes, length);
        let features = self.components.unwrap_or(described).min(described) + 1;
        match self.kind {
            ClassifierKind::MeanSpace => classes.saturating_mul(length),
            ClassifierKind::NearestNeighbours => shapes.saturating_mul(features),
            ClassifierKind::Discriminant if self.pooling.unwrap_or(1.0) < 1.0 => {
                classes.saturating_mul(features * features)
            }
            ClassifierKind::Discriminant
            | ClassifierKind::NearestAtom
            | ClassifierKind::SparseResidual
            | ClassifierKind::Best
            | ClassifierKind::Ensemble => 0,
        }
    }
}

impl ClassLabels {
    /// Reasons why a classifier cannot be trained and validated on these shapes, which have `length` numbers each and are
    /// described by `method`, at fields of `classifier`.
    pub fn faults(
        &self,
        settings: &ClassifierSettings,
        method: &Method,
        length: usize,
    ) -> Vec<ParameterFault> {
        if let Some(fault) = self.count_fault(&settings.attribute) {
            return vec![fault];
        }
        let stored = settings.stored(method, self.classes.len(), self.labels.len(), length);
        let too_large = (stored > MAX_STORED).then(|| {
            let detail = format!(
                "expected a classifier of at most {MAX_STORED} numbers, got {stored}: ask for fewer components, \
                 choose fewer shapes, or another kind"
            );
            fault("classifier.kind", detail)
        });
        let found = [
            too_large,
            self.division_fault(settings),
            self.neighbours_fault(settings),
            self.evidence_fault(settings),
        ];
        found.into_iter().flatten().collect()
    }

    fn count_fault(&self, attribute: &str) -> Option<ParameterFault> {
        let found = self.labels.len();
        let detail = if found < 2 {
            let only = self.labels.first().map_or("", String::as_str);
            format!("expected at least two classes, but all shapes have the same '{attribute}', '{only}'")
        } else if found > MAX_CLASSES {
            format!("expected at most {MAX_CLASSES} classes, got {found} values of '{attribute}'")
        } else {
            return None;
        };
        Some(fault("classifier.attribute", detail))
    }

    /// Why the classes cannot be divided into the folds of the validation.
    fn division_fault(&self, settings: &ClassifierSettings) -> Option<ParameterFault> {
        let (sizes, units, folds) = (self.sizes(), self.units(), settings.folds);
        let fewest = smallest(&units);
        let (label, cases) = (&self.labels[fewest], units[fewest]);
        let alone: Vec<&str> =
            (0..sizes.len()).filter(|&c| sizes[c] == 1).map(|c| self.labels[c].as_str()).collect();
        if !alone.is_empty() {
            let named = alone[..alone.len().min(NAMED)].join("', '");
            let detail = format!(
                "expected at least 2 shapes in each class, but {} classes have only one ('{named}')",
                alone.len()
            );
            return Some(fault("classifier.attribute", detail));
        }
        if folds > cases {
            let shapes = sizes[fewest];
            let of = match self.subjects {
                Some(_) => format!("{shapes} shapes of {cases} subjects"),
                None => format!("{shapes} shapes"),
            };
            let detail = format!(
                "expected at most as many folds as the smallest class can be divided into, got {folds}: the class \
                 '{label}' has {of}"
            );
            return Some(fault("classifier.folds", detail));
        }
        let divides = !settings.kind.needs().divides_again || cases - cases.div_ceil(folds) >= 2;
        (!divides).then(|| {
            let detail = format!(
                "best divides the training shapes once more, but the class '{label}' has only {cases} cases: \
                 choose another kind, or fewer folds"
            );
            fault("classifier.kind", detail)
        })
    }

    fn neighbours_fault(&self, settings: &ClassifierSettings) -> Option<ParameterFault> {
        let sizes = self.sizes();
        let smallest = smallest(&sizes);
        let neighbours = settings.neighbours.filter(|&k| k > sizes[smallest])?;
        let (label, size) = (&self.labels[smallest], sizes[smallest]);
        let detail = format!(
            "expected at most {size}, the number of shapes of the class '{label}' (which could never win \
             otherwise), got {neighbours}"
        );
        Some(fault("classifier.neighbours", detail))
    }

    fn evidence_fault(&self, settings: &ClassifierSettings) -> Option<ParameterFault> {
        let (shapes, classes) = (self.classes.len(), self.labels.len());
        let evidence = shapes.saturating_mul(classes).saturating_mul(settings.repeats);
        (evidence > MAX_EVIDENCE).then(|| {
            let detail = format!(
                "expected at most {MAX_EVIDENCE} numbers of evidence, got {evidence} ({shapes} shapes, {classes} \
                 classes): choose fewer repeats"
            );
            fault("classifier.repeats", detail)
        })
    }
}

/// Position of the first smallest number.
fn smallest(values: &[usize]) -> usize {
    (1..values.len()).fold(0, |best, c| if values[c] < values[best] { c } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fields(faults: &[ParameterFault]) -> Vec<&'static str> {
        faults.iter().map(|fault| fault.field).collect()
    }

    fn labels(sizes: [usize; 2]) -> ClassLabels {
        let names = ["a", "b"].into_iter().zip(sizes);
        let names: Vec<String> =
            names.flat_map(|(name, size)| std::iter::repeat_n(name.to_owned(), size)).collect();
        ClassLabels::from_names(&names)
    }

    #[test]
    fn settings_name_all_fields_that_do_not_fit() {
        let settings = ClassifierSettings {
            features: vec![Feature::Size],
            pooling: Some(2.0),
            folds: 1,
            ..ClassifierSettings::new(ClassifierKind::NearestAtom)
        };
        let faults = settings.faults(&Method::components(3, true), false);
        let wanted = [
            "classifier.kind",
            "classifier.attribute",
            "classifier.features",
            "classifier.features",
            "classifier.pooling",
            "classifier.pooling",
            "classifier.folds",
        ];
        assert_eq!(fields(&faults), wanted);
        let plain = ClassifierSettings::new(ClassifierKind::Discriminant);
        assert_eq!(fields(&plain.faults(&Method::components(3, true), true)), [""; 0]);
    }

    #[test]
    fn labels_are_enough_for_the_folds() {
        let method = Method::components(3, false);
        let best = ClassifierSettings::new(ClassifierKind::Best);
        let found = |labels: ClassLabels| fields(&labels.faults(&best, &method, 20));
        assert_eq!(found(labels([8, 0])), ["classifier.attribute"]);
        assert_eq!(found(labels([8, 1])), ["classifier.attribute"]);
        assert_eq!(found(labels([8, 4])), ["classifier.folds"]);
        assert_eq!(found(labels([8, 5])), [""; 0]);
        assert_eq!((best.fewest_training(10), best.fewest_training(11)), (4, 4));
    }
}
