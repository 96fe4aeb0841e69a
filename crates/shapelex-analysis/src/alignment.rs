//! The mean of a set of shapes, and the shapes aligned to it.
//!
//! ```text
//! r̃_k = P_k r_mean = A_k r_k + b_k      residual ‖r_mean − r̃_k‖      correlation ⟨r̃_k, r_mean⟩/(‖r̃_k‖‖r_mean‖)
//! ```

use super::AnalysisError;
use super::accumulate::{ShapeSource, ShapesInMemory, Watched, map_shapes};
use super::factors::Factors;
use super::fit::{self, Fit, Scaling};
use super::frame::{Frame, representative};
use super::matching::{Disagreement, Matching, Placed, Placement, Target};
use super::mean::{MeanSpace, ProjectorSum};
use super::metric::{Metric, dot, norm};
use super::placement_search::{Found, MAX_ROUNDS, Start, StreamedSearch, alternate, stages};
use super::procrustes;
use super::start_points::{SpectralSearch, is_spectral, spectral_bytes};
use super::subspace::{Projected, Subspace, check_extent, flatten};
use super::transformation::{ClassName, Transformation, TransformationClass};
use super::watch::StopWhen;
use shapelex_geometry::surface::motion::Motion;
use shapelex_numeric::dense::Matrix;

/// Minimum number of shapes for a mean.
pub const MIN_SHAPES: usize = 2;

/// Number of reported eigenvalues of the mean operator, where there are that many.
pub(super) const REPORTED_EIGENVALUES: usize = 10;

/// Alignment method.
#[derive(Debug, Clone)]
pub enum Method {
    /// Projection onto the subspaces of a linear class.
    Projection(TransformationClass),
    /// Generalised Procrustes fits.
    Procrustes(Fit),
}

/// Alignment method: `projection` onto the subspace of the transformation class, in closed form; `procrustes` iterates
/// rotations and scales, without reflection; `partial_procrustes` rotates shapes of unit size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Alignment {
    /// Closed-form projection onto the subspace of the transformation class.
    Projection,
    /// Iterated rotations and scales, without reflection: full Procrustes fits, whose scales bring each shape nearest to the
    /// mean.
    Procrustes,
    /// Iterated rotations of shapes of unit size, without reflection: partial Procrustes fits, as in geomorph. Comparisons and
    /// regressions project them into the tangent space at the mean.
    PartialProcrustes,
}

impl Alignment {
    /// The method unless another is given: projection, or Procrustes fits where the class is not a linear space in dimension `d`.
    pub fn usual(transformation: &Transformation, dimension: usize) -> Self {
        match transformation {
            Transformation::Named(class)
                if class.procrustes() && !class.projection_dimensions().contains(&dimension) =>
            {
                Self::Procrustes
            }
            _ => Self::Projection,
        }
    }
}

impl Method {
    /// The method for a class in dimension `d`. Pure translation is always a fit without rotation and scale: its mean
    /// is the arithmetic mean of the centred shapes.
    ///
    /// # Errors
    /// [`AnalysisError::NotAProperClass`] if the class does not support the alignment.
    pub fn new(
        transformation: &Transformation,
        alignment: Alignment,
        dimension: usize,
    ) -> Result<Self, AnalysisError> {
        let fit = |rotates, scaling| Ok(Self::Procrustes(Fit { dimension, rotates, scaling }));
        match (transformation, alignment) {
            (Transformation::Named(ClassName::Translation), _) => fit(false, Scaling::None),
            (Transformation::Named(ClassName::Similarity), Alignment::Procrustes) => fit(true, Scaling::Full),
            (Transformation::Named(ClassName::Similarity), Alignment::PartialProcrustes) => {
                fit(true, Scaling::Partial)
            }
            (_, Alignment::PartialProcrustes) => {
                Err(AnalysisError::NotAProperClass("partial Procrustes alignment requires similarity".into()))
            }
            (Transformation::Named(ClassName::Rigid), Alignment::Procrustes) => fit(true, Scaling::None),
            (_, Alignment::Procrustes) => Err(AnalysisError::NotAProperClass(
                "Procrustes alignment requires similarity, rigid or translation".into(),
            )),
            (other, Alignment::Projection) => {
                Ok(Self::Projection(TransformationClass::new(other, dimension)?))
            }
        }
    }

