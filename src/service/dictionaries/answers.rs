//! Answers of dictionaries about shapes, as they are written: codes, classes, novelty, assessments.

use serde::{Deserialize, Serialize};

use super::classify::Assessed;
use super::coding;
use super::posterior::Prepared;
use super::ready::Ready;
use crate::analysis::AnalysisError;
use crate::analysis::assessment::assess::{Assessment, Classified};
use crate::analysis::dictionary::coding::CodedShape;
use crate::analysis::dictionary::in_use::Dictionary;
use crate::analysis::dictionary::posterior::assessed::{PartAssessment, PartScore};
use crate::analysis::dictionary::score::Score;
use crate::domain::dictionary::Listed;
use crate::numeric::dense::Matrix;
use crate::wire::shape::Points;

/// The version of a dictionary that an answer was computed with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct UsedDictionary {
    /// Identifier.
    pub id: String,
    /// Name shared by all versions.
    pub name: String,
    /// Version number, from 1.
    pub version: u64,
    /// BLAKE3 digest of the content.
    pub digest: String,
    /// Warnings about the shapes that it was learnt from; absent if there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    pub warnings: Vec<String>,
}

impl UsedDictionary {
    /// The version that is ready for use.
    pub fn new(ready: &Ready) -> Self {
        let Listed { id, name, version, digest, provenance, .. } = ready.listed.clone();
        Self { id, name, version, digest, warnings: provenance.warnings }
    }

    /// The version with its digest, in one line.
    pub fn reference(&self) -> String {
        format!("{}@{};digest={}", self.name, self.version, self.digest)
    }
}

/// Parts that all entries of an answer have in common.
#[derive(Debug, Clone, Serialize, utoipa::ToSchema)]
pub struct ByDictionary {
    /// The dictionary, at the version that was used.
    dictionary: UsedDictionary,
    /// Warnings about novelty, and those of the dictionary; absent if there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    warnings: Vec<String>,
}

impl ByDictionary {
    /// With the warnings of the dictionary alone: for answers without novelty.
    pub fn new(ready: &Ready) -> Self {
        let dictionary = UsedDictionary::new(ready);
        Self { warnings: dictionary.warnings.clone(), dictionary }
    }

    /// With warnings about novelty.
    pub fn with_warnings(ready: &Ready) -> Self {
        Self { warnings: coding::warnings(ready), ..Self::new(ready) }
    }

    /// The same with another warning, if there is one.
    #[must_use]
    pub fn and(mut self, warning: Option<String>) -> Self {
        self.warnings.extend(warning);
        self
    }

    /// With warnings about novelty, also of shapes with missing parts if the dictionary is prepared for them.
    pub fn with_warnings_of_parts(ready: &Ready, prepared: Option<&Prepared>) -> Self {
        let mut common = Self::with_warnings(ready);
        common.warnings.extend(prepared.and_then(Prepared::novelty_warning));
        common
    }
}

/// Transformation of a shape into the pose of the dictionary: `y = A r + b`.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct TransformationOutput {
    /// Matrix `A`, row by row.
    matrix: Vec<Vec<f64>>,
    /// Offset `b`.
    offset: Vec<f64>,
    /// Index of the control point that becomes the first.
    start: u32,
    /// Whether the shape is traversed in reverse.
    reversed: bool,
    /// Whether the match is a mirror image.
    mirrored: bool,
}

/// Code of a shape with its optimality certificate.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct CodeOutput {
    /// Indices of the atoms in use, from 0, ascending.
    indices: Vec<usize>,
    /// Coefficients of these atoms, or scores. For invariant codes, the norms `‖B_j d_j‖` in the pose of the dictionary, which
    /// do not depend on the pose of the shape.
    values: Vec<f64>,
    /// Invariant codes only: matrices `B_j`, row by row, in the pose of the shape, with `r ≈ Σ B_j d_j + offset`.
    #[serde(skip_serializing_if = "Option::is_none")]
    matrices: Option<Vec<Vec<Vec<f64>>>>,
    /// Invariant codes only: the offset that is added.
    #[serde(skip_serializing_if = "Option::is_none")]
    offset: Option<Vec<f64>>,
    /// Number of real numbers in the code.
    parameters: usize,
    /// Objective: `½‖y − ŷ‖²` plus the penalty.
    objective: f64,
    /// Upper bound on how far the objective is above its minimum; null without a penalty.
    duality_gap: Option<f64>,
    /// Relative error `‖y − ŷ‖/‖y‖`.
    relative_error: f64,
    /// Transformation of the shape into the pose of the dictionary.
    transformation: TransformationOutput,
}

