//! Refinement of surfaces by the two-scale relations of their directions: the same surface on finer knots.
//!
//! ```text
//! c_fine[k', l'] = Σ_{k,l} g_u[k' − m_u k] g_v[l' − m_v l] c[k, l],     σ(u, v) = σ_fine(u + δ_u, v + δ_v)
//! ```
//!
//! Every direction has its own factor `m`, 1 included, and a filter `g` as for curves ([`FineFilter`]). `δ` is half a fine
//! interval where an odd order is split by an even factor, else 0. Only closed directions can be shifted: along open ones and from
//! pole to pole, such a factor leads to B-splines that are shifted themselves, whose knots are those of the line; across a seam
//! that reverses `v` it has no relation. A sphere with smooth poles needs as
//! well that `cos 2πu` stays the same function on both grids, since its tangents at the poles are multiples of it.
//!
//! Source: Schmitter, *Spline Shape Processing*, (6.53)–(6.57), in each direction of (2.3).

use super::Topology;
use super::basis::{Extent, SurfaceBasis};
use super::seam::Seam;
use crate::generator::GeneratorKind;
use crate::generator::refinement::FineFilter;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::kronecker::transpose;

/// Maximum factor of a refinement: the work of its filter grows with the square.
pub const MAX_FACTOR: usize = 1024;

/// Refinement along one direction.
#[derive(Debug, Clone)]
struct Direction {
    factor: usize,
    /// `None` for the factor 1.
    filter: Option<FineFilter>,
    /// The generator on the finer grid.
    kind: GeneratorKind,
    /// Fine intervals by which the refined closed direction starts later.
    turn: isize,
}

impl Direction {
    /// Prepares a direction whose generator belongs to `intervals` intervals; `None` without a two-scale relation.
    fn new(kind: &GeneratorKind, intervals: usize, factor: usize, closed: bool) -> Option<Self> {
        if factor == 1 {
            return Some(Self { factor, filter: None, kind: kind.clone(), turn: 0 });
        }
        let (recipe, built) = (kind.recipe(intervals).ok()?, kind.build(intervals).ok()?);
        let filter = FineFilter::new(&recipe, &built, factor)?;
        if filter.half_step && !closed {
            let kind = kind.two_scale_shifted(factor);
            return Some(Self { factor, filter: Some(filter.for_shifted()), kind, turn: 0 });
        }
        Some(Self { factor, filter: Some(filter), kind: kind.two_scale(factor), turn: 0 })
    }

    fn is_shifted(&self) -> bool {
        self.filter.as_ref().is_some_and(|filter| filter.half_step)
    }

    /// The rows of `x` (`[row][column]`), refined. Open lines have `beyond` control points beyond their ends, before and after
    /// refinement.
    fn rows(&self, x: &[f64], columns: usize, closed: bool, beyond: [[usize; 2]; 2]) -> Vec<f64> {
        let Some(filter) = &self.filter else { return x.to_vec() };
        let [[lead, trail], [own, after]] =
            beyond.map(|ends| ends.map(|count| if closed { 0 } else { count as isize }));
        let coarse = (x.len() / columns) as isize;
        let factor = self.factor as isize;
        let fine =
            if closed { factor * coarse } else { factor * (coarse - 1 - lead - trail) + 1 + own + after };
        let mut refined = vec![0.0; fine as usize * columns];
        for (row, values) in x.chunks_exact(columns).enumerate() {
            let first = factor * (row as isize - lead) + filter.first - self.turn + own;
            for (i, tap) in filter.taps.iter().enumerate() {
                let target = first + i as isize;
                let target = if closed { target.rem_euclid(fine) } else { target };
                if !(0..fine).contains(&target) {
                    continue;
                }
                let sums = &mut refined[target as usize * columns..][..columns];
                sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += tap * value);
            }
        }
        refined
    }
}

