//! The space of tensor-product surfaces of one topology and size.

use std::sync::{Arc, OnceLock};

use super::measures::sizes::{Rules, SheetSizes};
use super::seam::{Seam, TwistedGram};
use super::sharp::SharpGram;
use super::sphere::{POLAR_ROWS, SphereBasis, SphereGram, handle_length, sharp_polar_rows};
use super::{Surface, Topology};
use crate::GeometryError;
use crate::generator::{GeneratorKind, phantoms};
use crate::knot_line::{Line, SHIFTED_CLOSED, gram_eigenvalues};
use crate::open::open_gram;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::kronecker::{Kronecker, transpose};
use shapelex_numeric::operator::SymmetricOperator;
use shapelex_numeric::sparse::SparseRows;

/// Topology and size of a surface, as chosen by the client.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Extent {
    /// Topology of the surface.
    pub topology: Topology,
    /// Number of intervals, `M_u` and `M_v`.
    pub intervals: [usize; 2],
}

impl Extent {
    /// Size of the grid of points of a posted shape: `M` along closed directions, `M + 1` along open ones.
    pub fn grid(self) -> [usize; 2] {
        let closed = self.topology.closed();
        [0, 1].map(|i| self.intervals[i].saturating_add(usize::from(!closed[i])))
    }

    /// Number of rows of a shape, `N`, for generators with so many control points beyond open ends.
    pub fn size(self, beyond: [[usize; 2]; 2]) -> usize {
        // Two control points at and beyond each pole follow from the conditions there.
        let between = (self.intervals[1] + beyond[1][0] + beyond[1][1]).saturating_sub(3);
        match self.topology {
            Topology::Sphere => self.intervals[0].saturating_mul(between).saturating_add(POLAR_ROWS),
            Topology::SharpSphere => {
                self.intervals[0].saturating_mul(between).saturating_add(sharp_polar_rows(self.intervals[0]))
            }
            _ => {
                let [rows, columns] = self.control_grid(beyond);
                rows.saturating_mul(columns)
            }
        }
    }

    /// Number of control points along `u` and `v`, including those beyond open edges.
    fn control_grid(self, beyond: [[usize; 2]; 2]) -> [usize; 2] {
        let (grid, closed) = (self.grid(), self.topology.closed());
        [0, 1].map(|i| if closed[i] { grid[i] } else { grid[i].saturating_add(beyond[i].iter().sum()) })
    }
}

/// Inconsistencies of a surface with admissible generators: fields and details.
pub fn faults(extent: Extent, seam: Seam, kinds: &[GeneratorKind; 2]) -> Vec<(&'static str, String)> {
    let mut faults = Vec::new();
    if !seam.is_straight() && extent.topology != Topology::Torus {
        faults.push(("seam", format!("expected no twisted seam: a {} has no seam", extent.topology.name())));
    }
    if seam == Seam::HalfTurn && extent.intervals[1] % 2 == 1 {
        let detail = format!(
            "expected an even number, got {}: a half turn goes from knots to knots",
            extent.intervals[1]
        );
        faults.push(("control_points/1", detail));
    }
    for (i, kind) in kinds.iter().enumerate() {
        if kind.is_shifted() && extent.topology.closed()[i] {
            faults.push((["generators/0", "generators/1"][i], SHIFTED_CLOSED.into()));
        }
    }
    if extent.topology.has_poles() {
        if phantoms(kinds[1].support()) != 1 {
            let support = kinds[1].support();
            faults.push((
                "generators/1",
                format!("expected a support of 3 or 4 for the conditions at two poles, got {support}"),
            ));
        }
        if !kinds[0].properties().partition_of_unity {
            let detail =
                "expected a generator that reproduces constants, to close at the pole: add the pole 0";
            faults.push(("generators/0", detail.into()));
        }
    }
    faults
}

/// Tangents at the poles, `σ_v(u, 0) = T_1N cos 2πu + T_2N sin 2πu`, and likewise at the south pole.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Tangents {
    /// `T_1N` and `T_2N` at the north pole. Default: estimated from the points.
    pub north: Option<[[f64; 3]; 2]>,
    /// `T_1S` and `T_2S` at the south pole. Default: estimated from the points.
    pub south: Option<[[f64; 3]; 2]>,
}

/// Relative distance of a frequency from that of one turn, below which it is the same number.
const SAME_FREQUENCY: f64 = 1e-13;