    /// Whether shapes are centred before alignment.
    pub fn translates(&self) -> bool {
        match self {
            Self::Projection(class) => class.translates(),
            Self::Procrustes(_) => true,
        }
    }

    /// Whether aligned shapes and their mean keep the sizes of the shapes.
    pub fn keeps_sizes(&self) -> bool {
        matches!(self, Self::Procrustes(fit) if fit.scaling == Scaling::None)
    }

    /// Whether rotations are removed, so that the orientation of aligned shapes has no meaning.
    pub fn rotates(&self) -> bool {
        use ClassName::*;
        match self {
            Self::Procrustes(fit) => fit.rotates,
            Self::Projection(class) => matches!(
                class.name(),
                Some(
                    ScaledRotation
                        | Similarity
                        | Linear
                        | Affine
                        | ReflectedScaledRotation
                        | ReflectedSimilarity
                )
            ),
        }
    }

    /// `b = −A r̄` if shapes are centred, else zero.
    pub(super) fn offset(&self, matrix: &Matrix, centroid: &[f64]) -> Vec<f64> {
        if self.translates() { offset_of(matrix, centroid) } else { vec![0.0; centroid.len()] }
    }

    /// Replaces the whitened shape `x` by the member of its class nearest to the whitened `mean`.
    pub(super) fn bring_in_place(&self, x: &mut [f64], mean: &[f64]) -> Result<(), AnalysisError> {
        match self {
            Self::Projection(class) => Subspace::bring(class, x, mean),
            Self::Procrustes(_) => {
                let brought = self.bring(x, mean)?.whitened;
                x.copy_from_slice(&brought);
                Ok(())
            }
        }
    }

    /// The member of the class of the whitened shape `x` nearest to the whitened `mean`.
    pub(super) fn bring(&self, x: &[f64], mean: &[f64]) -> Result<Projected, AnalysisError> {
        match self {
            Self::Projection(class) => Ok(Subspace::new(class, x)?.project(mean)),
            Self::Procrustes(fit) => {
                let matrix = fit.matrix(x, mean);
                Ok(Projected { whitened: fit::transform(&matrix, x), matrix })
            }
        }
    }
}

/// The mean shape with its certificate.
#[derive(Debug, Clone)]
pub struct MeanShape {
    /// Whitened mean, of unit norm except under rigid motions and translations.
    pub whitened: Vec<f64>,
    /// Control points of the mean: `d·N` numbers, coordinate-major.
    pub control_points: Vec<f64>,
    /// Orthonormal basis of the mean space, whitened, one element per column; `None` for Procrustes fits.
    pub basis: Option<Matrix>,
    /// Leading eigenvalues of the mean operator; empty for Procrustes fits.
    pub eigenvalues: Vec<f64>,
    /// Eigenvalue gap of the mean space.
    pub gap: Option<f64>,
    /// Whether the mean is unique.
    pub unique: Option<bool>,
    /// Sum of squared cosines between the mean space and the shapes.
    pub objective: Option<f64>,
    /// Number of shapes.
    pub shapes: usize,
    /// Rounds of the alternation with placements, or iterations of the Procrustes fit.
    pub rounds: usize,
    /// Whether the last round changed nothing.
    pub converged: bool,
    /// Whether parameterisations of surfaces agree with that of the mean; `None` for other shapes, and where they are searched.
    pub disagreement: Option<Disagreement>,
    /// Placement of every shape.
    pub placements: Vec<Placement>,
    /// Placements of the leading shapes, with which a search of these and any others that follow them may begin: its result is
    /// the same as without. Empty if all shapes were searched at once.
    pub leading: Vec<Placement>,
    /// Factors of the weights of the shapes, if the mean is robust.
    pub robust: Option<Factors>,
}

