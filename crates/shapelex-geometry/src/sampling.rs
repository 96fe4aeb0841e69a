//! Corresponding points along the shapes of a space, for comparing shapes point by point.

use super::curve::Curve;
use super::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::sparse::SparseRows;

/// A set of places along a shape.
#[derive(Debug, Clone)]
pub enum Places {
    /// All landmarks; holds their number.
    Landmarks(usize),
    /// Parameters on a curve.
    Curve(Vec<f64>),
    /// A grid of parameters on a surface.
    Surface([Vec<f64>; 2]),
    /// Vertices of a subdivision surface at its level, as weights of the control vertices.
    Vertices(SparseRows),
}

impl Places {
    /// `count` equally spaced places on curves, from `u = 0` (on open curves to `u = 1`). For landmarks, surfaces (their knots)
    /// and subdivision surfaces (their control vertices) `count` has no effect.
    pub fn along(space: &ShapeSpace, count: usize) -> Self {
        let size = space.representation().size();
        let zero = Matrix::zeros(size, space.representation().dimension());
        if let Some(curve) = Curve::of(space, &zero) {
            return Self::Curve(curve.parameters(count));
        }
        match (space.surface(), space.subdivision()) {
            (Some(basis), _) => {
                let (surface, grid) = (basis.surface(&zero), basis.extent().grid());
                Self::Surface([0, 1].map(|i| surface.parameters(i, grid[i])))
            }
            (_, Some(basis)) => Self::Vertices(basis.at_control_vertices()),
            _ => Self::Landmarks(size),
        }
    }

    /// The places of shapes of `space` in words, as they complete "… are compared".
    pub fn kind(space: &ShapeSpace) -> &'static str {
        match (space.surface(), space.subdivision()) {
            (Some(_), _) => "surfaces at their knots",
            (_, Some(_)) => "subdivision surfaces at their control vertices",
            _ if space.generator().is_some() => "curves at equally spaced places",
            _ => "landmarks as they are",
        }
    }

    /// Why the number of places is not a choice; `None` for curves, where it is one.
    pub fn rule(space: &ShapeSpace) -> Option<&'static str> {
        match (space.surface(), space.subdivision()) {
            (Some(_), _) => Some("surfaces are compared at their knots"),
            (_, Some(_)) => Some("subdivision surfaces are compared at their control vertices"),
            _ if space.generator().is_some() => None,
            _ => Some("landmarks are compared as they are"),
        }
    }

    /// Number of places.
    pub fn count(&self) -> usize {
        match self {
            Self::Landmarks(count) => *count,
            Self::Curve(parameters) => parameters.len(),
            Self::Surface([u, v]) => u.len() * v.len(),
            Self::Vertices(rows) => rows.rows(),
        }
    }

    /// Parameter of a place on a curve; for other shapes its index, which is `k n_v + l` on the grid of a surface.
    pub fn parameter(&self, index: usize) -> f64 {
        match self {
            Self::Curve(parameters) => parameters[index],
            _ => index as f64,
        }
    }

    /// `u` and `v` of a place on a surface.
    pub fn surface_parameters(&self, index: usize) -> Option<[f64; 2]> {
        match self {
            Self::Surface([u, v]) => Some([u[index / v.len()], v[index % v.len()]]),
            _ => None,
        }
    }

    /// Positions of the places on a shape of the space, coordinate-major.
    pub fn points(&self, space: &ShapeSpace, control_points: &Matrix) -> Vec<f64> {
        match self {
            Self::Landmarks(_) => control_points.as_slice().to_vec(),
            Self::Curve(parameters) => Curve::of(space, control_points)
                .expect("the places are those of curves")
                .evaluate_all(parameters, 0),
            Self::Surface([u, v]) => {
                let basis = space.surface().expect("the places are those of surfaces");
                let points = basis.surface(control_points).points(u, v);
                (0..3).flat_map(|c| points.iter().map(move |point| point[c])).collect()
            }
            Self::Vertices(rows) => {
                let column = |c: usize| rows.apply_column(control_points.column(c).as_slice());
                (0..3).flat_map(column).collect()
            }
        }
    }
}
