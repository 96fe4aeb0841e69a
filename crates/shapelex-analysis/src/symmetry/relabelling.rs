//! Relabelling of control points: which one is the image of which.

use super::error::SymmetryError;
use crate::correspondence::Correspondence;
use shapelex_geometry::representation::ShapeSpace;

/// Relative change of the metric below which a relabelling keeps it.
const ISOMETRY: f64 = 1e-9;

/// An involution `Π` of control points that keeps the metric.
#[derive(Debug, Clone)]
pub struct Relabelling<'a> {
    space: &'a ShapeSpace,
    pairs: &'a [[usize; 2]],
}

impl<'a> Relabelling<'a> {
    /// The relabelling of shapes of `space`: of landmarks and control meshes by `pairs` of points, all others stay; of curves and
    /// surfaces by a reversed first parameter, `u → −u` along closed directions and `u → 1 − u` along open ones.
    ///
    /// # Errors
    /// Pairs that do not fit; a relabelling that changes the metric.
    pub fn new(space: &'a ShapeSpace, pairs: &'a [[usize; 2]]) -> Result<Self, SymmetryError> {
        let size = space.representation().size();
        let mut seen = vec![false; size];
        for (position, &pair) in pairs.iter().enumerate() {
            for k in pair {
                match seen.get_mut(k) {
                    Some(seen) if !*seen => *seen = true,
                    _ => return Err(SymmetryError::Pair { position, pair, size }),
                }
            }
        }
        let found = Self { space, pairs };
        let reverses = {
            let plain = Self { space, pairs: &[] };
            plain.applied(&numbers(size)) != numbers(size)
        };
        match (reverses, pairs.is_empty()) {
            (true, false) => return Err(SymmetryError::PairsOfCurve { found: pairs.len() }),
            (false, true) => return Err(SymmetryError::NoPairs),
            _ => {}
        }
        if found.is_isometry() { Ok(found) } else { Err(SymmetryError::NotAnIsometry) }
    }

    fn applied(&self, column: &[f64]) -> Vec<f64> {
        let mut moved = column.to_vec();
        self.relabel(&mut moved);
        moved
    }

    fn is_isometry(&self) -> bool {
        let size = self.space.representation().size();
        let probe: Vec<f64> = (0..size).map(|k| (0.7 * k as f64 + 0.3).sin()).collect();
        let gram = self.space.gram();
        let (mut one, mut other) = (self.applied(&probe), probe);
        gram.apply(&mut one);
        gram.apply(&mut other);
        let other = self.applied(&other);
        let largest = other.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        one.iter().zip(&other).all(|(a, b)| (a - b).abs() <= ISOMETRY * largest)
    }

    /// `Π c` of one coordinate of the control points.
    pub fn relabel(&self, column: &mut [f64]) {
        self.space.reverse(column);
        self.pairs.iter().for_each(|&[a, b]| column.swap(a, b));
    }

    /// Image of a shape (`d·N` coordinate-major control points): relabelled, and reflected along the first coordinate.
    pub fn image(&self, shape: &mut [f64]) {
        for (c, column) in shape.chunks_exact_mut(self.space.representation().size()).enumerate() {
            self.relabel(column);
            if c == 0 {
                column.iter_mut().for_each(|x| *x = -*x);
            }
        }
    }

    /// Number of control points that stay; `None` where the relabelling does more than move them.
    pub fn fixed(&self) -> Option<usize> {
        let own = numbers(self.space.representation().size());
        let moved = self.applied(&own);
        let mut sorted = moved.clone();
        sorted.sort_by(f64::total_cmp);
        (sorted == own).then(|| moved.iter().zip(&own).filter(|(a, b)| a == b).count())
    }
}

fn numbers(size: usize) -> Vec<f64> {
    (0..size).map(|k| k as f64).collect()
}

/// Mirror image of a shape of the other side (`d·N` coordinate-major control points): reflected along the first coordinate, and
/// traversed backwards where a reflection turns the direction of a contour, or a surface inside out.
pub fn mirrored(space: &ShapeSpace, correspondence: Correspondence, shape: &mut [f64]) {
    let representation = space.representation();
    let is_contour = representation.is_closed() && representation.dimension() == 2;
    let turns = is_contour && correspondence != Correspondence::Landmarks || space.domain().is_sheet();
    for (c, column) in shape.chunks_exact_mut(representation.size()).enumerate() {
        if turns {
            space.reverse(column);
        }
        if c == 0 {
            column.iter_mut().for_each(|x| *x = -*x);
        }
    }
}
