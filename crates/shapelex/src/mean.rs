//! Means, and shapes aligned to them.

use shapelex_analysis::alignment::{AlignedShape, MeanShape, unwhitened};
use shapelex_analysis::dictionary::method::Method;
use shapelex_analysis::drawing::{View, draw_mean};
use shapelex_analysis::robust::align_all_by;
use shapelex_geometry::drawing::scene::Drawing;
use shapelex_geometry::sampling::Places;
use shapelex_numeric::dense::Matrix;

use crate::error::Result;
use crate::points::Points;
use crate::setting::{Aim, Prepared, Setting};
use crate::shapes::{Set, Shapes, Space};

/// Places along a curve where a mean is answered.
const SAMPLES: usize = 200;
/// Most aligned shapes that are drawn behind a mean.
const DRAWN: usize = 200;

/// The mean of shapes under a class, with its aligned shapes.
#[derive(Debug)]
#[non_exhaustive]
pub struct Mean {
    /// Number of shapes.
    pub shapes: usize,
    /// Whether no other mean is as near to the shapes; `None` for fits that do not tell.
    pub unique: Option<bool>,
    /// Whether the search ended by its tolerance.
    pub converged: bool,
    /// Control points, at unit size where the class removes size.
    pub control_points: Points,
    /// The shapes aligned to the mean, by their control points.
    pub aligned: Vec<Points>,
    /// Distance of each aligned shape from the mean.
    pub distances: Vec<f64>,
    /// How much each shape counts: 1, and in a robust mean 0 for one that is unlike the majority.
    pub weights: Vec<f64>,
    space: Space,
    found: MeanShape,
    drawn: Vec<AlignedShape>,
}

impl Mean {
    pub(crate) fn of(set: &Set, setting: Setting) -> Result<Self> {
        let method = Method::components(1, true);
        let (representation, correspondence) = (set.representation(), set.correspondence());
        let space = Prepared::new(setting, representation, correspondence, (Aim::Mean, method))?;
        let control_points = set.control_points(&space)?;
        let (measured, dimension) = (space.setting.measured(), space.dimension());
        let (estimator, metric) = (space.recipe.estimator, &space.setting.metric);
        let weights = vec![1.0; set.shapes.len()];
        let never = || false;
        let (found, aligned) =
            align_all_by(estimator, measured, space.recipe.frame, control_points, weights, &never)?;
        let factors = found.robust.as_ref().map(|robust| robust.factors.clone());
        let points = |columns: &[f64]| Points::of_columns(columns, dimension);
        Ok(Self {
            shapes: found.shapes,
            unique: found.unique,
            converged: found.converged,
            control_points: points(&found.control_points),
            aligned: aligned.iter().map(|shape| points(&unwhitened(metric, &shape.whitened))).collect(),
            distances: aligned.iter().map(|shape| shape.residual).collect(),
            weights: factors.unwrap_or_else(|| vec![1.0; aligned.len()]),
            found,
            drawn: aligned,
            space,
        })
    }

    /// Points on the mean: 200 along a curve, the knots of a surface, the landmarks.
    ///
    /// ```
    /// use shapelex::{Class, Contours};
    ///
    /// let ellipse = |k: usize| {
    ///     let angle = |i: usize| i as f64 * std::f64::consts::TAU / 50.0;
    ///     (0..50).map(|i| [(2.0 + 0.1 * k as f64) * angle(i).cos(), angle(i).sin()]).collect::<Vec<_>>()
    /// };
    /// let mean = Contours::new((0..5).map(ellipse))?.mean(Class::Rigid)?;
    /// let widest = mean.points().rows().map(|point| point[0].hypot(point[1])).fold(0.0, f64::max);
    /// assert!((widest - 2.2).abs() < 0.01, "{widest}");
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn points(&self) -> Points {
        let (space, dimension) = (self.space.space(), self.space.dimension());
        let columns = &self.found.control_points;
        let shape = Matrix::from_column_slice(columns.len() / dimension, dimension, columns);
        Points::of_columns(&Places::along(space, SAMPLES).points(space, &shape), dimension)
    }

    /// The mean before the aligned shapes, at most 200 of them.
    ///
    /// ```
    /// use shapelex::{Class, Landmarks};
    ///
    /// let triangle = |k: usize| vec![[0.0, 0.0], [1.0, 0.0], [0.1 * k as f64, 1.0]];
    /// let mean = Landmarks::new((0..6).map(triangle))?.mean(Class::Similarity)?;
    /// assert!(shapelex::svg(&mean.drawing("Triangles")).starts_with("<svg"));
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn drawing(&self, title: &str) -> Drawing {
        let (setting, mean) = (&self.space.setting, &self.found.control_points);
        let view = View::upright(&setting.space, &setting.method, mean);
        draw_mean(&view, &setting.metric, title, (mean, self.shapes), &self.drawn, DRAWN)
    }
}

impl<K> Shapes<K> {
    /// The mean of the shapes under a class, template-free, with the shapes aligned to it.
    ///
    /// Cost: one pass for landmarks and given start points, some rounds where start points are searched.
    ///
    /// # Errors
    /// [`Error::Shape`](crate::Error::Shape) and [`Error::Analysis`](crate::Error::Analysis): fewer than two shapes, shapes without
    /// an extent, a class that does not fit.
    ///
    /// ```
    /// use shapelex::{Class, Contours};
    ///
    /// // The same ellipse, moved, turned, in three sizes, and drawn from other start points.
    /// let ellipse = |k: usize| {
    ///     let angle = move |i: usize| (i + 7 * k) as f64 * std::f64::consts::TAU / 60.0;
    ///     let (sine, cosine) = (k as f64).sin_cos();
    ///     let point = move |i: usize| [2.0 * angle(i).cos(), angle(i).sin()];
    ///     let turned = move |[x, y]: [f64; 2]| [cosine * x - sine * y, sine * x + cosine * y];
    ///     (0..60).map(|i| turned(point(i)).map(|x| (k + 1) as f64 * x + k as f64)).collect::<Vec<_>>()
    /// };
    /// let mean = Contours::new((0..3).map(ellipse))?.mean(Class::Similarity)?;
    /// assert!(mean.distances.iter().all(|distance| *distance < 1e-3));
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn mean(&self, setting: impl Into<Setting>) -> Result<Mean> {
        Mean::of(&self.set, setting.into())
    }
}
