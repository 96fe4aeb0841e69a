//! Recipes: everything besides the shapes that a dictionary depends on.

use super::content::{Content, Statistics};
use super::method::Method;
use crate::AnalysisError;
use crate::accumulate::ShapesInMemory;
use crate::alignment::{Alignment, Method as AlignmentMethod};
use crate::correspondence::{Correspondence, Direction, Mirror};
use crate::factors::Estimator;
use crate::frame::Frame;
use crate::matching::Matching;
use crate::mean_record::MeanRecord;
use crate::metric::Metric;
use crate::partial_sums::Measured;
use crate::preparation::Preparation;
use crate::transformation::Transformation;
use shapelex_geometry::representation::{Representation, ShapeSpace};

/// Parameters of learning a dictionary.
#[derive(Debug, Clone, PartialEq)]
pub struct Recipe {
    /// Representation of the shapes.
    pub representation: Representation,
    /// Point correspondence between shapes.
    pub correspondence: Correspondence,
    /// Treatment of contour direction.
    pub direction: Direction,
    /// Whether shapes may be matched to mirror images.
    pub mirror: Mirror,
    /// Unit of the coordinates, kept with the dictionary.
    pub length_unit: Option<String>,
    /// Transformation class removed before comparison.
    pub transformation: Transformation,
    /// Alignment method: projection onto the class, or Procrustes.
    pub alignment: Alignment,
    /// Representative of the mean space used as the mean shape.
    pub frame: Frame,
    /// Learning method with all its parameters.
    pub method: Method,
    /// Whether shapes unlike the majority are left out, or count less.
    pub estimator: Estimator,
    /// Seed of the choice of the shapes that are held out.
    pub held_out_seed: u64,
}

impl Recipe {
    /// A recipe with points that correspond as given, no search, projection, and the training frame.
    pub fn new(representation: Representation, transformation: Transformation, method: Method) -> Self {
        Self {
            representation,
            correspondence: Correspondence::Landmarks,
            direction: Direction::default(),
            mirror: Mirror::Forbid,
            length_unit: None,
            transformation,
            alignment: Alignment::Projection,
            frame: Frame::Training,
            method,
            estimator: Estimator::Plain,
            held_out_seed: 0,
        }
    }

    /// The recipe from which `content` was learnt.
    pub fn of(content: &Content) -> Self {
        Self {
            representation: content.representation.clone(),
            correspondence: content.correspondence,
            direction: content.direction,
            mirror: content.mirror,
            length_unit: content.length_unit.clone(),
            transformation: content.transformation.clone(),
            alignment: content.alignment,
            frame: content.frame,
            method: content.method.clone(),
            estimator: Estimator::robust(content.robust.is_some()),
            held_out_seed: content.statistics.held_out.as_ref().and_then(|held| held.seed).unwrap_or(0),
        }
    }

    /// Space, metric, alignment and matching of the recipe. Cost: that of the space.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] at `representation`; [`AnalysisError::NotAProperClass`].
    pub fn setting(&self) -> Result<Setting, AnalysisError> {
        let refused = |field, detail| AnalysisError::Parameter { field, detail };
        let space = ShapeSpace::new(&self.representation)
            .map_err(|error| refused("representation", error.to_string()))?;
        let dimension = self.representation.dimension();
        let method = AlignmentMethod::new(&self.transformation, self.alignment, dimension)?;
        if method.translates() && !space.reproduces_constants() {
            return Err(refused("representation.generator", NO_CONSTANTS.into()));
        }
        let metric = Metric::of(&space);
        let matching = Matching::new(&space, self.correspondence, self.direction, self.mirror)
            .translating(method.translates());
        Ok(Setting { space, metric, method, matching })
    }

    /// Content with this mean, and nothing learnt yet.
    pub(crate) fn content(&self, mean: MeanRecord) -> Content {
        Content {
            representation: self.representation.clone(),
            correspondence: self.correspondence,
            direction: self.direction,
            mirror: self.mirror,
            length_unit: self.length_unit.clone(),
            transformation: self.transformation.clone(),
            alignment: self.alignment,
            frame: self.frame,
            method: self.method.clone(),
            mean,
            centre: None,
            atoms: Vec::new(),
            statistics: Statistics::default(),
            robust: None,
            classifier: None,
        }
    }
}

/// Why a class that translates does not suit the generator of a space.
pub const NO_CONSTANTS: &str = "the generator does not reproduce constants, so that its shapes cannot be moved: add \
                                the pole 0, or choose a class without translation";

/// A recipe prepared for computation.
#[derive(Debug, Clone)]
pub struct Setting {
    /// Space of the shapes.
    pub space: ShapeSpace,
    /// Metric of the space.
    pub metric: Metric,
    /// Projection or Procrustes alignment.
    pub method: AlignmentMethod,
    /// Search over start points, directions and mirror images.
    pub matching: Matching,
}

impl Setting {
    /// Metric, alignment method and matching of the shapes.
    pub fn measured(&self) -> Measured<'_> {
        Measured { metric: &self.metric, method: &self.method, matching: &self.matching }
    }

    /// Shapes to learn from: `d·N` coordinate-major numbers per shape, one shape after the other, and a positive weight
    /// for each.
    ///
    /// # Errors
    /// [`AnalysisError::NoExtent`] for the first shape without an extent.
    pub fn shapes(
        &self,
        control_points: Vec<f64>,
        weights: Vec<f64>,
    ) -> Result<ShapesInMemory, AnalysisError> {
        ShapesInMemory::marked(&self.metric, self.method.translates(), control_points, weights)
    }
}

impl Content {
    /// How shapes are prepared for the dictionary.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] if the method does not suit the alignment.
    pub(crate) fn preparation(&self, measured: Measured<'_>) -> Result<Preparation, AnalysisError> {
        Ok(Preparation {
            metric: measured.metric.clone(),
            method: measured.method.clone(),
            matching: measured.matching.clone(),
            mean: measured.metric.whitened(&self.mean.control_points),
            pose: self.method.pose(measured.method)?,
        })
    }
}