/// The mean of the shapes of `source` (prepared with [`Method::translates`]).
///
/// # Errors
/// [`AnalysisError::TooFewShapes`] below two shapes, degenerate shapes, errors of the source.
pub fn mean_shape(
    source: &dyn ShapeSource,
    metric: &Metric,
    method: &Method,
    frame: Frame,
    matching: &Matching,
) -> Result<MeanShape, AnalysisError> {
    if source.count() < MIN_SHAPES {
        return Err(AnalysisError::TooFewShapes { found: source.count(), needed: MIN_SHAPES });
    }
    match method {
        Method::Projection(class) => projection_mean(source, metric, class, frame, matching),
        Method::Procrustes(fit) => procrustes_mean(source, metric, *fit, frame, matching),
    }
}

fn projection_mean(
    source: &dyn ShapeSource,
    metric: &Metric,
    class: &TransformationClass,
    frame: Frame,
    matching: &Matching,
) -> Result<MeanShape, AnalysisError> {
    let found = match matching.searches() {
        true => searched(source, class, matching, metric.len())?,
        false => Found::as_given(source.count()),
    };
    let placed = Placed { source, matching, placements: &found.placements };
    let space = MeanSpace::new(ProjectorSum::of(&placed, class, metric.len())?, REPORTED_EIGENVALUES)?;
    let whitened = representative(&space, frame, metric, &placed)?;
    let disagreement =
        matching.disagreement(&placed, &Target::subspace(&space, matching), class.translates())?;
    Ok(MeanShape { disagreement, ..MeanShape::in_space(&space, metric, whitened, found) })
}

impl MeanShape {
    /// The mean of fits, whitened, with the placements that were found.
    pub(super) fn fitted(metric: &Metric, whitened: Vec<f64>, found: Found) -> Self {
        Self {
            control_points: unwhitened(metric, &whitened),
            whitened,
            basis: None,
            eigenvalues: Vec::new(),
            gap: None,
            unique: None,
            objective: None,
            shapes: found.placements.len(),
            rounds: found.rounds,
            converged: found.converged,
            disagreement: None,
            placements: found.placements,
            leading: found.leading,
            robust: None,
        }
    }

    /// The whitened representative of a mean `space`, with the placements that were found.
    pub(super) fn in_space(space: &MeanSpace<'_>, metric: &Metric, whitened: Vec<f64>, found: Found) -> Self {
        Self {
            basis: Some(space.elements()),
            gap: Some(space.gap),
            unique: Some(space.is_unique()),
            objective: Some(space.objective),
            eigenvalues: space.eigenvalues.clone(),
            ..Self::fitted(metric, whitened, found)
        }
    }
}

/// Placements of the shapes of `source`: on their spectra where the class allows it and memory suffices.
pub(super) fn searched(
    source: &dyn ShapeSource,
    class: &TransformationClass,
    matching: &Matching,
    length: usize,
) -> Result<Found, AnalysisError> {
    // Rounds of other classes cost more than the stages save.
    let is_spectral = is_spectral(class, matching);
    let stages = if is_spectral { stages(source.count()) } else { vec![source.count()] };
    let start = Start::of(source, &stages, matching)?;
    if is_spectral && let Some(_memory) = source.reserve(spectral_bytes(matching, source.count())) {
        let rotations = TransformationClass::named(ClassName::ScaledRotation, matching.dimension())?;
        let mut search = SpectralSearch::new(source, class, &rotations, matching, &start.placements)?;
        return alternate(&mut search, source, matching, &stages, start);
    }
    alternate(&mut StreamedSearch::new(source, class, matching, length), source, matching, &stages, start)
}

