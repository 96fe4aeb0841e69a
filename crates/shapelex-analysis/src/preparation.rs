//! Preparation of shapes for coding.
//!
//! ```text
//! aligned      y = s·r̃,  r̃ = A r + b the member of the class of r nearest to the mean,  s = 1 or 1/‖r̃‖
//! invariant    y = M (r − r̄),  M ∈ 𝓑 such that y is the normal form of r
//! ```
//!
//! Start point, direction and mirror image are those that match the mean best. The same function prepares the shapes for
//! learning and for later queries, so that a training shape gets its training code again.

use crate::accumulate::{MergePart, Reservation, ShapeSource, Shapes, for_each_changed, prepare};
use crate::algebra::Algebra;
use crate::alignment::{Method, align};
use crate::matching::{Matching, Placement, Target};
use crate::mean::MeanSpace;
use crate::metric::{Metric, norm};
use crate::pass::{Aligned, CodeGroup, Group, Pass};
use crate::{AnalysisError, DEGENERATE};
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::parallel;

/// Shapes of a task. Results do not depend on it.
const TASK: usize = 16;

/// Form of shapes for coding.
#[derive(Debug, Clone, PartialEq)]
pub enum Pose {
    /// Shapes aligned to the mean, of unit norm when `normalise`.
    Aligned {
        /// Whether to divide by the norm.
        normalise: bool,
    },
    /// Normal forms; the code transforms along with the shape.
    Invariant(Algebra),
}

/// Prepares shapes for a dictionary.
#[derive(Debug, Clone)]
pub struct Preparation {
    /// The metric of the representation.
    pub metric: Metric,
    /// The class, and the method that removes it.
    pub method: Method,
    /// The search of start points, directions and mirror images.
    pub matching: Matching,
    /// The whitened mean shape.
    pub mean: Vec<f64>,
    /// Form of the shapes for coding.
    pub pose: Pose,
}

/// A shape prepared for coding: `y = A r + b`, after start point and direction.
#[derive(Debug, Clone, PartialEq)]
pub struct Prepared {
    /// `y`, whitened.
    pub whitened: Vec<f64>,
    /// Linear part `A`, `d × d`.
    pub matrix: Matrix,
    /// Translation `b`.
    pub offset: Vec<f64>,
    /// Start point, direction and mirror image.
    pub placement: Placement,
}

impl Preparation {
    /// Prepares shapes given by their control points, one after the other.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] or [`AnalysisError::NoExtent`] with the position of the shape.
    pub fn prepare(&self, control_points: &[f64]) -> Result<Vec<Prepared>, AnalysisError> {
        let length = self.metric.len();
        let mut whitened = control_points.to_vec();
        prepare(&self.metric, self.method.translates(), 0, &mut whitened)?;
        self.with_target(|target| {
            parallel::try_map(whitened.len() / length, &|k| {
                let range = k * length..(k + 1) * length;
                let (shape, x) = (&control_points[range.clone()], &whitened[range]);
                self.pose(x, &self.metric.centroid(shape), target).map_err(|error| error.at(k))
            })
        })
    }

