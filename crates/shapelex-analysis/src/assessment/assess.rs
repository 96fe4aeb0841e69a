//! Classification of shapes, and complete assessments: code, class, outlier test and residual.
//!
//! Classes are ranked by likelihood, with calibrated confidences. A shape beyond the training quantile of its most
//! likely class is not accepted.

use super::Assessor;
use crate::AnalysisError;
use crate::accumulate::prepare;
use crate::classification::sharpness::confidences;
use crate::classification::{Evidence, Observations};
use crate::classifier_record::ClassifierRecord;
use crate::dictionary::coding::{AnswerPose, CodedShape};
use crate::dictionary::score::{Score, value_at};
use crate::sparse::SparseCode;
use shapelex_geometry::representation::ShapeSpace;

/// A class in a ranking by likelihood.
#[derive(Debug, Clone, PartialEq)]
pub struct Ranked {
    /// Index of the class.
    pub class: usize,
    /// Distance to the class.
    pub distance: f64,
    /// Calibrated confidence; the confidences of all classes sum to 1.
    pub confidence: f64,
}

/// Result of classifying a shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Classified {
    /// All classes, the most likely first.
    pub ranking: Vec<Ranked>,
    /// Confidence of the first class minus that of the second.
    pub margin: f64,
    /// Whether the distance is within the training quantile of the class; otherwise the shape belongs to none of the
    /// classes.
    pub accepted: bool,
    /// Comparison of the shape with all training shapes.
    pub outlier: Score,
}

/// Complete assessment of a shape.
#[derive(Debug)]
pub struct Assessment {
    /// Code and pose.
    pub coded: CodedShape,
    /// Class, if the dictionary has a classifier.
    pub classified: Option<Classified>,
    /// Comparison with the training shapes.
    pub score: Score,
    /// Relative error `‖y − ŷ‖²/(‖y‖‖ŷ‖)`.
    pub relative_error: f64,
    /// Distances between the shape and its reconstruction, in the pose of the shape.
    pub residual: Vec<f64>,
}

impl Assessor {
    /// Classes of encoded shapes; `None` without a classifier. Shapes beyond the training quantile `quantile` (from 0.5
    /// to below 1) of their class are not accepted.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] with the position of the shape.
    pub fn classify(
        &self,
        coded: &[CodedShape],
        quantile: f64,
    ) -> Result<Option<Vec<Classified>>, AnalysisError> {
        let Some((classifier, record)) = self.classifier() else { return Ok(None) };
        let dictionary = &self.dictionary;
        let mut shapes: Vec<f64> =
            coded.iter().flat_map(|coded| coded.control_points.iter().copied()).collect();
        prepare(dictionary.metric(), dictionary.preparation.method.translates(), 0, &mut shapes)?;
        let prepared: Vec<f64> =
            coded.iter().flat_map(|coded| coded.prepared.whitened.iter().copied()).collect();
        let codes: Vec<SparseCode> = coded.iter().map(|coded| coded.code.clone()).collect();
        let observations = Observations { shapes: &shapes, prepared: &prepared, codes: &codes };
        let evidence = classifier.evidence(self.description(record), observations)?;
        let pairs = evidence.iter().zip(coded);
        Ok(Some(pairs.map(|(evidence, coded)| self.classified(record, evidence, coded, quantile)).collect()))
    }

    fn classified(
        &self,
        record: &ClassifierRecord,
        evidence: &Evidence,
        coded: &CodedShape,
        quantile: f64,
    ) -> Classified {
        let confidences = confidences(evidence, record.sharpness);
        let ranked = |class: usize| Ranked {
            class,
            distance: evidence.distances[class],
            confidence: confidences[class],
        };
        let ranking: Vec<Ranked> = evidence.ranking().into_iter().map(ranked).collect();
        let second = ranking.get(1).map_or(0.0, |ranked| ranked.confidence);
        let bound = value_at(&record.classes[ranking[0].class].distances, quantile);
        Classified {
            margin: ranking[0].confidence - second,
            accepted: ranking[0].distance <= bound,
            outlier: self.dictionary.score(coded, quantile),
            ranking,
        }
    }

    /// Assesses an encoded shape of `space`, with its class: novelty, and the residual at `samples` parameters.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] with index 0 for a shape that the alignment makes degenerate.
    pub fn assess(
        &self,
        space: &ShapeSpace,
        coded: CodedShape,
        classified: Option<Classified>,
        quantile: f64,
        samples: usize,
    ) -> Result<Assessment, AnalysisError> {
        let reconstruction = self.dictionary.reconstruct(space, &coded, AnswerPose::Input, samples)?;
        let score = match &classified {
            Some(classified) => classified.outlier.clone(),
            None => self.dictionary.score(&coded, quantile),
        };
        Ok(Assessment {
            coded,
            classified,
            score,
            relative_error: reconstruction.relative_error.unwrap_or_default(),
            residual: reconstruction.residual,
        })
    }
}