/// A prepared basis of surfaces.
#[derive(Debug, Clone)]
pub struct SurfaceBasis {
    extent: Extent,
    seam: Seam,
    lines: [Line; 2],
    /// Line along two turns of `u`, for twisted tori.
    cover: Option<Line>,
    /// Conditions at the poles, for spheres.
    sphere: Option<SphereBasis>,
    gram: Arc<dyn SymmetricOperator>,
    /// Rules for areas and volumes, prepared when they are first needed.
    size_rules: Arc<OnceLock<Rules>>,
}

impl SurfaceBasis {
    /// Prepares the basis. Cost: two generators (cached), their Gram operators, and on spheres three banded factorisations.
    ///
    /// # Errors
    /// Errors of the generators; [`GeometryError::Dependent`]; [`GeometryError::Surface`] for the first of [`faults`].
    pub fn new(extent: Extent, seam: Seam, kinds: &[GeneratorKind; 2]) -> Result<Self, GeometryError> {
        if let Some((field, detail)) = faults(extent, seam, kinds).into_iter().next() {
            return Err(GeometryError::Surface { field, detail });
        }
        let Extent { topology, intervals } = extent;
        let (mut cover, mut sphere) = (None, None);
        let line = |i: usize| match topology {
            Topology::Sphere | Topology::SharpSphere if i == 1 => Line::meridian(&kinds[1], intervals[1]),
            _ => Line::new(&kinds[i], intervals[i], topology.closed()[i]),
        };
        let lines = [line(0)?, line(1)?];
        let gram: Arc<dyn SymmetricOperator> = match topology {
            Topology::Sphere => {
                let basis = SphereBasis::new(&lines[0], &lines[1])?;
                let eigenvalues = gram_eigenvalues(lines[0].generator(), intervals[0])?;
                let meridian = open_gram(lines[1].generator(), intervals[1], 0);
                let support = lines[1].generator().support();
                let gram = SphereGram::new(basis.clone(), eigenvalues, &meridian, support)?;
                sphere = Some(basis);
                Arc::new(gram)
            }
            Topology::SharpSphere => {
                let interpolating = kinds[1].properties().interpolating;
                let basis = SphereBasis::sharp(&lines[0], &lines[1], interpolating)?;
                let eigenvalues = gram_eigenvalues(lines[0].generator(), intervals[0])?;
                let meridian = open_gram(lines[1].generator(), intervals[1], 0);
                let support = lines[1].generator().support();
                let gram = SharpGram::new(&basis, eigenvalues, &meridian, support)?;
                sphere = Some(basis);
                Arc::new(gram)
            }
            _ if seam.is_straight() => {
                Arc::new(Kronecker::new(lines[0].gram().clone(), lines[1].gram().clone()))
            }
            _ => {
                let twice = Line::twice_round(&kinds[0], intervals[0])?;
                let gram = Kronecker::new(twice.gram().clone(), lines[1].gram().clone());
                cover = Some(twice);
                Arc::new(TwistedGram { seam, cover: Arc::new(gram), count: intervals[1] })
            }
        };
        Ok(Self { extent, seam, lines, cover, sphere, gram, size_rules: Arc::default() })
    }

    /// Area and volume of the surface with these rows, in the unit of its control points. Cost: sixteen to twenty-five jets for each
    /// piece, several times as many where the normal almost vanishes; the rules are prepared once for a basis.
    pub fn sizes(&self, rows: &Matrix) -> SheetSizes {
        let rules = self.size_rules.get_or_init(|| Rules::new(&self.lines, self.extent.intervals));
        SheetSizes::of(&self.surface(rows), rules)
    }

    /// Topology and size of the surfaces.
    pub fn extent(&self) -> Extent {
        self.extent
    }

    /// The seam of a torus.
    pub fn seam(&self) -> Seam {
        self.seam
    }

    /// The lines along `u` and `v`.
    pub fn lines(&self) -> &[Line; 2] {
        &self.lines
    }

    /// The Gram operator of the rows of a shape.
    pub fn gram(&self) -> &Arc<dyn SymmetricOperator> {
        &self.gram
    }

    /// Whether constants are reproduced, so that moving all rows moves the surface.
    pub fn reproduces_constants(&self) -> bool {
        self.lines.iter().all(Line::reproduces_constants)
    }

    /// Whether there is a surface through all points at the knots. Smooth spheres of shifted splines have one ring of control points less
    /// than such points: they meet them in the least-squares sense.
    pub fn meets_points(&self) -> bool {
        self.extent.topology != Topology::Sphere || !self.lines[1].generator().is_shifted()
    }

