//! The transformation class as an unknown of the posterior.
//!
//! ```text
//! y = A r + b,   r = M y + t      the pose, and the way back
//! q = (I + Σ θ_k T_k) y + τ       a small motion of a shape in pose; T_k = B_k A⁻¹ for a linear class 𝓑 = span{B_k}
//! ```
//!
//! Fits without a linear class move by rotations, `T_k` skew-symmetric, and by a scale, `T = I`.

use crate::AnalysisError;
use crate::DEGENERATE;
use crate::alignment::Method;
use crate::fit::{Scaling, cross_product, nearest_rotation, transform};
use crate::metric::dot;
use shapelex_numeric::dense::{Definite, Matrix};

/// Unknown part of the pose of a shape.
#[derive(Debug, Clone)]
pub enum Freedom {
    /// Nothing: shapes are in the pose of the dictionary.
    Fixed {
        /// `d`.
        dimension: usize,
    },
    /// A member of a linear class, and a translation if it has them.
    Span {
        /// `B_k`.
        matrices: Vec<Matrix>,
        /// Whether shapes are translated.
        translates: bool,
        /// `d`.
        dimension: usize,
    },
    /// A translation, a rotation and a scale.
    Fit {
        /// `d`.
        dimension: usize,
        /// Whether shapes are rotated.
        rotates: bool,
        /// Whether shapes are scaled.
        scales: bool,
    },
}

/// A pose: `y = A r + b`.
#[derive(Debug, Clone, PartialEq)]
pub struct Pose {
    /// `A`, `d × d`.
    pub matrix: Matrix,
    /// `b`.
    pub offset: Vec<f64>,
}

/// Part of a direction's own information that other directions must leave: less is rounding error.
const INDEPENDENT: f64 = 1e-12;

/// Longest step of the linear part of a pose.
const LONGEST: f64 = 0.5;

impl Freedom {
    /// Freedom that an alignment method removes.
    pub fn of(method: &Method, dimension: usize) -> Self {
        match method {
            Method::Projection(class) => {
                Self::Span { matrices: class.matrices().to_vec(), translates: class.translates(), dimension }
            }
            Method::Procrustes(fit) => {
                Self::Fit { dimension, rotates: fit.rotates, scales: fit.scaling != Scaling::None }
            }
        }
    }

    /// `d`.
    pub(super) fn dimension(&self) -> usize {
        match self {
            Self::Fixed { dimension } | Self::Span { dimension, .. } | Self::Fit { dimension, .. } => {
                *dimension
            }
        }
    }

    /// Whether translations are unknown.
    pub fn translates(&self) -> bool {
        match self {
            Self::Fixed { .. } => false,
            Self::Span { translates, .. } => *translates,
            Self::Fit { .. } => true,
        }
    }

    /// Number of unknowns.
    pub fn count(&self) -> usize {
        let d = self.dimension();
        let linear = match self {
            Self::Fixed { .. } => 0,
            Self::Span { matrices, .. } => matrices.len(),
            Self::Fit { rotates, scales, .. } => {
                usize::from(*scales) + if *rotates { d * (d - 1) / 2 } else { 0 }
            }
        };
        linear + if self.translates() { d } else { 0 }
    }

    /// `T_k` at a pose.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] for a pose without inverse.
    pub(super) fn directions(&self, pose: &Pose) -> Result<Vec<Matrix>, AnalysisError> {
        let d = self.dimension();
        match self {
            Self::Fixed { .. } => Ok(Vec::new()),
            Self::Span { matrices, .. } => {
                let back = pose.inverse()?.matrix;
                Ok(matrices.iter().map(|b| b * &back).collect())
            }
            Self::Fit { rotates, scales, .. } => {
                let skew = |i: usize, j: usize| {
                    let mut t = Matrix::zeros(d, d);
                    (t[(i, j)], t[(j, i)]) = (-1.0, 1.0);
                    t
                };
                let pairs = (0..d).flat_map(|i| (i + 1..d).map(move |j| (i, j))).filter(|_| *rotates);
                let rotations = pairs.map(|(i, j)| skew(i, j));
                Ok(rotations.chain(scales.then(|| Matrix::identity(d, d))).collect())
            }
        }
    }

    /// The pose that brings seen `points` nearest to those of a mean, both `d·M` coordinate-major numbers.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] at `observed` if the points do not determine it.
    pub(super) fn start(&self, points: &[f64], mean: &[f64]) -> Result<Pose, AnalysisError> {
        let d = self.dimension();
        let count = points.len() / d;
        match self {
            Self::Fixed { .. } => Ok(Pose::identity(d)),
            _ if count == 0 => Ok(Pose::identity(d)),
            Self::Span { matrices, translates, .. } => {
                let ((p, from), (m, to)) = match translates {
                    true => (centred(points, d), centred(mean, d)),
                    false => ((points.to_vec(), vec![0.0; d]), (mean.to_vec(), vec![0.0; d])),
                };
                let matrix = nearest_member(matrices, &p, &m, d)?;
                let offset = (0..d).map(|c| to[c] - (0..d).map(|e| matrix[(c, e)] * from[e]).sum::<f64>());
                Ok(Pose { offset: offset.collect(), matrix })
            }
            Self::Fit { rotates, scales, .. } => {
                let (p, from) = centred(points, d);
                let (m, to) = centred(mean, d);
                let h = cross_product(&m, &p, d);
                let rotation = if *rotates { nearest_rotation(&h) } else { Matrix::identity(d, d) };
                let scale = match dot(&p, &p) {
                    square if *scales && square > 0.0 => rotation.dot(&h) / square,
                    _ if *scales => return Err(undetermined()),
                    _ => 1.0,
                };
                if !(scale > 0.0) {
                    return Err(undetermined());
                }
                let matrix = rotation * scale;
                let offset = (0..d).map(|c| to[c] - (0..d).map(|e| matrix[(c, e)] * from[e]).sum::<f64>());
                Ok(Pose { offset: offset.collect(), matrix })
            }
        }
    }

