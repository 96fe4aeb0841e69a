//! Assessments: shapes compared with a dictionary and its classifier.
//!
//! * [`assess`] — classes, and complete assessments;
//! * [`drift`] — new shapes compared with the training shapes.

pub mod assess;
pub mod drift;

use crate::classification::{Classifier, Description};
use crate::classifier_record::ClassifierRecord;
use crate::dictionary::in_use::Dictionary;

/// A dictionary in use, with its classifier.
#[derive(Debug, Clone)]
pub struct Assessor {
    /// The dictionary.
    pub dictionary: Dictionary,
    /// Classifier of its content, if there is one.
    classifier: Option<Classifier>,
}

impl Assessor {
    /// Prepares the classifier of a dictionary.
    pub fn new(dictionary: Dictionary) -> Self {
        let prepared = |record| Classifier::from_record(record, dictionary.metric());
        let classifier = dictionary.content.classifier.as_ref().map(prepared);
        Self { dictionary, classifier }
    }

    /// A dictionary with a trained classifier, which replaces that of its content.
    pub fn trained(mut dictionary: Dictionary, record: ClassifierRecord) -> Self {
        dictionary.content.classifier = Some(record);
        Self::new(dictionary)
    }

    /// The classifier with its record, if there is one.
    fn classifier(&self) -> Option<(&Classifier, &ClassifierRecord)> {
        self.classifier.as_ref().zip(self.dictionary.content.classifier.as_ref())
    }

    /// How shapes are described to the classifier of the record.
    fn description(&self, record: &ClassifierRecord) -> Description<'_> {
        let size = record.settings.sees_size();
        Description { preparation: &self.dictionary.preparation, model: &self.dictionary.model, size }
    }
}