    /// Moves the surface of `rows` by `by`. Constants must be reproduced; the rows of the constant 1 are whole numbers.
    pub fn translate(&self, rows: &mut Matrix, by: [f64; 3]) {
        let ones = self.interpolate_function(|_, _| [1.0; 3]);
        for (c, by) in by.iter().enumerate() {
            let shares = ones.column(c).map(f64::round);
            rows.column_mut(c).axpy(*by, &shares, 1.0);
        }
    }

    /// Rows of the surface that interpolates `points` (`[u][v]` at `(k/M_u, l/M_v)`, three columns). On spheres, every list along
    /// `v` includes both poles.
    ///
    /// The poles of a sphere are taken from its first meridian. Tangents that are not given are estimated: two vectors in
    /// the plane of the first harmonic of the ring next to the pole, orthogonal if the ring is round, with the length
    /// that is exact for a round sphere. Meridians of a sphere with sharp poles are continued beyond the poles as open lines are.
    pub fn interpolate(&self, points: &Matrix, tangents: &Tangents) -> Matrix {
        let columns = points.column_iter().enumerate().map(|(c, points)| {
            let points = points.as_slice();
            match &self.sphere {
                Some(sphere) if sphere.is_sharp() => sphere.interpolate_sharp(points, &self.lines),
                Some(sphere) => {
                    let [north, south] = self.tangents(points, tangents, c);
                    sphere.interpolate(points, &self.lines, north, south)
                }
                None => self.interpolate_sheet(points),
            }
        });
        let rows: Vec<f64> = columns.flatten().collect();
        Matrix::from_vec(self.gram.size(), points.ncols(), rows)
    }

    /// Rows of the surface that interpolates a function of `u` and `v` at the knots; tangents at the poles of spheres are estimated.
    pub fn interpolate_function(&self, at: impl Fn(f64, f64) -> [f64; 3]) -> Matrix {
        self.interpolate_function_with(at, &Tangents::default())
    }

    /// The same with given tangents.
    pub fn interpolate_function_with(
        &self,
        at: impl Fn(f64, f64) -> [f64; 3],
        tangents: &Tangents,
    ) -> Matrix {
        let [count_u, count_v] = self.extent.grid();
        let mut points = Matrix::zeros(count_u * count_v, 3);
        for k in 0..count_u {
            for l in 0..count_v {
                let [u, v] = [(k, 0), (l, 1)].map(|(k, i)| k as f64 / self.extent.intervals[i] as f64);
                let point = at(u, v);
                (0..3).for_each(|c| points[(k * count_v + l, c)] = point[c]);
            }
        }
        self.interpolate(&points, tangents)
    }

    /// Reverses `u` in one coordinate of the rows: `σ(u, v)` becomes `σ(−u, v)`, or `σ(1 − u, v)` if `u` is open.
    pub fn reverse(&self, column: &mut [f64]) {
        let closed = self.extent.topology.closed()[0];
        let (columns, polar) = match &self.sphere {
            Some(sphere) => (sphere.between(), sphere.polar_rows()),
            None => (self.gram.size() / self.lines_stored(), 0),
        };
        let (grid, polar) = column.split_at_mut(column.len() - polar);
        let before = grid.to_vec();
        let count = grid.len() / columns;
        for (k, row) in grid.chunks_exact_mut(columns).enumerate() {
            let from = if closed { (count - k) % count } else { count - 1 - k };
            for (l, value) in row.iter_mut().enumerate() {
                // From −k to M − k crosses the seam.
                let l = if closed && k > 0 { self.seam.across(l, columns) } else { l };
                *value = before[from * columns + l];
            }
        }
        if self.extent.topology == Topology::SharpSphere {
            // The handle of meridian 0 stays.
            let [north, south] = [2, 2 + count].map(|first| first + 1..first + count);
            polar[north].reverse();
            polar[south].reverse();
            return;
        }
        // The tangent that belongs to sin 2πu changes its sign.
        if let [north, south, _, north_handle, _, south_handle] = polar {
            *north_handle = 2.0 * *north - *north_handle;
            *south_handle = 2.0 * *south - *south_handle;
        }
    }

    /// Tangents at the poles of the sphere with these `rows`; none for other topologies and sharp poles.
    pub fn tangents_of(&self, rows: &Matrix) -> Tangents {
        if self.extent.topology != Topology::Sphere {
            return Tangents::default();
        }
        let first = rows.nrows() - POLAR_ROWS;
        let length = handle_length(self.extent.intervals[1]);
        let tangents = |pole: usize| {
            [0, 1].map(|i| {
                let handle = first + 2 + 2 * pole + i;
                [0, 1, 2].map(|c| (rows[(handle, c)] - rows[(first + pole, c)]) / length)
            })
        };
        Tangents { north: Some(tangents(0)), south: Some(tangents(1)) }
    }