/// A refinement of surfaces that changes no point.
#[derive(Debug, Clone)]
pub struct SurfaceRefinement {
    extent: Extent,
    seam: Seam,
    directions: [Direction; 2],
    /// Control points beyond open ends along `u` and `v`, on the coarse and on the fine grid.
    beyond: [[[usize; 2]; 2]; 2],
}

impl SurfaceRefinement {
    /// From surfaces of `basis`, made with the generators `kinds`, to `intervals`; `None` if these are not multiples, or if a
    /// direction has no two-scale relation.
    pub fn new(basis: &SurfaceBasis, kinds: &[GeneratorKind; 2], intervals: [usize; 2]) -> Option<Self> {
        let (extent, seam) = (basis.extent(), basis.seam());
        let factor = |i: usize| {
            let (from, to) = (extent.intervals[i], intervals[i]);
            to.checked_div(from).filter(|factor| (1..=MAX_FACTOR).contains(factor) && factor * from == to)
        };
        let direction = |i: usize| {
            let polar = extent.topology.has_poles() && i == 1;
            let count =
                if polar { kinds[i].meridian_count(extent.intervals[i]) } else { extent.intervals[i] };
            Direction::new(&kinds[i], count, factor(i)?, extent.topology.closed()[i])
        };
        let directions = [direction(0)?, direction(1)?];
        if directions[1].is_shifted() && seam == Seam::Reflected {
            return None;
        }
        if extent.topology == Topology::Sphere && directions[0].factor > 1 && !basis.keeps_tangents() {
            return None;
        }
        let beyond = [0, 1].map(|i| [kinds[i].beyond(), directions[i].kind.beyond()]);
        Some(Self { extent, seam, directions, beyond })
    }

    /// The generators on the finer grid.
    pub fn generators(&self) -> [GeneratorKind; 2] {
        [0, 1].map(|i| self.directions[i].kind.clone())
    }

    /// The shifts `δ_u`, `δ_v` with `σ(u, v) = σ_fine(u + δ_u, v + δ_v)`.
    pub fn shifts(&self) -> [f64; 2] {
        [0, 1].map(|i| {
            let Direction { factor, .. } = self.directions[i];
            let fine = (factor * self.extent.intervals[i]) as f64;
            (if self.directions[i].is_shifted() { 0.5 } else { 0.0 } - self.directions[i].turn as f64) / fine
        })
    }

    /// The same refinement, whose result starts so many fine intervals later along directions that are closed and refined.
    pub(crate) fn turned(mut self, turns: [isize; 2]) -> Self {
        self.directions.iter_mut().zip(turns).for_each(|(direction, turn)| direction.turn += turn);
        self
    }

    /// Rows on the finer grid, of the surface with these `rows` of the basis `from`; `to` is the basis of the finer grid. Cost:
    /// the control points times the lengths of the filters.
    pub fn apply(&self, from: &SurfaceBasis, to: &SurfaceBasis, rows: &Matrix) -> Matrix {
        let closed = self.extent.topology.closed();
        let nets: Vec<Vec<f64>> = rows
            .column_iter()
            .map(|column| {
                let net = from.grid(column.as_slice());
                let columns = net.len() / from.lines_stored();
                let mut turned = vec![0.0; net.len()];
                transpose(&net, columns, &mut turned);
                let along_v =
                    self.directions[1].rows(&turned, turned.len() / columns, closed[1], self.beyond[1]);
                let count = from.lines_stored();
                let columns = along_v.len() / count;
                let mut net = vec![0.0; along_v.len()];
                transpose(&along_v, count, &mut net);
                if !self.seam.is_straight() {
                    net = self.seam.unfold(&net, columns);
                }
                let mut net = self.directions[0].rows(&net, columns, closed[0], self.beyond[0]);
                net.truncate(to.lines_stored() * columns);
                net
            })
            .collect();
        to.rows_of_net(&nets, &from.poles_of(rows), self.extent.intervals[1], self.shifts()[0])
    }
}
