//! The representative of a mean space: the member that is reported as the mean shape.
//!
//! * `training`: the unit member closest to the shapes as posed, the maximiser of
//!   `Σ_k w_k ⟨r, r_k⟩² / ‖r_k‖²` over the mean space (an `I × I` eigenproblem), with the sign that makes
//!   `Σ_k w_k ⟨r, r_k⟩ / ‖r_k‖` positive;
//! * `canonical`: depends on the mean space alone, hence exactly invariant when every shape is transformed by its
//!   own member of the class.

use super::AnalysisError;
use super::accumulate::{
    Accumulator, BLOCK, ShapeSource, Shapes, accumulate, accumulate_spread, read_numbers, write_numbers,
};
use super::mean::MeanSpace;
use super::metric::{Metric, dot, norm};
use super::pass::Sum;
use super::transformation::{ClassName, Structure, TransformationClass};
use shapelex_numeric::dense::{Matrix, fill_upper, leading_eigenpairs};

/// Choice of the representative: which member of the mean space is the mean shape. `training`: the one closest to the shapes
/// as posed. `canonical`: one that does not change when shapes are transformed within the class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Frame {
    /// The member closest to the shapes as posed.
    #[default]
    Training,
    /// A member determined by the mean space alone; it does not change when shapes are transformed within the class.
    Canonical,
}

/// `Σ w y yᵀ` and `Σ w y` with `y = Eᵀx/‖x‖`, where `E` is a basis of the mean space.
#[derive(Debug, Clone)]
pub(super) struct FrameSum<'a> {
    elements: &'a Matrix,
    quadratic: Matrix,
    linear: Vec<f64>,
}

impl<'a> FrameSum<'a> {
    pub(super) fn new(elements: &'a Matrix) -> Self {
        let count = elements.ncols();
        Self { elements, quadratic: Matrix::zeros(count, count), linear: vec![0.0; count] }
    }
}

impl Accumulator for FrameSum<'_> {
    fn unit(&self) -> usize {
        BLOCK
    }

    fn update(&mut self, shapes: Shapes<'_>) -> Result<(), AnalysisError> {
        for (_, x, weight) in shapes.iter() {
            let size = norm(x);
            let y: Vec<f64> = self.elements.column_iter().map(|e| dot(e.as_slice(), x) / size).collect();
            for j in 0..y.len() {
                self.linear[j] += weight * y[j];
                for i in j..y.len() {
                    self.quadratic[(i, j)] += weight * y[i] * y[j];
                }
            }
        }
        Ok(())
    }

    fn merge(&mut self, other: Self) {
        self.quadratic += other.quadratic;
        self.linear.iter_mut().zip(&other.linear).for_each(|(a, b)| *a += b);
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_numbers(&mut bytes, &self.linear);
        write_numbers(&mut bytes, self.quadratic.as_slice());
        bytes
    }

    fn restore(&mut self, mut bytes: &[u8]) -> Result<(), AnalysisError> {
        let (linear, quadratic) = (read_numbers(&mut bytes)?, read_numbers(&mut bytes)?);
        let count = self.linear.len();
        if linear.len() != count || quadratic.len() != count * count {
            return Err(AnalysisError::NotAnAccumulator);
        }
        (self.linear, self.quadratic) = (linear, Matrix::from_vec(count, count, quadratic));
        Ok(())
    }
}

/// Whitened unit representative of `space` in `frame`. The training frame takes one pass over `source`.
///
/// # Errors
/// [`AnalysisError::NoCanonicalFrame`] for classes given by matrices; errors of the source.
pub fn representative(
    space: &MeanSpace<'_>,
    frame: Frame,
    metric: &Metric,
    source: &dyn ShapeSource,
) -> Result<Vec<f64>, AnalysisError> {
    match frame {
        Frame::Training => training(space, source),
        Frame::Canonical => Ok(canonical(space, metric)?),
    }
}

fn training(space: &MeanSpace<'_>, source: &dyn ShapeSource) -> Result<Vec<f64>, AnalysisError> {
    let elements = space.elements();
    let mut sum = training_sum(source, &elements)?;
    fill_upper(&mut sum.quadratic);
    let top = leading_eigenpairs(&sum.quadratic, 1).map_err(AnalysisError::from)?;
    let a = top.vectors.column(0);
    let sign = if dot(a.as_slice(), &sum.linear) < 0.0 { -1.0 } else { 1.0 };
    Ok((&elements * a * sign).as_slice().to_vec())
}

/// The sum that determines the training frame; `elements` is a basis of the mean space, one element per column.
pub(super) fn training_sum<'a>(
    source: &dyn ShapeSource,
    elements: &'a Matrix,
) -> Result<FrameSum<'a>, AnalysisError> {
    let empty = || FrameSum::new(elements);
    let sum = Sum::Frame { elements: elements.as_slice().to_vec() };
    accumulate_spread(source, sum, empty, || accumulate(source, empty))
}

