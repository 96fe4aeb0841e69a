//! Paths between two shapes, and routes through several.
//!
//! ```text
//! plane   c(τ) = (1 − τ) c_1 + τ c_2
//! sphere  r(τ) = sin((1 − τ)θ)/sin θ · r_1/‖r_1‖ + sin(τθ)/sin θ · r_2/‖r_2‖,   θ = arccos ⟨r_1, r_2⟩/(‖r_1‖‖r_2‖)
//! ```
//!
//! `τ = 0` is the first shape, `τ = 1` the second; other values extrapolate. Both paths are linear in the shapes and can
//! be formed from control points; only `θ` and the norms need the metric. A route through `n` shapes is at shape `k` where
//! `τ = k`, on the path of its neighbours in between, and on the first and the last path beyond its ends.
//!
//! Source: Schmitter 2017, (7.14)–(7.18); (7.17) presumes unit norms, and the directions of (7.16) and (7.18) differ.

use super::AnalysisError;
use super::metric::Metric;

/// Angle below which the path is straight to working precision.
const FLAT: f64 = 1e-7;

/// Distance from `π` below which the great circle between two shapes is not determined.
const ANTIPODAL: f64 = 1e-7;

/// Kind of path between two shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum PathKind {
    /// Straight line `(1 − τ) r_1 + τ r_2`.
    #[default]
    Plane,
    /// Great circle between the shapes scaled to unit `L₂` norm.
    Sphere,
}

/// Positions on a path.
#[derive(Debug, Clone, PartialEq)]
pub enum Positions {
    /// Equally spaced from the first shape to the last, at least two.
    Steps(usize),
    /// The given positions.
    At(Vec<f64>),
}

impl Positions {
    /// Number of positions.
    pub fn count(&self) -> usize {
        match self {
            Self::At(list) => list.len(),
            Self::Steps(count) => *count,
        }
    }

    /// All positions on a route of `pieces` paths, from 0 to `pieces`.
    pub fn list(self, pieces: usize) -> Vec<f64> {
        match self {
            Self::At(list) => list,
            Self::Steps(count) => (0..count).map(|i| (i * pieces) as f64 / (count - 1) as f64).collect(),
        }
    }
}

/// A path from `first` to `second`, both `d·N` coordinate-major control points.
#[derive(Debug, Clone)]
pub struct Path {
    first: Vec<f64>,
    second: Vec<f64>,
    /// `θ` on the sphere, `None` in the plane.
    angle: Option<f64>,
}

impl Path {
    /// The path of a kind.
    ///
    /// # Errors
    /// As [`Self::sphere`].
    pub fn new(
        kind: PathKind,
        metric: &Metric,
        first: Vec<f64>,
        second: Vec<f64>,
    ) -> Result<Self, AnalysisError> {
        match kind {
            PathKind::Plane => Ok(Self::plane(first, second)),
            PathKind::Sphere => Self::sphere(metric, first, second),
        }
    }

    /// The straight path.
    pub fn plane(first: Vec<f64>, second: Vec<f64>) -> Self {
        Self { first, second, angle: None }
    }

    /// The great circle between the unit-norm shapes.
    ///
    /// # Errors
    /// [`AnalysisError::NoExtent`] for a shape of norm zero (index 0 for the first, 1 for the second),
    /// [`AnalysisError::Antipodal`] if the shapes are opposite.
    pub fn sphere(metric: &Metric, mut first: Vec<f64>, mut second: Vec<f64>) -> Result<Self, AnalysisError> {
        for (index, shape) in [&mut first, &mut second].into_iter().enumerate() {
            let norm = metric.inner(shape, shape).sqrt();
            if !(norm > 0.0) {
                return Err(AnalysisError::NoExtent { index, norm, size: norm });
            }
            shape.iter_mut().for_each(|value| *value /= norm);
        }
        let angle = metric.inner(&first, &second).clamp(-1.0, 1.0).acos();
        if angle > std::f64::consts::PI - ANTIPODAL {
            return Err(AnalysisError::Antipodal { angle });
        }
        Ok(Self { first, second, angle: Some(angle) })
    }

    /// `θ` in radians; `None` in the plane.
    pub fn angle(&self) -> Option<f64> {
        self.angle
    }

