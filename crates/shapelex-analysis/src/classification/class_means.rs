//! Classification by distance to the mean space of every class. Nothing is learnt but the class means.
//!
//! ```text
//! d_c = ‖r − P_c r‖/‖r‖        P_c r the member of the class of the mean m_c nearest to r
//! ```
//!
//! For every class, `r` takes the start point, direction and mirror image that match the class mean best.
//!
//! Source: Schmitter 2017, section 4.6.

use shapelex_numeric::parallel;

use super::observations::{Evidence, Labelled, Observations};
use crate::AnalysisError;
use crate::accumulate::{ShapesInMemory, subset};
use crate::alignment::{MIN_SHAPES, Method, mean_shape};
use crate::frame::Frame;
use crate::matching::{Placement, Target};
use crate::mean::MeanSpace;
use crate::metric::norm;
use crate::preparation::Preparation;

/// The mean shapes of the classes, whitened.
#[derive(Debug, Clone, PartialEq)]
pub struct ClassMeans {
    /// One mean per class.
    pub means: Vec<Vec<f64>>,
}

impl ClassMeans {
    /// Computes the mean of every class; the mean of a single shape is the shape itself.
    pub(super) fn train(preparation: &Preparation, sample: Labelled<'_>) -> Result<Self, AnalysisError> {
        let shapes = sample.observations.shapes.to_vec();
        let all = ShapesInMemory::prepared(shapes, sample.weights.to_vec());
        let mean_of = |class: usize| {
            let members: Vec<usize> =
                (0..sample.classes.len()).filter(|&k| sample.classes[k] == class).collect();
            let chosen = subset(&all, &members);
            if members.len() < MIN_SHAPES {
                return Ok(chosen.all().whitened.to_vec());
            }
            let Preparation { metric, method, matching, .. } = preparation;
            let mean = mean_shape(&chosen, metric, method, Frame::Training, matching);
            let at = |error: AnalysisError| match error.position() {
                Some(position) => error.at(members[position]),
                None => error,
            };
            Ok(mean.map_err(at)?.whitened)
        };
        Ok(Self { means: (0..sample.count).map(mean_of).collect::<Result<_, AnalysisError>>()? })
    }

    pub(super) fn evidence(
        &self,
        preparation: &Preparation,
        observations: Observations<'_>,
    ) -> Result<Vec<Evidence>, AnalysisError> {
        let Preparation { method, matching, .. } = preparation;
        let spaces: Vec<MeanSpace<'_>> = match method {
            Method::Projection(class) if matching.searches() => {
                self.means.iter().map(|mean| MeanSpace::from_shape(class, mean)).collect::<Result<_, _>>()?
            }
            _ => Vec::new(),
        };
        let targets: Vec<Target<'_>> = match method {
            _ if !matching.searches() => Vec::new(),
            Method::Projection(_) => spaces.iter().map(|space| Target::subspace(space, matching)).collect(),
            Method::Procrustes(fit) => {
                self.means.iter().map(|mean| Target::shape(mean, *fit, matching)).collect()
            }
        };
        let distance = |x: &[f64], class: usize| {
            let placement = match targets.get(class) {
                Some(target) => matching.best(x, target, Placement::default())?,
                None => Placement::default(),
            };
            let placed = matching.place(x, placement);
            let member = method.bring(&self.means[class], &placed)?.whitened;
            let rest: Vec<f64> = placed.iter().zip(&member).map(|(r, m)| r - m).collect();
            Ok(norm(&rest) / norm(x))
        };
        let evidence = |k: usize| {
            let distances: Result<Vec<f64>, AnalysisError> =
                (0..self.means.len()).map(|class| distance(observations.shape(k), class)).collect();
            distances.map(Evidence::from_residuals).map_err(|error| error.at(k))
        };
        parallel::try_map(observations.count(), &evidence)
    }
}