    /// Calls `f` with the target of the search for start points, directions and mirror images, or with `None` without a search.
    fn with_target<T, E: From<AnalysisError>>(
        &self,
        f: impl FnOnce(Option<&Target<'_>>) -> Result<T, E>,
    ) -> Result<T, E> {
        if !self.matching.searches() {
            return f(None);
        }
        match &self.method {
            Method::Projection(class) => {
                let space = MeanSpace::from_shape(class, &self.mean)?;
                f(Some(&Target::subspace(&space, &self.matching)))
            }
            Method::Procrustes(fit) => f(Some(&Target::shape(&self.mean, *fit, &self.matching))),
        }
    }

    /// Brings a whitened shape (centred when the class translates) into pose.
    fn pose(
        &self,
        x: &[f64],
        centroid: &[f64],
        target: Option<&Target<'_>>,
    ) -> Result<Prepared, AnalysisError> {
        let placement = self.placement(x, target)?;
        match &self.pose {
            Pose::Aligned { normalise } => {
                let aligned = align(&self.method, &self.matching, &self.mean, x, centroid, placement)?;
                self.check_aligned(&aligned.whitened)?;
                let mut prepared = Prepared {
                    whitened: aligned.whitened,
                    matrix: aligned.matrix,
                    offset: aligned.offset,
                    placement,
                };
                if *normalise {
                    prepared.scale(1.0 / norm(&prepared.whitened));
                }
                Ok(prepared)
            }
            Pose::Invariant(algebra) => {
                let mut whitened = self.matching.place(x, placement).into_owned();
                let matrix = algebra.normalise(&mut whitened)? * self.matching.reflection(placement);
                let offset = self.method.offset(&matrix, centroid);
                Ok(Prepared { whitened, matrix, offset, placement })
            }
        }
    }

    /// Start point, direction and mirror image of a whitened shape.
    fn placement(&self, x: &[f64], target: Option<&Target<'_>>) -> Result<Placement, AnalysisError> {
        let stands = Placement::default();
        target.map_or(Ok(stands), |target| self.matching.best(x, target, stands))
    }

    /// Refuses an aligned shape that is orthogonal to the mean.
    fn check_aligned(&self, whitened: &[f64]) -> Result<(), AnalysisError> {
        let sigma = norm(whitened) / norm(&self.mean);
        if sigma >= DEGENERATE {
            return Ok(());
        }
        let class = "alignment to the mean, to which it is orthogonal".into();
        Err(AnalysisError::Degenerate { index: 0, class, sigma })
    }

    /// Replaces a whitened shape by the one in pose, as [`Self::prepare`] gives it.
    fn pose_in_place(&self, x: &mut [f64], target: Option<&Target<'_>>) -> Result<(), AnalysisError> {
        let placement = self.placement(x, target)?;
        if placement != Placement::default() {
            let placed = self.matching.place(x, placement).into_owned();
            x.copy_from_slice(&placed);
        }
        match &self.pose {
            Pose::Aligned { normalise } => {
                self.method.bring_in_place(x, &self.mean)?;
                self.check_aligned(x)?;
                if *normalise {
                    let factor = 1.0 / norm(x);
                    x.iter_mut().for_each(|value| *value *= factor);
                }
            }
            Pose::Invariant(algebra) => {
                algebra.normalise(x)?;
            }
        }
        Ok(())
    }
}

impl Prepared {
    fn scale(&mut self, factor: f64) {
        self.matrix *= factor;
        self.whitened.iter_mut().chain(&mut self.offset).for_each(|value| *value *= factor);
    }

    /// The transformation from the pose back to the shape as given, `r = A⁻¹ (y − b)`: matrix and offset.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] with index 0 if `A` has no inverse.
    pub fn back(&self) -> Result<(Matrix, Vec<f64>), AnalysisError> {
        let singular = self.matrix.singular_values();
        let sigma = singular.min() / singular.max();
        let inverse = self.matrix.clone().try_inverse().filter(|_| sigma >= DEGENERATE);
        let class = || "its own pose: the alignment to the mean flattens it".into();
        let inverse = inverse.ok_or_else(|| AnalysisError::Degenerate { index: 0, class: class(), sigma })?;
        let d = self.offset.len();
        let offset = (0..d).map(|c| -(0..d).map(|e| inverse[(c, e)] * self.offset[e]).sum::<f64>()).collect();
        Ok((inverse, offset))
    }
}

/// A source whose shapes are prepared for coding.
pub struct Posed<'a> {
    /// Whitened shapes, centred when the class translates.
    pub source: &'a dyn ShapeSource,
    /// The preparation.
    pub preparation: &'a Preparation,
}

impl ShapeSource for Posed<'_> {
    fn count(&self) -> usize {
        self.source.count()
    }

    fn check(&self) -> Result<(), AnalysisError> {
        self.source.check()
    }

    fn worked(&self, shapes: usize) {
        self.source.worked(shapes);
    }

    fn reserve(&self, bytes: usize) -> Option<Reservation<'_>> {
        self.source.reserve(bytes)
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        let preparation = self.preparation;
        preparation.with_target(|target| {
            let pose = |batch: Shapes<'_>, whitened: &mut [f64]| {
                let length = preparation.metric.len();
                parallel::try_for_each_chunk(whitened, TASK * length, &|task, shapes| {
                    let mut shapes = (batch.first + task * TASK..).zip(shapes.chunks_exact_mut(length));
                    shapes.try_for_each(|(position, x)| {
                        preparation.pose_in_place(x, target).map_err(|error| error.at(position))
                    })
                })
            };
            for_each_changed(self.source, pose, visit)
        })
    }

    /// Passes over normal forms are not distributed: a pass cannot describe how they are computed.
    fn spread(&self, pass: &Pass, merge: &mut MergePart<'_>) -> Result<bool, AnalysisError> {
        let Pose::Aligned { normalise } = self.preparation.pose else { return Ok(false) };
        if pass.aligned.is_some() {
            return Ok(false);
        }
        let aligned = Some(Aligned { mean: self.preparation.mean.clone(), normalise });
        self.source.spread(&Pass { aligned, ..pass.clone() }, merge)
    }

    fn coders(&self) -> Option<CodeGroup<'_>> {
        let code = self.source.coders()?;
        Some(Box::new(move |group| code(Group { mean: &self.preparation.mean, ..group })))
    }
}
