//! Distances between shapes modulo a class.
//!
//! ```text
//! projection, any class      d(S₁,S₂)² = 1 − tr(P₁P₂)/I                      the chordal distance, in [0, 1]
//! Procrustes, similarity     d² = 1 − ρ²,  ρ = max_R tr(RᵀH)/(‖x‖‖y‖)        the full Procrustes distance, in [0, 1]
//! partial, similarity        d² = 2 − 2ρ                                     the partial Procrustes distance, in [0, 2]
//! rigid, translation         d² = ‖x‖² + ‖y‖² − 2 max_R tr(RᵀH)              the size-and-shape distance, a length
//! ```
//!
//! `I` is the dimension of the subspaces, `H = Σ_n x[n] y[n]ᵀ`, and `R` a rotation without reflection (the identity for
//! translations). Shapes are whitened, and centred when the class translates. In the plane the chordal distance of
//! `similarity` is the full Procrustes distance. If start points, directions or mirror images are searched, the distance is
//! the minimum over all of them; the search is exhaustive.
//!
//! Every distance is computed from a few inner products `p` of a pair: with `P = QQᵀ`, `tr(P₁P₂) = ‖Q₁ᵀQ₂‖²`, a sum of
//! squares. Without a search of start points the products come from one matrix product of stacked bases. With it, spectra are
//! kept, and one inverse FFT per product gives all `N` start points at once. In the plane, with `z = x + iy`, similarities need
//! one complex FFT per pair, for `z₁* z₂`, and affine classes two: the squares of their four products have the sum
//! `½ (|z₁* z₂|² + |z₁ᵀ z₂|²)`.
//!
//! Accuracy: squared distances from products are exact to some `10⁻¹⁵`, hence distances `d` to `10⁻¹⁵/d` (of the sizes, for
//! lengths). Those below `10⁻⁴` are computed again, from the remainder of one shape after the other (`close.rs`): they are exact
//! to some `10⁻¹⁵`, and zero below `7·10⁻¹⁵`. Columns have unit norm, so that sizes between `10⁻¹⁰⁰` and `10¹⁰⁰` are all alike.
//!
//! Source: Edelman, Arias and Smith 1998 (chordal distance on the Grassmannian); Dryden and Mardia 1998, chapters 4 and 5.

mod best;
mod close;
mod matrix;
mod prepared;
mod products;
mod spectra;

use rayon::prelude::*;

pub use self::prepared::PreparedShapes;
use self::products::{
    Score, Term, class_products, complex_products, each_with_each, fit_products, is_mirrored_into_itself,
};
use self::spectra::{Transform, Work};
use super::AnalysisError;
use super::alignment::Method;
use super::fit::Scaling;
use super::magnitudes::{Magnitudes, Signals};
use super::matching::{Matching, Placement};
use shapelex_numeric::fft::ComplexFft;

/// Maximum number of shapes per side of a tile of the matrix: two tiles of spectra fit in the cache.
const TILE: usize = 32;

/// Minimum number of bounds per task.
const BOUNDS: usize = 4096;

/// Conversion of a score into a distance.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Scale {
    /// For bases, or full Procrustes fits; holds the largest possible score.
    Unit(f64),
    /// For shapes that keep their sizes or have unit size.
    Sizes,
}

/// Prepares and compares the shapes of one representation under one class and one search.
#[derive(Debug, Clone)]
pub struct DistanceSpace {
    method: Method,
    matching: Matching,
    /// `None` if start points are not searched.
    transform: Option<Transform>,
    /// `N`.
    size: usize,
    /// Number of columns, of `N` numbers each, that represent a shape.
    columns: usize,
    products: Vec<Vec<Term>>,
    score: Score,
    scale: Scale,
    /// Signals whose magnitudes bound the score; `None` if there are no such bounds.
    bounded: Option<Signals>,
}

/// Distance between two shapes, with the placement of the second that attains it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// The distance.
    pub distance: f64,
    /// Placement of the second shape on the first.
    pub placement: Placement,
}

impl DistanceSpace {
    /// For shapes compared by `method`, with the search of `matching`.
    ///
    /// # Errors
    /// [`AnalysisError::NotAProperClass`] if mirror images are searched and the mirror image of the class is a different class:
    /// the distance would not be symmetric. [`AnalysisError::Parameter`] for surfaces whose parameters move.
    pub fn new(method: &Method, matching: &Matching) -> Result<Self, AnalysisError> {
        let d = matching.dimension();
        if matching.moves() {
            let detail = "expected the correspondence \"landmarks\" for surfaces, got \"cyclic\": their parameters are \
                          matched to a mean, not to each other";
            return Err(AnalysisError::Parameter { field: "", detail: detail.into() });
        }
        if let Method::Projection(class) = method
            && matching.mirrors()
            && !is_mirrored_into_itself(class)
        {
            return Err(AnalysisError::NotAProperClass(
                "mirror images of matrices of the class do not belong to it, so distances modulo both are not \
                 symmetric: use \"mirror\": \"forbid\""
                    .into(),
            ));
        }
        let (columns, products, score, scale) = match method {
            Method::Projection(class) => {
                let (columns, products, largest) = class_products(class);
                (columns, products, Score::Squares, Scale::Unit(largest))
            }
            Method::Procrustes(fit) => {
                let (products, score) = fit_products(*fit);
                (
                    d,
                    products,
                    score,
                    if fit.scaling == Scaling::Full { Scale::Unit(1.0) } else { Scale::Sizes },
                )
            }
        };
        let transform = matching.fft().map(|fft| match score {
            Score::Squares if products == complex_products() => {
                Transform::Complex(ComplexFft::new(fft.len()))
            }
            Score::Squares if products == each_with_each(2) => {
                Transform::ComplexPair(ComplexFft::new(fft.len()))
            }
            _ => Transform::Real(fft.clone()),
        });
        let bounded = match (&transform, score) {
            (Some(Transform::Complex(_)), _) => Some(Signals::Complex),
            (Some(Transform::Real(_)), Score::Single) => Some(Signals::Real),
            _ => None,
        };
        let (method, matching, size) = (method.clone(), matching.clone(), matching.size());
        Ok(Self { method, matching, transform, size, columns, products, score, scale, bounded })
    }