    /// Rows of the poles and handles of spheres, one column per coordinate; no rows for other topologies.
    pub(super) fn poles_of(&self, rows: &Matrix) -> Matrix {
        let count = self.sphere.as_ref().map_or(0, SphereBasis::polar_rows);
        rows.rows(rows.nrows() - count, count).into_owned()
    }

    /// Whether the tangents at the poles of a sphere are the same functions of `u` on a finer grid: `cos 2πu` and `sin 2πu` are among
    /// the functions that the generator reproduces.
    pub(super) fn keeps_tangents(&self) -> bool {
        let turn = std::f64::consts::TAU / self.extent.intervals[0] as f64;
        self.lines[0].poles().trigonometric.iter().any(|w| (w / turn - 1.0).abs() <= SAME_FREQUENCY)
    }

    /// Rows of the surface with the control points `nets` (`[k][l]`, one list per coordinate, as [`Self::control_net`] has them).
    /// Spheres also need the rows `polar` of a surface with the same poles and tangents on another grid, and the shift `δ_u` by which
    /// its `u` is behind.
    pub(super) fn rows_of_net(&self, nets: &[Vec<f64>], polar: &Matrix, from: usize, shift: f64) -> Matrix {
        let Some(sphere) = &self.sphere else {
            return Matrix::from_vec(self.gram.size(), nets.len(), nets.concat());
        };
        let columns = sphere.columns_stored();
        let longer = handle_length(self.extent.intervals[1]) / handle_length(from);
        let (sine, cosine) = (std::f64::consts::TAU * shift).sin_cos();
        let mut rows = Vec::with_capacity(self.gram.size() * nets.len());
        for (net, polar) in nets.iter().zip(polar.column_iter()) {
            if sphere.is_sharp() {
                let rows_of = |k: usize, l: usize| net[k * columns + l];
                rows.extend(sphere.rows_of_sharp_net(rows_of, [polar[0], polar[1]]));
                continue;
            }
            net.chunks_exact(columns).for_each(|row| rows.extend_from_slice(&row[2..columns - 2]));
            rows.extend([polar[0], polar[1]]);
            for pole in [0, 1] {
                // T₁ cos 2π(u − δ) + T₂ sin 2π(u − δ)
                let [a, b] = [0, 1].map(|i| longer * (polar[2 + 2 * pole + i] - polar[pole]));
                rows.extend([a * cosine - b * sine, a * sine + b * cosine].map(|arm| polar[pole] + arm));
            }
        }
        Matrix::from_vec(self.gram.size(), nets.len(), rows)
    }

    fn interpolate_sheet(&self, points: &[f64]) -> Vec<f64> {
        let [count_u, count_v] = self.extent.grid();
        let (around, points, count_u) = match &self.cover {
            None => (&self.lines[0], points.to_vec(), count_u),
            Some(cover) => (cover, self.seam.unfold(points, count_v), 2 * count_u),
        };
        let along_v = self.lines[1].interpolate(Matrix::from_vec(count_v, count_u, points));
        let columns = along_v.nrows();
        let mut turned = vec![0.0; along_v.len()];
        transpose(along_v.as_slice(), columns, &mut turned);
        let along_u = around.interpolate(Matrix::from_vec(count_u, columns, turned));
        let mut rows = vec![0.0; along_u.len()];
        transpose(along_u.as_slice(), along_u.nrows(), &mut rows);
        rows.truncate(self.gram.size());
        rows
    }

    /// Coordinate `c` of the tangents at both poles.
    fn tangents(&self, points: &[f64], given: &Tangents, c: usize) -> [[f64; 2]; 2] {
        let [count_u, count_v] = self.extent.grid();
        let length = handle_length(count_v - 1).recip();
        let harmonic = |l: usize| {
            let sum = |wave: fn(f64) -> f64| -> f64 {
                let turn = |k: usize| std::f64::consts::TAU * k as f64 / count_u as f64;
                (0..count_u).map(|k| points[k * count_v + l] * wave(turn(k))).sum::<f64>() * 2.0
                    / count_u as f64
            };
            [sum(f64::cos), sum(f64::sin)]
        };
        let take = |tangents: [[f64; 3]; 2]| [tangents[0][c], tangents[1][c]];
        let north = given.north.map_or_else(|| harmonic(1).map(|t| t * length), take);
        let south = given.south.map_or_else(|| harmonic(count_v - 2).map(|t| -t * length), take);
        [north, south]
    }

