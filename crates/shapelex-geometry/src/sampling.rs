//! Places along the shapes of a space, the same on each of them: to compare shapes point by point.

use super::curve::Curve;
use super::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::sparse::SparseRows;

/// Places along a shape.
#[derive(Debug, Clone)]
pub enum Places {
    /// Every landmark, as many as there are.
    Landmarks(usize),
    /// Parameters on a curve.
    Curve(Vec<f64>),
    /// A grid of parameters on a surface.
    Surface([Vec<f64>; 2]),
    /// Vertices of a subdivision surface at its level, by their weights of the control vertices.
    Vertices(SparseRows),
}

impl Places {
    /// `count` equally spaced places on curves: from `u = 0`, to `u = 1` on open ones. Landmarks, the knots of surfaces and
    /// the control vertices of subdivision surfaces are what they are, whatever `count` is.
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

    /// How many there are.
    pub fn count(&self) -> usize {
        match self {
            Self::Landmarks(count) => *count,
            Self::Curve(parameters) => parameters.len(),
            Self::Surface([u, v]) => u.len() * v.len(),
            Self::Vertices(rows) => rows.rows(),
        }
    }

    /// The parameter of a place on a curve, the index of any other: `k n_v + l` on the grid of a surface.
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

    /// Where they are on a shape of the space, coordinate-major.
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