    /// Approximate number of multiply-adds per pair.
    pub fn operations(&self) -> f64 {
        let (n, products) = (self.size as f64, self.products.len() as f64);
        let of_placement = match &self.transform {
            Some(transform) => {
                let terms: usize = self.products.iter().map(Vec::len).sum();
                transform.operations(terms as f64, products) + self.rotation_operations() * n
            }
            None => n * (self.columns as f64).powi(2) + products + self.rotation_operations(),
        };
        of_placement * self.matching.candidates().len() as f64
    }

    /// Approximate number of multiply-adds per pair in a search for neighbours. Where the space has lower bounds, most pairs
    /// are excluded by them; how many depends on the shapes.
    pub fn search_operations(&self) -> f64 {
        /// Share of the pairs that are compared although there are bounds.
        const COMPARED: f64 = 0.2;
        match self.bounded {
            Some(_) => self.size as f64 + COMPARED * self.operations(),
            None => self.operations(),
        }
    }

    fn rotation_operations(&self) -> f64 {
        /// Cost of a `3 × 3` singular value decomposition.
        const DECOMPOSITION: f64 = 1000.0;
        if self.score == Score::Rotation { DECOMPOSITION } else { 0.0 }
    }

    /// Size of one prepared shape in bytes.
    pub fn bytes(&self) -> usize {
        let of_columns = match &self.transform {
            Some(transform) => 16 * transform.spectrum_len(self.columns),
            None => 8 * self.size * self.columns,
        };
        let of_bounds = self.bounded.map_or(0, |signals| Magnitudes::bytes(signals, self.size, self.columns));
        8 + (of_columns + of_bounds) * self.matching.candidates().len()
    }

    /// Approximate number of multiply-adds of the matrix of `count` shapes.
    pub fn matrix_operations(&self, count: usize) -> f64 {
        self.operations() * (count as f64).powi(2) / 2.0
    }

    /// Distances of shape `i` of `shapes` to all of `others`, in order.
    ///
    /// Cost: the products of all pairs. The bits of a distance do not depend on the other shapes.
    pub fn compare(&self, shapes: &PreparedShapes, i: usize, others: &PreparedShapes) -> Vec<Match> {
        let others_in_order: Vec<usize> = (0..others.count()).collect();
        self.compare_some(shapes, i, others, &others_in_order)
    }

    /// Distances of shape `i` of `shapes` to the shapes of `others` at these positions.
    pub(crate) fn compare_some(
        &self,
        shapes: &PreparedShapes,
        i: usize,
        others: &PreparedShapes,
        positions: &[usize],
    ) -> Vec<Match> {
        let compare = |work: &mut Work, &j: &usize| {
            let best = self.best(shapes, i, others, j, work);
            let (a, b) = (shapes.sizes[i], others.sizes[j]);
            let distance = self.distance(best.score, a, b);
            if self.is_close(distance, a, b) {
                return self.closer(shapes, i, others, j, work);
            }
            Match { distance, placement: best.placement }
        };
        positions.par_iter().with_min_len(TILE).map_init(|| self.work(), compare).collect()
    }

    /// Lower bounds of the distances of shape `i` of `shapes` to all of `others`, in order; `None` if the space has none.
    ///
    /// Cost: `N` multiply-adds per pair.
    pub(crate) fn lower_bounds(
        &self,
        shapes: &PreparedShapes,
        i: usize,
        others: &PreparedShapes,
    ) -> Option<Vec<f64>> {
        let own = shapes.magnitudes.first()?;
        let bound = |j: usize| {
            let cosine = others.magnitudes.iter().map(|laid| own.product(i, laid, j)).fold(0.0, f64::max);
            let score = if self.score == Score::Squares { cosine * cosine } else { cosine };
            self.distance(score, shapes.sizes[i], others.sizes[j])
        };
        Some((0..others.count()).into_par_iter().with_min_len(BOUNDS).map(bound).collect())
    }

    /// Distance of two shapes of the sizes `first` and `second`, from the score of their columns.
    fn distance(&self, score: f64, first: f64, second: f64) -> f64 {
        let chord = |cosine: f64| (first - second).powi(2) + 2.0 * first * second * (1.0 - cosine);
        let squared = match (self.score, self.scale) {
            (Score::Squares, Scale::Unit(largest)) => 1.0 - score / largest,
            (_, Scale::Unit(_)) => (1.0 - score) * (1.0 + score),
            (Score::Squares, Scale::Sizes) => chord(score.sqrt()),
            (_, Scale::Sizes) => chord(score),
        };
        squared.max(0.0).sqrt()
    }
}

/// Piece `k` of a list divided into pieces of `length`.
fn chunk<T>(all: &[T], k: usize, length: usize) -> &[T] {
    &all[k * length..(k + 1) * length]
}