pub(super) fn procrustes_mean(
    source: &dyn ShapeSource,
    metric: &Metric,
    fit: Fit,
    frame: Frame,
    matching: &Matching,
) -> Result<MeanShape, AnalysisError> {
    let all = source.count();
    let Start { mut placements, known } =
        if matching.searches() { Start::of(source, &[all], matching)? } else { Start::as_given(all) };
    let template = procrustes::start(&Placed { source, matching, placements: &placements }, fit)?;
    if matching.mirrors() && known == 0 {
        matching.improve(source, &Target::shape(&template, fit, matching), &mut placements)?;
    }
    let placed = Placed { source, matching, placements: &placements };
    let mut result = procrustes::iterate(&placed, fit, template)?;
    let (mut rounds, mut converged) = (0, !matching.searches());
    while !converged && rounds < MAX_ROUNDS {
        rounds += 1;
        let target = Target::shape(&result.mean, fit, matching);
        converged = matching.improve(source, &target, &mut placements)?.is_empty();
        if !converged {
            let placed = Placed { source, matching, placements: &placements };
            result = procrustes::iterate(&placed, fit, result.mean)?;
        }
    }
    let placed = Placed { source, matching, placements: &placements };
    let disagreement = matching.disagreement(&placed, &Target::shape(&result.mean, fit, matching), true)?;
    let whitened = procrustes::turn(result.mean, fit, frame, metric, &placed)?;
    let found = Found {
        placements,
        leading: Vec::new(),
        rounds: rounds.max(result.iterations),
        converged: converged && result.converged,
    };
    Ok(MeanShape { disagreement, ..MeanShape::fitted(metric, whitened, found) })
}

/// A shape aligned to a mean.
#[derive(Debug, Clone)]
pub struct AlignedShape {
    /// Whitened coordinates.
    pub whitened: Vec<f64>,
    /// Linear part `A` of the alignment, `d × d`.
    pub matrix: Matrix,
    /// Translation `b`, `d` numbers: the aligned shape is `A r + b` (after shift and direction).
    pub offset: Vec<f64>,
    /// Residual `‖r_mean − r̃‖`.
    pub residual: f64,
    /// Cosine of the angle between the aligned shape and the mean.
    pub correlation: f64,
    /// Chosen start point and direction.
    pub placement: Placement,
    /// On a surface whose parameters move, their motion, and the relative [change](Matching::change) of the surface by it.
    pub moved: Option<(Motion, f64)>,
}

impl AlignedShape {
    /// Whether the shape was matched as a mirror image: `det A < 0`.
    pub fn reflected(&self) -> bool {
        self.matrix.determinant() < 0.0
    }
}

/// Aligns the whitened shape `x` to `mean`; `centroid` is its centroid before it was prepared.
///
/// # Errors
/// [`AnalysisError::Degenerate`] with index 0.
pub fn align(
    method: &Method,
    matching: &Matching,
    mean: &[f64],
    x: &[f64],
    centroid: &[f64],
    placement: Placement,
) -> Result<AlignedShape, AnalysisError> {
    let (placed, moved_by) = matching.place_with_mean(x, placement);
    let projected = method.bring(&placed, mean)?;
    let matrix = projected.matrix * matching.reflection(placement);
    let about = |by: Vec<f64>| centroid.iter().zip(by).map(|(given, by)| given + by).collect::<Vec<f64>>();
    let offset = method.offset(&matrix, &moved_by.map_or_else(|| centroid.to_vec(), about));
    let whitened = projected.whitened;
    let residual = mean.iter().zip(&whitened).map(|(m, r)| (m - r).powi(2)).sum::<f64>().sqrt();
    let correlation = cosine(&whitened, mean);
    let moved = matching.motion(placement).map(|motion| (motion, matching.change(x, placement)));
    Ok(AlignedShape { whitened, matrix, offset, residual, correlation, placement, moved })
}