pub(super) fn canonical(space: &MeanSpace<'_>, metric: &Metric) -> Result<Vec<f64>, AnalysisError> {
    use ClassName::*;
    let class = space.class;
    let elements = space.elements();
    let first = || elements.column(0).as_slice().to_vec();
    let refusal = || AnalysisError::NoCanonicalFrame { class: class.label().into() };
    let mut r = match class.name().ok_or_else(refusal)? {
        Linear | Affine | NonUniformScaling | NonUniformScalingTranslation => diagonal_member(space),
        ScaledRotation | Similarity | ReflectedScaledRotation | ReflectedSimilarity => {
            principal_axes(&first())
        }
        HorizontalShear | HorizontalShearTranslation => uncorrelated_member(&elements, 1),
        VerticalShear | VerticalShearTranslation => uncorrelated_member(&elements, 0),
        UniformScaling | UniformScalingTranslation => first(),
        Translation | Rigid => return Err(refusal()),
    };
    fix_signs(&mut r, class, metric);
    Ok(r)
}

/// `(f_1, …, f_d)/√d`: coordinate `c` of the member is the `c`-th basis function of its block.
fn diagonal_member(space: &MeanSpace<'_>) -> Vec<f64> {
    let d = space.class.dimension();
    let function = |c: usize| match space.class.structure {
        Structure::PerAxis => space.bases[c].column(0),
        _ => space.bases[0].column(c),
    };
    (0..d).flat_map(|c| function(c).iter().map(|v| v / (d as f64).sqrt()).collect::<Vec<_>>()).collect()
}

/// The planar shape, rotated so that its principal axis of inertia lies on x.
fn principal_axes(r: &[f64]) -> Vec<f64> {
    let (x, y) = r.split_at(r.len() / 2);
    let angle = 0.5 * (2.0 * dot(x, y)).atan2(dot(x, x) - dot(y, y));
    let (s, c) = angle.sin_cos();
    let turned_x = x.iter().zip(y).map(|(x, y)| c * x + s * y);
    let turned_y = x.iter().zip(y).map(|(x, y)| c * y - s * x);
    turned_x.chain(turned_y).collect()
}

/// The unit member of a two-dimensional mean space with `⟨x, y⟩ = 0`. Of the two solutions, the one with the longer
/// coordinate `keep`; the other is the degenerate member without that coordinate.
fn uncorrelated_member(elements: &Matrix, keep: usize) -> Vec<f64> {
    let n = elements.nrows() / 2;
    let part = |e: usize, c: usize| elements.column(e).as_slice()[c * n..(c + 1) * n].to_vec();
    let form = |i: usize, j: usize| 0.5 * (dot(&part(i, 0), &part(j, 1)) + dot(&part(j, 0), &part(i, 1)));
    let (p, q, s) = (form(0, 0), form(0, 1), form(1, 1));
    // p cos² + 2 q cos sin + s sin² = 0: with the double angle, (p+s)/2 + ρ cos(2θ − ψ) = 0
    let (radius, psi) = (f64::hypot(0.5 * (p - s), q), q.atan2(0.5 * (p - s)));
    let opening = (-0.5 * (p + s) / radius).clamp(-1.0, 1.0).acos();
    let member = |theta: f64| {
        (elements.column(0) * theta.cos() + elements.column(1) * theta.sin()).as_slice().to_vec()
    };
    let kept = |r: &[f64]| norm(&r[keep * n..(keep + 1) * n]);
    let (one, other) = (member(0.5 * (psi + opening)), member(0.5 * (psi - opening)));
    if kept(&one) >= kept(&other) { one } else { other }
}

/// Fixes signs: the largest control coordinate is positive, for every basis function separately if the class may
/// flip them; then planar shapes are counter-clockwise if the class may reflect.
fn fix_signs(r: &mut [f64], class: &TransformationClass, metric: &Metric) {
    let n = metric.size();
    let separate = matches!(class.structure, Structure::PerCoordinate | Structure::PerAxis);
    let mut control_points = r.to_vec();
    metric.unwhiten(&mut control_points);
    let width = if separate { n } else { r.len() };
    for (part, control) in r.chunks_exact_mut(width).zip(control_points.chunks_exact_mut(width)) {
        if largest(control) < 0.0 {
            part.iter_mut().chain(control).for_each(|value| *value = -*value);
        }
    }
    if separate && metric.dimension() == 2 && polygon_area(&control_points) < 0.0 {
        r[n..].iter_mut().for_each(|value| *value = -*value);
    }
}

/// The entry of largest magnitude; the first one in a tie.
pub(super) fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |best: f64, &value| if value.abs() > best.abs() { value } else { best })
}

fn polygon_area(control_points: &[f64]) -> f64 {
    let (x, y) = control_points.split_at(control_points.len() / 2);
    let n = x.len();
    (0..n).map(|k| x[k] * y[(k + 1) % n] - x[(k + 1) % n] * y[k]).sum()
}