impl CodeOutput {
    /// Code of a shape.
    ///
    /// # Errors
    /// A code whose members of the class cannot be computed.
    pub fn new(dictionary: &Dictionary, coded: &CodedShape) -> Result<Self, AnalysisError> {
        let (code, prepared) = (&coded.code, &coded.prepared);
        let moves = dictionary.moves(coded)?;
        Ok(Self {
            indices: code.indices.clone(),
            values: dictionary.magnitudes(coded),
            matrices: moves.as_ref().map(|moves| moves.matrices.iter().map(rows).collect()),
            offset: moves.map(|moves| moves.offset),
            parameters: code.values.len(),
            objective: code.objective,
            duality_gap: code.duality_gap,
            relative_error: code.relative_error,
            transformation: TransformationOutput {
                matrix: rows(&prepared.matrix),
                offset: prepared.offset.clone(),
                start: prepared.placement.shift,
                reversed: prepared.placement.reversed,
                mirrored: prepared.placement.mirrored,
            },
        })
    }
}

/// Comparison of a shape with the training shapes, or of the seen part of a shape with parts of training shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct NoveltyOutput {
    /// Whether one of the two measures exceeds the limit that the quantile sets for both together.
    is_outlier: bool,
    /// `T²`: squared Mahalanobis distance of the scores; null for sparse dictionaries.
    t_squared: Option<f64>,
    /// Fraction of the held-out training shapes with a smaller or equal `T²`; for a part, relative to its expectation
    /// given the seen part.
    t_squared_rank: Option<f64>,
    /// Squared prediction error `‖y − ŷ‖²`; for a part, as if the rest of the shape had the same.
    squared_prediction_error: f64,
    /// Fraction of the held-out training shapes with a smaller or equal squared prediction error; for a part, relative to its expectation.
    squared_prediction_error_rank: f64,
}

impl NoveltyOutput {
    /// Comparison that a score contains.
    pub fn new(score: &Score) -> Self {
        Self {
            is_outlier: score.outlier,
            t_squared: score.t_squared,
            t_squared_rank: score.t_squared_rank,
            squared_prediction_error: score.residual,
            squared_prediction_error_rank: score.residual_rank,
        }
    }
}

/// A class with its distance and confidence.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct RankedOutput {
    /// Name of the class.
    label: String,
    /// Distance to the class: relative residual, Mahalanobis distance, or distance to the nearest member.
    distance: f64,
    /// Confidence, calibrated on held-out shapes; the confidences of all classes sum to 1.
    confidence: f64,
}

/// Class of a shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct ClassOutput {
    /// Most likely class.
    label: String,
    /// All classes, most likely first.
    ranking: Vec<RankedOutput>,
    /// Confidence of the first class minus that of the second.
    margin: f64,
    /// Whether the distance to the class is within the quantile of the class's own shapes when held out. If not, the shape
    /// belongs to none of these classes. An outlier may be accepted too: `verdict` decides.
    accepted: bool,
}

impl ClassOutput {
    /// Class of a shape.
    pub fn new(ready: &Ready, classified: &Classified) -> Self {
        let record = ready.dictionary().content.classifier.as_ref();
        let label = |class: usize| {
            record
                .and_then(|record| record.classes.get(class))
                .map_or_else(String::new, |class| class.label.clone())
        };
        let ranking: Vec<RankedOutput> = classified
            .ranking
            .iter()
            .map(|ranked| RankedOutput {
                label: label(ranked.class),
                distance: ranked.distance,
                confidence: ranked.confidence,
            })
            .collect();
        Self {
            label: ranking.first().map_or_else(String::new, |first| first.label.clone()),
            ranking,
            margin: classified.margin,
            accepted: classified.accepted,
        }
    }
}

/// Decision of a pipeline about a shape: `novelty` compares it with all training shapes, `accepted` of its class with
/// those of the class alone, and both can disagree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// A usual shape; if there is a classifier, of the class that it names.
    Accepted,
    /// A usual shape, of none of the classes.
    NoClass,
    /// An unusual shape: the class that is named for it means nothing.
    Outlier,
}

impl Verdict {
    /// Verdict on a shape with this class, if it has one, and this novelty.
    pub fn of(class: Option<&ClassOutput>, novelty: &NoveltyOutput) -> Self {
        match class {
            _ if novelty.is_outlier => Self::Outlier,
            Some(class) if !class.accepted => Self::NoClass,
            _ => Self::Accepted,
        }
    }
}

/// Code, class, outlier status and residual of a shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct AssessmentOutput {
    /// Use of the shape, by its class and its novelty together.
    verdict: Verdict,
    /// Sparse code or component scores, and the transformation into the pose of the dictionary.
    code: CodeOutput,
    /// Class of the shape; null if the dictionary has no classifier, and for shapes with missing parts.
    class: Option<ClassOutput>,
    /// Comparison of the shape with the training shapes.
    novelty: NoveltyOutput,
    /// `‖y − ŷ‖²/(‖y‖‖ŷ‖)` in the pose of the dictionary.
    relative_error: f64,
    /// Distances between the shape and its reconstruction at equally spaced parameters: `i/samples` on closed curves,
    /// `i/(samples − 1)` on open ones, every point of landmarks. In the unit of the shape. Of a shape with missing
    /// parts: those of the seen part, in the order of `part.seen`.
    residual: Vec<f64>,
    /// Seen part of a shape with missing parts, and its most likely shape; absent for whole shapes.
    #[serde(skip_serializing_if = "Option::is_none")]
    part: Option<PartOutput>,
}