    /// The pose that absorbs a motion `θ`, `τ`: seen points are moved back by it. Long motions are shortened.
    pub(super) fn absorb(&self, pose: &Pose, directions: &[Matrix], motion: &[f64]) -> Pose {
        let d = self.dimension();
        let mut linear = Matrix::zeros(d, d);
        directions.iter().zip(motion).for_each(|(t, theta)| linear += t * *theta);
        let part = (LONGEST / linear.norm()).min(1.0);
        let shift = &motion[directions.len()..];
        let mut matrix = &pose.matrix - part * (&linear * &pose.matrix);
        let moved = |c: usize| {
            let turned: f64 = (0..d).map(|e| linear[(c, e)] * pose.offset[e]).sum();
            pose.offset[c] - part * (turned + shift.get(c).copied().unwrap_or(0.0))
        };
        let offset = (0..d).map(moved).collect();
        if let Self::Fit { scales, rotates, .. } = self {
            let size = if *scales { matrix.determinant().abs().powf(1.0 / d as f64) } else { 1.0 };
            let rotation = if *rotates { nearest_rotation(&matrix) } else { Matrix::identity(d, d) };
            matrix = rotation * size;
        }
        Pose { matrix, offset }
    }
}

impl Pose {
    /// The pose of the dictionary.
    pub fn identity(dimension: usize) -> Self {
        Self { matrix: Matrix::identity(dimension, dimension), offset: vec![0.0; dimension] }
    }

    /// The way back, `r = M y + t`.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] with index 0 if `A` has no inverse.
    pub fn inverse(&self) -> Result<Self, AnalysisError> {
        let singular = self.matrix.singular_values();
        let sigma = singular.min() / singular.max();
        let inverse = self.matrix.clone().try_inverse().filter(|_| sigma >= DEGENERATE);
        let class = || "its own pose: what is seen of it is flat".into();
        let matrix = inverse.ok_or_else(|| AnalysisError::Degenerate { index: 0, class: class(), sigma })?;
        let d = self.offset.len();
        let offset = (0..d).map(|c| -(0..d).map(|e| matrix[(c, e)] * self.offset[e]).sum::<f64>()).collect();
        Ok(Self { matrix, offset })
    }

    /// `A r + b` of points, `d·M` coordinate-major numbers.
    pub fn apply(&self, points: &[f64]) -> Vec<f64> {
        let d = self.offset.len();
        let mut moved = transform(&self.matrix, points);
        let count = points.len() / d;
        for (c, offset) in self.offset.iter().enumerate() {
            moved[c * count..(c + 1) * count].iter_mut().for_each(|value| *value += offset);
        }
        moved
    }

    /// Mean square of the scale: variances are multiplied by it.
    pub(super) fn square(&self) -> f64 {
        self.matrix.norm_squared() / self.offset.len() as f64
    }
}

/// The member of the span of `matrices` that brings points nearest to others.
fn nearest_member(matrices: &[Matrix], p: &[f64], m: &[f64], d: usize) -> Result<Matrix, AnalysisError> {
    let moved: Vec<Vec<f64>> = matrices.iter().map(|b| transform(b, p)).collect();
    let products = Matrix::from_fn(moved.len(), moved.len(), |i, j| dot(&moved[i], &moved[j]));
    let right = Matrix::from_fn(moved.len(), 1, |i, _| dot(&moved[i], m));
    let factor = Definite::new(&products).ok().filter(|factor| factor.independence() > INDEPENDENT);
    let found = factor.ok_or_else(undetermined)?.solve(&right);
    Ok(matrices.iter().zip(found.iter()).fold(Matrix::zeros(d, d), |sum, (b, a)| sum + b * *a))
}

fn centred(points: &[f64], d: usize) -> (Vec<f64>, Vec<f64>) {
    let count = points.len() / d;
    let mut points = points.to_vec();
    let mut centre = vec![0.0; d];
    for (coordinate, centre) in points.chunks_exact_mut(count).zip(&mut centre) {
        *centre = coordinate.iter().sum::<f64>() / count as f64;
        coordinate.iter_mut().for_each(|value| *value -= *centre);
    }
    (points, centre)
}

/// The seen points do not determine the pose.
pub(super) fn undetermined() -> AnalysisError {
    let detail = "expected seen points that determine the pose, got too few, or some too near to each other";
    AnalysisError::Parameter { field: "observed", detail: detail.into() }
}