    /// Control points at `τ`.
    pub fn at(&self, tau: f64) -> Vec<f64> {
        let (a, b) = match self.angle {
            Some(angle) if angle > FLAT => {
                (((1.0 - tau) * angle).sin() / angle.sin(), (tau * angle).sin() / angle.sin())
            }
            _ => (1.0 - tau, tau),
        };
        self.first.iter().zip(&self.second).map(|(x, y)| a * x + b * y).collect()
    }
}

/// The path of position `tau` on a route of `pieces` paths, and the position on that path.
pub fn on_piece(tau: f64, pieces: usize) -> (usize, f64) {
    let piece = (tau.floor().max(0.0) as usize).min(pieces.saturating_sub(1));
    (piece, tau - piece as f64)
}

/// A route through two or more shapes, `d·N` coordinate-major control points each: a [`Path`] from each to the next.
#[derive(Debug, Clone)]
pub struct Route {
    paths: Vec<Path>,
}

impl Route {
    /// The route of a kind through `shapes`, at least two.
    ///
    /// # Errors
    /// As [`Path::sphere`], with the position of a shape of norm zero; [`AnalysisError::TooFewShapes`] for fewer than two.
    pub fn new(kind: PathKind, metric: &Metric, shapes: &[Vec<f64>]) -> Result<Self, AnalysisError> {
        if shapes.len() < 2 {
            return Err(AnalysisError::TooFewShapes { found: shapes.len(), needed: 2 });
        }
        let path = |(k, pair): (usize, &[Vec<f64>])| {
            Path::new(kind, metric, pair[0].clone(), pair[1].clone()).map_err(|error| error.after(k))
        };
        Ok(Self { paths: shapes.windows(2).enumerate().map(path).collect::<Result<_, _>>()? })
    }

    /// `θ` of every path in radians; `None` in the plane.
    pub fn angles(&self) -> Option<Vec<f64>> {
        self.paths.iter().map(Path::angle).collect()
    }

    /// Control points at `τ`.
    pub fn at(&self, tau: f64) -> Vec<f64> {
        let (piece, tau) = on_piece(tau, self.paths.len());
        self.paths[piece].at(tau)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shapelex_numeric::operator::ScaledIdentity;

    /// The metric of three points in the plane.
    fn metric() -> Metric {
        Metric::new(std::sync::Arc::new(ScaledIdentity::new(3, 1.0)), 2)
    }

    fn shapes() -> Vec<Vec<f64>> {
        vec![
            vec![1.0, 0.0, 0.5, 0.0, 2.0, 0.0],
            vec![0.0, 3.0, 0.0, 1.0, 0.0, 0.25],
            vec![0.0, 0.5, 0.0, 1.5, 1.0, 4.0],
            vec![2.0, 2.0, 0.0, 0.0, 1.0, 1.0],
        ]
    }

    #[test]
    fn routes_are_the_paths_of_their_neighbours_and_go_on_beyond_their_ends() {
        let shapes = shapes();
        for kind in [PathKind::Plane, PathKind::Sphere] {
            let route = Route::new(kind, &metric(), &shapes).unwrap();
            let places =
                [(-0.75, 0), (0.0, 0), (0.25, 0), (1.0, 1), (1.5, 1), (2.0, 2), (2.9, 2), (3.0, 2), (4.5, 2)];
            for (tau, piece) in places {
                let path =
                    Path::new(kind, &metric(), shapes[piece].clone(), shapes[piece + 1].clone()).unwrap();
                assert_eq!(route.at(tau), path.at(tau - piece as f64), "{kind:?} at {tau}");
            }
            assert_eq!(route.angles().map(|angles| angles.len()), (kind == PathKind::Sphere).then_some(3));
        }
        let route = Route::new(PathKind::Plane, &metric(), &shapes).unwrap();
        (0..4).for_each(|k| assert_eq!(route.at(k as f64), shapes[k]));
        assert_eq!(Positions::Steps(7).list(3), [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0]);
    }

    #[test]
    fn the_shape_that_has_no_route_is_named() {
        let mut shapes = shapes();
        shapes[2] = vec![0.0; 6];
        let error = Route::new(PathKind::Sphere, &metric(), &shapes).unwrap_err();
        assert_eq!(error.position(), Some(2));
        shapes[2] = shapes[1].iter().map(|x| -x).collect();
        let error = Route::new(PathKind::Sphere, &metric(), &shapes).unwrap_err();
        assert!(matches!(error, AnalysisError::Antipodal { .. }), "{error}");
        assert!(Route::new(PathKind::Plane, &metric(), &shapes[..1]).is_err());
    }
}