    /// The surface with these `rows` (`N × 3`).
    pub fn surface(&self, rows: &Matrix) -> Surface {
        let ends = [0, 1].map(|i| self.lines[i].generator().beyond());
        let beyond = ends.map(|[before, _]| before);
        let size = [0, 1].map(|i| self.extent.intervals[i] + 1 + ends[i].iter().sum::<usize>());
        let stored: Vec<Vec<f64>> = rows.column_iter().map(|rows| self.grid(rows.as_slice())).collect();
        let places: [Vec<(usize, bool)>; 2] = [0, 1].map(|i| {
            (0..size[i]).map(|k| self.stored(i, k as isize - beyond[i] as isize, beyond[i])).collect()
        });
        let columns = stored[0].len() / places[0].iter().map(|place| place.0 + 1).max().unwrap_or(1);
        let mut control_points = Vec::with_capacity(size[0] * size[1]);
        for &(k, crossed) in &places[0] {
            for &(l, _) in &places[1] {
                let l = if crossed { self.seam.across(l, columns) } else { l };
                control_points.push([0, 1, 2].map(|c| stored[c][k * columns + l]));
            }
        }
        Surface {
            topology: self.extent.topology,
            seam: self.seam,
            lines: self.lines.clone(),
            size,
            control_points,
        }
    }

    /// The rows with an influence at `(u, v)`, with their weights: `σ(u, v) = Σ w_i c_i`. A row may occur several times.
    pub fn weights(&self, u: f64, v: f64) -> Vec<(usize, f64)> {
        let columns = match &self.sphere {
            Some(sphere) => sphere.columns_stored(),
            None => self.gram.size() / self.lines_stored(),
        };
        let [along_u, along_v] = [(0, u), (1, v)].map(|(i, parameter)| {
            let line = &self.lines[i];
            let (half, s) = line.locate(parameter);
            let beyond = line.generator().beyond()[0];
            let (first, weights) = line.weights(half, s, 0);
            let place = move |(k, weight)| {
                let (stored, crossed) = self.stored(i, (first + k) as isize - beyond as isize, beyond);
                (stored, crossed, weight)
            };
            weights.enumerate().map(place).collect::<Vec<_>>()
        });
        let mut weights = Vec::with_capacity(along_u.len() * along_v.len());
        for &(k, crossed, a) in &along_u {
            for &(l, _, b) in &along_v {
                match &self.sphere {
                    Some(sphere) => {
                        weights.extend(
                            sphere.combination(k, l).into_iter().map(|(row, part)| (row, part * a * b)),
                        );
                    }
                    None => {
                        let l = if crossed { self.seam.across(l, columns) } else { l };
                        weights.push((k * columns + l, a * b));
                    }
                }
            }
        }
        weights
    }

    /// The map from rows to the control points `[k][l]` of the tensor product, with those beyond open edges: for spheres the
    /// conditions at the poles, for other topologies the identity. The seam of a twisted torus is not part of it.
    pub fn control_net(&self) -> SparseRows {
        let size = self.gram.size();
        let Some(sphere) = &self.sphere else {
            let mut identity = SparseRows::new(size, size, size);
            (0..size).for_each(|row| identity.push(&[(row as u32, 1.0)]));
            return identity;
        };
        let [count, columns] = [self.extent.intervals[0], sphere.columns_stored()];
        let mut net = SparseRows::new(size, count * columns, 2 * count * columns);
        for k in 0..count {
            for l in 0..columns {
                let parts = sphere.combination(k, l).into_iter();
                net.push(&parts.map(|(row, part)| (row as u32, part)).collect::<Vec<_>>());
            }
        }
        net
    }

    /// Number of stored control points along `u`.
    pub(super) fn lines_stored(&self) -> usize {
        self.extent.control_grid([0, 1].map(|i| self.lines[i].generator().beyond()))[0]
    }

    /// Control points `[k][l]` of one coordinate.
    pub(super) fn grid(&self, rows: &[f64]) -> Vec<f64> {
        self.sphere.as_ref().map_or_else(|| rows.to_vec(), |sphere| sphere.expand(rows))
    }

    /// Stored index of control point `k` of a direction, and whether the seam lies in between.
    fn stored(&self, direction: usize, k: isize, beyond: usize) -> (usize, bool) {
        if !self.extent.topology.closed()[direction] {
            return ((k + beyond as isize) as usize, false);
        }
        let count = self.extent.intervals[direction] as isize;
        (k.rem_euclid(count) as usize, k.div_euclid(count) % 2 != 0)
    }
}