/// `−A r̄`.
fn offset_of(matrix: &Matrix, centroid: &[f64]) -> Vec<f64> {
    (0..centroid.len())
        .map(|c| -(0..centroid.len()).map(|e| matrix[(c, e)] * centroid[e]).sum::<f64>())
        .collect()
}

fn cosine(a: &[f64], b: &[f64]) -> f64 {
    let product = norm(a) * norm(b);
    if product > 0.0 { (dot(a, b) / product).clamp(-1.0, 1.0) } else { 0.0 }
}

/// Mean and aligned shapes of `control_points` in memory, `d·N` numbers per shape.
///
/// # Errors
/// As [`mean_shape`].
pub fn align_all(
    metric: &Metric,
    method: &Method,
    frame: Frame,
    matching: &Matching,
    control_points: Vec<f64>,
    weights: Vec<f64>,
) -> Result<(MeanShape, Vec<AlignedShape>), AnalysisError> {
    align_all_until(metric, method, frame, matching, control_points, weights, &|| false)
}

/// As [`align_all`], with cancellation: `stop` is checked before every pass over the shapes.
///
/// # Errors
/// As [`mean_shape`]; [`AnalysisError::Interrupted`] once `stop` returns true.
pub fn align_all_until(
    metric: &Metric,
    method: &Method,
    frame: Frame,
    matching: &Matching,
    control_points: Vec<f64>,
    weights: Vec<f64>,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<(MeanShape, Vec<AlignedShape>), AnalysisError> {
    align_all_to(metric, method, matching, control_points, weights, stop, |shapes| {
        mean_shape(shapes, metric, method, frame, matching)
    })
}

/// The mean that `mean_of` finds, and the shapes aligned to it. Reading them ends once `stop` returns true.
pub(super) fn align_all_to(
    metric: &Metric,
    method: &Method,
    matching: &Matching,
    control_points: Vec<f64>,
    weights: Vec<f64>,
    stop: &(dyn Fn() -> bool + Sync),
    mean_of: impl FnOnce(&dyn ShapeSource) -> Result<MeanShape, AnalysisError>,
) -> Result<(MeanShape, Vec<AlignedShape>), AnalysisError> {
    let centroids: Vec<Vec<f64>> =
        control_points.chunks_exact(metric.len()).map(|shape| metric.centroid(shape)).collect();
    let source = ShapesInMemory::marked(metric, method.translates(), control_points, weights)?;
    let watch = StopWhen(stop);
    let source = Watched::new(&source, &watch);
    let mean = mean_of(&source)?;
    let aligned = map_shapes(&source, |k, x, _| {
        align(method, matching, &mean.whitened, x, &centroids[k], mean.placements[k])
            .map_err(|error| error.at(k))
    })?;
    Ok((mean, aligned))
}

/// Projection of a reference shape onto the class of another shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Projection {
    /// The nearest member `A r + b`, `d·N` coordinate-major control points.
    pub control_points: Vec<f64>,
    /// Linear part `A`, `d × d`.
    pub matrix: Matrix,
    /// Translation `b`, `d` numbers.
    pub offset: Vec<f64>,
    /// Squared distance `‖r_ref − (A r + b)‖²`.
    pub squared_distance: f64,
    /// Cosine of the angle between the two, about their mean positions if the class translates.
    pub correlation: f64,
}

/// Projects one reference onto the classes of many shapes (Theorem 1); the reference is prepared once.
#[derive(Debug, Clone)]
pub struct Projector<'a> {
    metric: &'a Metric,
    method: &'a Method,
    reference: Vec<f64>,
    position: Vec<f64>,
}

impl<'a> Projector<'a> {
    /// Prepares the reference with the given control points.
    pub fn new(metric: &'a Metric, method: &'a Method, mut reference: Vec<f64>) -> Self {
        let position = take_position(metric, method, &mut reference);
        metric.whiten(&mut reference);
        Self { metric, method, reference, position }
    }