/// Seen part of a shape with missing parts, and its most likely shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct PartOutput {
    /// Positions, from 0, of the seen part: control points, or with arcs those of as many equally spaced places.
    seen: Vec<usize>,
    /// Fraction of the control points, or of as many places, that are seen.
    seen_fraction: f64,
    /// Control points of the most likely shape, in the pose in which the part is seen.
    control_points: Points,
    /// Standard deviations of the scores.
    score_deviations: Vec<f64>,
    /// Whether the search of the pose converged.
    converged: bool,
}

impl AssessmentOutput {
    /// Assessment of a shape.
    ///
    /// # Errors
    /// A code whose members of the class cannot be computed.
    pub fn new(ready: &Ready, assessed: Assessed) -> Result<Self, AnalysisError> {
        match assessed {
            Assessed::Whole(assessment) => Self::of_whole(ready, *assessment),
            Assessed::Part(part, novelty) => Ok(Self::of_part(ready, *part, &novelty)),
        }
    }

    fn of_part(ready: &Ready, part: PartAssessment, novelty: &PartScore) -> Self {
        let (setup, posterior) = (&ready.setup, &part.posterior);
        let novelty = NoveltyOutput {
            is_outlier: novelty.is_outlier,
            t_squared: Some(part.t_squared),
            t_squared_rank: Some(novelty.distance_rank),
            squared_prediction_error: part.squared_error,
            squared_prediction_error_rank: novelty.residual_rank,
        };
        Self {
            verdict: Verdict::of(None, &novelty),
            code: CodeOutput {
                indices: (0..part.scores.len()).collect(),
                parameters: part.scores.len(),
                values: part.scores,
                matrices: None,
                offset: None,
                objective: 0.5 * part.squared_error,
                duality_gap: None,
                relative_error: part.relative_residual,
                transformation: TransformationOutput {
                    matrix: rows(&posterior.pose.matrix),
                    offset: posterior.pose.offset.clone(),
                    start: 0,
                    reversed: false,
                    mirrored: false,
                },
            },
            class: None,
            novelty,
            relative_error: part.relative_error,
            residual: part.residual,
            part: Some(PartOutput {
                seen_fraction: part.seen.len() as f64 / setup.metric.size() as f64,
                seen: part.seen,
                control_points: Points::from_columns(part.completed, setup.metric.dimension()),
                score_deviations: part.deviations,
                converged: posterior.converged,
            }),
        }
    }

    fn of_whole(ready: &Ready, assessment: Assessment) -> Result<Self, AnalysisError> {
        let Assessment { coded, classified, score, relative_error, residual } = assessment;
        let class = classified.map(|classified| ClassOutput::new(ready, &classified));
        let novelty = NoveltyOutput::new(&score);
        Ok(Self {
            verdict: Verdict::of(class.as_ref(), &novelty),
            code: CodeOutput::new(ready.dictionary(), &coded)?,
            class,
            novelty,
            relative_error,
            residual,
            part: None,
        })
    }

    /// Whether the shape is an outlier.
    pub fn is_outlier(&self) -> bool {
        self.novelty.is_outlier
    }

    /// The class of the shape, unless it belongs to none.
    pub fn accepted_class(&self) -> Option<&str> {
        self.class.as_ref().filter(|class| class.accepted).map(|class| class.label.as_str())
    }
}

fn rows(matrix: &Matrix) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outlier_is_one_whatever_its_class_says() {
        let novelty = |is_outlier| NoveltyOutput {
            is_outlier,
            t_squared: None,
            t_squared_rank: None,
            squared_prediction_error: 1.0,
            squared_prediction_error_rank: 0.5,
        };
        let class = |accepted| ClassOutput { label: "a".into(), ranking: Vec::new(), margin: 0.5, accepted };
        for (accepted, is_outlier, wanted) in [
            (None, false, Verdict::Accepted),
            (Some(true), false, Verdict::Accepted),
            (Some(false), false, Verdict::NoClass),
            (None, true, Verdict::Outlier),
            (Some(true), true, Verdict::Outlier),
            (Some(false), true, Verdict::Outlier),
        ] {
            let found = Verdict::of(accepted.map(class).as_ref(), &novelty(is_outlier));
            assert_eq!(found, wanted, "{accepted:?} {is_outlier}");
        }
    }
}
