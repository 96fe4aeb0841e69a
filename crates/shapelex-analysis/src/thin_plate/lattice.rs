//! Lattices of equal cells around landmarks.

use shapelex_numeric::dense::Matrix;

/// Nodes of a lattice in the plane or in space.
#[derive(Debug, Clone, PartialEq)]
pub struct Lattice {
    /// Number of nodes along each axis.
    pub size: Vec<usize>,
    /// Side of a cell.
    pub spacing: f64,
    /// First node.
    pub first: Vec<f64>,
}

impl Lattice {
    /// A lattice around the bounding box of points (`n × d`), which is larger on each side by `margin` of its extent, with `cells` cells
    /// along its longest side.
    pub fn around(points: &Matrix, cells: usize, margin: f64) -> Self {
        let bounds: Vec<[f64; 2]> = points.column_iter().map(|column| [column.min(), column.max()]).collect();
        let longest = bounds.iter().map(|[low, high]| high - low).fold(0.0, f64::max);
        let spacing = if longest > 0.0 { longest * (1.0 + 2.0 * margin) / cells as f64 } else { 1.0 };
        let along = |[low, high]: &[f64; 2]| {
            let wanted = (high - low) * (1.0 + 2.0 * margin) / spacing;
            // Rounding adds no cell.
            let cells = (wanted - 1e-9).ceil().max(1.0);
            (cells as usize + 1, 0.5 * (low + high) - 0.5 * cells * spacing)
        };
        let (size, first) = bounds.iter().map(along).unzip();
        Self { size, spacing, first }
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.size.iter().product()
    }

    /// Whether there are no nodes, which is never so.
    pub fn is_empty(&self) -> bool {
        self.size.is_empty()
    }

    /// Nodes, one per row; the last axis varies fastest.
    pub fn nodes(&self) -> Matrix {
        let d = self.size.len();
        Matrix::from_fn(self.len(), d, |k, c| {
            let inner: usize = self.size[c + 1..].iter().product();
            self.first[c] + self.spacing * (k / inner % self.size[c]) as f64
        })
    }

    /// Number of points beyond the lattice.
    pub fn outside(&self, points: &Matrix) -> usize {
        let within = |c: usize, x: f64| {
            (0.0..=self.spacing * (self.size[c] - 1) as f64).contains(&(x - self.first[c]))
        };
        points.row_iter().filter(|row| row.iter().enumerate().any(|(c, x)| !within(c, *x))).count()
    }

    /// Lines of the lattice in the plane of two axes through `through`, with `parts` pieces for each cell: points, one per row.
    pub fn lines(&self, axes: [usize; 2], through: &[f64], parts: usize) -> Vec<Matrix> {
        let line = |across: usize, along: usize, k: usize| {
            let count = (self.size[along] - 1) * parts + 1;
            Matrix::from_fn(count, self.size.len(), |i, c| {
                let steps = match c {
                    _ if c == along => i as f64 / parts as f64,
                    _ if c == across => k as f64,
                    _ => return through[c],
                };
                self.first[c] + self.spacing * steps
            })
        };
        let [a, b] = axes;
        let first = (0..self.size[a]).map(move |k| (a, b, k));
        first
            .chain((0..self.size[b]).map(|k| (b, a, k)))
            .map(|(across, along, k)| line(across, along, k))
            .collect()
    }
}