    /// The member of the class of `shape` nearest to the reference. Cost `O(N log N + dN I²)`.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`], [`AnalysisError::NoExtent`] with index 0.
    pub fn project(&self, mut shape: Vec<f64>) -> Result<Projection, AnalysisError> {
        let size = norm(&shape);
        let centroid = take_position(self.metric, self.method, &mut shape);
        check_extent(norm(&shape), size)?;
        if self.method.translates() {
            flatten(&mut shape, self.metric.dimension(), size);
        }
        self.metric.whiten(&mut shape);
        let Projected { whitened, matrix } = self.method.bring(&shape, &self.reference)?;
        let distances = self.reference.iter().zip(&whitened).map(|(m, r)| (m - r).powi(2));
        let squared_distance = distances.sum();
        let correlation = cosine(&whitened, &self.reference);
        let offset = offset_of(&matrix, &centroid).iter().zip(&self.position).map(|(b, p)| b + p).collect();
        let mut control_points = unwhitened(self.metric, &whitened);
        for (coordinate, p) in control_points.chunks_exact_mut(self.metric.size()).zip(&self.position) {
            coordinate.iter_mut().for_each(|value| *value += p);
        }
        Ok(Projection { control_points, matrix, offset, squared_distance, correlation })
    }
}

/// Direction of a projection between shapes and a reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Onto {
    /// Nearest member of the reference's class to each shape, `P_ref r_k = A r_ref + b`.
    #[default]
    Reference,
    /// Nearest member of each shape's class to the reference, `P_k r_ref = A r_k + b`.
    Shape,
}

/// Projections between shapes and a reference, in either direction.
#[derive(Debug)]
pub struct BothWays<'a> {
    to_reference: Projector<'a>,
    /// Control points of the reference.
    reference: Vec<f64>,
}

impl<'a> BothWays<'a> {
    /// Prepares the reference with the given control points.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`], [`AnalysisError::NoExtent`] for the reference, with index 0.
    pub fn new(metric: &'a Metric, method: &'a Method, reference: Vec<f64>) -> Result<Self, AnalysisError> {
        let to_reference = Projector::new(metric, method, reference.clone());
        to_reference.project(reference.clone())?;
        Ok(Self { to_reference, reference })
    }

    /// Projects a shape on the reference, or the reference on the shape; degenerate shapes are refused in both directions.
    ///
    /// # Errors
    /// As [`Projector::project`].
    pub fn project(&self, shape: &[f64], onto: Onto) -> Result<Projection, AnalysisError> {
        let aligned = self.to_reference.project(shape.to_vec())?;
        match onto {
            Onto::Shape => Ok(aligned),
            Onto::Reference => {
                let Projector { metric, method, .. } = self.to_reference;
                Projector::new(metric, method, shape.to_vec()).project(self.reference.clone())
            }
        }
    }
}

/// `L₂` norms of shapes, about their mean positions if the class translates.
pub fn norms(metric: &Metric, method: &Method, control_points: &[f64]) -> Vec<f64> {
    let of = |shape: &[f64]| {
        let mut shape = shape.to_vec();
        take_position(metric, method, &mut shape);
        metric.whiten(&mut shape);
        norm(&shape)
    };
    control_points.chunks_exact(metric.len()).map(of).collect()
}

/// Centres the shape if the class translates, and returns the position that was subtracted.
fn take_position(metric: &Metric, method: &Method, shape: &mut [f64]) -> Vec<f64> {
    if method.translates() { metric.centre(shape) } else { vec![0.0; metric.dimension()] }
}

/// Control points of a whitened shape.
pub fn unwhitened(metric: &Metric, whitened: &[f64]) -> Vec<f64> {
    let mut control_points = whitened.to_vec();
    metric.unwhiten(&mut control_points);
    control_points
}
