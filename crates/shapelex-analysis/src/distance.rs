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
//! Accuracy: squared distances are exact to some `10⁻¹⁵` (of `‖x‖² + ‖y‖²`), hence distances `d` to `10⁻¹⁵/d`. The distance
//! of two shapes of one class is up to some `3·10⁻⁸` rather than zero.
//!
//! Source: Edelman, Arias and Smith 1998 (chordal distance on the Grassmannian); Dryden and Mardia 1998, chapters 4 and 5.

use rayon::prelude::*;
use realfft::num_complex::Complex64;

use super::AnalysisError;
use super::accumulate;
use super::alignment::Method;
use super::fit::{Fit, Scaling, best_correlation};
use super::magnitudes::{Magnitudes, Signals};
use super::matching::{Matching, Placement};
use super::metric::{Metric, dot, norm};
use super::subspace::Subspace;
use super::transformation::{Structure, TransformationClass};
use shapelex_numeric::dense::{Matrix, transpose_multiply_columns};
use shapelex_numeric::fft::{ComplexFft, FftScratch, RealFft};
use shapelex_numeric::kernels::{
    add_squared_norms, largest, multiply_conjugates, multiply_mirrored, squared_norms,
};
use shapelex_numeric::parallel;

/// Maximum number of shapes per side of a tile of the matrix: two tiles of spectra fit in the cache.
const TILE: usize = 32;

/// Minimum number of bounds per task.
const BOUNDS: usize = 4096;

/// Approximate number of columns per side of a matrix product: enough for its kernels, few enough for the cache.
const TILE_COLUMNS: usize = 256;

/// Relative difference below which the scores of two placements are equal; the first placement wins.
const TIE: f64 = 1e-12;

/// `2^{−1/4}`: with this factor on both shapes, sums of squares are halved.
const HALF_ROOT: f64 = 0.840_896_415_253_714_5;

/// Relative distance from the span of a class above which a matrix does not belong to the class.
const IN_SPAN: f64 = 1e-9;

/// A signed inner product of a column of the first shape with one of the second.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Term {
    left: usize,
    right: usize,
    sign: f64,
}

/// Score of a pair, formed from its products. A larger score means a smaller distance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Score {
    /// `Σ p²`.
    Squares,
    /// The single product itself.
    Single,
    /// `max tr(RᵀH)` of the `3 × 3` products.
    Rotation,
}

/// The inverse transforms that give the products of a pair at all start points.
#[derive(Debug, Clone)]
enum Transform {
    /// One real inverse transform for each product.
    Real(RealFft),
    /// One complex inverse transform for `z₁* z₂`, whose parts are the two products.
    Complex(ComplexFft),
    /// Two complex inverse transforms, for `z₁* z₂` and `z₁ᵀ z₂`: their parts are sums and differences of the products of both
    /// columns with both.
    ComplexPair(ComplexFft),
}

impl Transform {
    /// Length of the spectra of a shape of so many columns.
    fn spectrum_len(&self, columns: usize) -> usize {
        match self {
            Self::Real(fft) => columns * fft.spectrum_len(),
            Self::Complex(fft) | Self::ComplexPair(fft) => fft.len(),
        }
    }

    /// Multiply-adds of the transforms of `products` products of a pair, from `terms` products of spectra.
    fn operations(&self, terms: f64, products: f64) -> f64 {
        /// Cost of the complex transform, in real ones.
        const COMPLEX: f64 = 1.4;
        let operations = |n: usize, terms: f64, transforms: f64| {
            let n = n as f64;
            2.0 * n * (terms + transforms * (2.0 + n.log2()))
        };
        match self {
            Self::Real(fft) => operations(fft.len(), terms, products),
            Self::Complex(fft) => operations(fft.len(), 2.0, COMPLEX),
            Self::ComplexPair(fft) => operations(fft.len(), 4.0, 2.0 * COMPLEX),
        }
    }
}

/// Conversion of a score into a distance.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Scale {
    /// For bases, or shapes of unit norm; holds the largest possible score.
    Unit(f64),
    /// For shapes that keep their sizes.
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

/// Shapes prepared for comparison: orthonormal bases or points, as signals or as spectra, one set per candidate placement.
#[derive(Debug, Clone)]
pub struct PreparedShapes {
    /// `‖x‖²`.
    squared_norms: Vec<f64>,
    /// One entry per candidate placement (without start point); the first is the shape as given.
    laid: Vec<Columns>,
    /// For every candidate placement, if the space has bounds; else empty.
    magnitudes: Vec<Magnitudes>,
}

#[derive(Debug, Clone)]
enum Columns {
    Signals(Vec<f64>),
    Spectra(Vec<Complex64>),
}

/// Distance between two shapes, with the placement of the second that attains it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// The distance.
    pub distance: f64,
    /// Placement of the second shape on the first.
    pub placement: Placement,
}

/// The best score of a pair, and a placement that attains it.
#[derive(Debug, Clone, Copy)]
struct Best {
    score: f64,
    placed_score: f64,
    placement: Placement,
}

impl Best {
    const NONE: Self = Self {
        score: f64::NEG_INFINITY,
        placed_score: f64::NEG_INFINITY,
        placement: Placement { shift: 0, reversed: false, mirrored: false },
    };

    /// Keeps the largest score. The placement changes only if the improvement exceeds rounding.
    fn offer(&mut self, score: f64, placement: Placement) {
        self.score = self.score.max(score);
        if score > self.placed_score + TIE * self.placed_score.abs() || self.placed_score == f64::NEG_INFINITY
        {
            (self.placed_score, self.placement) = (score, placement);
        }
    }
}

/// Scratch memory for the products of one pair.
struct Work {
    scratch: Scratch,
    spectrum: Vec<Complex64>,
    correlation: Vec<f64>,
    scores: Vec<f64>,
    /// All products of all start points, for [`Score::Rotation`].
    products: Vec<f64>,
}

enum Scratch {
    None,
    Real(FftScratch),
    Complex(Vec<Complex64>),
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

    /// Prepares shapes of these control points, `d·N` coordinate-major numbers each.
    ///
    /// # Errors
    /// As for [`Self::prepare`].
    pub fn prepare_given(
        &self,
        metric: &Metric,
        mut control_points: Vec<f64>,
    ) -> Result<PreparedShapes, AnalysisError> {
        accumulate::prepare(metric, self.method.translates(), 0, &mut control_points)?;
        self.prepare(&control_points)
    }

    /// Prepares whitened shapes, `d·N` numbers each, centred when the class translates.
    ///
    /// Cost `O(dN I²)` per shape and placement; with a search of start points also one FFT per column.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] or [`AnalysisError::NoExtent`] with the position of the first such shape.
    pub fn prepare(&self, whitened: &[f64]) -> Result<PreparedShapes, AnalysisError> {
        let length = self.size * self.matching.dimension();
        let candidates = self.matching.candidates();
        let columns = parallel::try_map(whitened.len() / length, &|i| {
            let x = chunk(whitened, i, length);
            let laid = candidates.iter().map(|&laid| self.columns_of(&self.matching.place(x, laid)));
            laid.collect::<Result<Vec<Vec<f64>>, _>>().map_err(|error| error.at(i))
        })?;
        let mut signals = vec![Vec::with_capacity(self.columns * whitened.len()); candidates.len()];
        for shape in columns {
            signals.iter_mut().zip(shape).for_each(|(all, one)| all.extend(one));
        }
        let laid = signals.into_iter().map(|signals| match &self.transform {
            Some(Transform::Real(fft)) => Columns::Spectra(spectra(fft, &signals)),
            Some(Transform::Complex(fft)) => Columns::Spectra(complex_spectra(fft, 1.0, &signals)),
            Some(Transform::ComplexPair(fft)) => Columns::Spectra(complex_spectra(fft, HALF_ROOT, &signals)),
            None => Columns::Signals(signals),
        });
        let laid: Vec<Columns> = laid.collect();
        let has_unit_size =
            matches!(&self.method, Method::Procrustes(fit) if fit.scaling == Scaling::Partial);
        let square = |x: &[f64]| if has_unit_size { 1.0 } else { dot(x, x) };
        let squared_norms: Vec<f64> = whitened.chunks_exact(length).map(square).collect();
        let norms: Vec<f64> = match self.scale {
            Scale::Unit(_) => vec![1.0; squared_norms.len()],
            Scale::Sizes => squared_norms.iter().map(|square| square.sqrt()).collect(),
        };
        let magnitudes = |laid: &Columns| match (laid, self.bounded) {
            (Columns::Spectra(spectra), Some(signals)) => {
                Some(Magnitudes::new(signals, self.size, self.columns, spectra, &norms))
            }
            _ => None,
        };
        let magnitudes = laid.iter().filter_map(magnitudes).collect();
        Ok(PreparedShapes { squared_norms, laid, magnitudes })
    }

    /// The columns that represent the whitened shape `x`.
    fn columns_of(&self, x: &[f64]) -> Result<Vec<f64>, AnalysisError> {
        match &self.method {
            Method::Projection(class) => {
                let blocks = Subspace::new(class, x)?.blocks;
                Ok(blocks.iter().flat_map(|block| block.q.iter().copied()).collect())
            }
            Method::Procrustes(fit) => {
                super::subspace::check_extent(norm(x), norm(x))?;
                let factor = if fit.scaling == Scaling::None { 1.0 } else { norm(x).recip() };
                Ok(x.iter().map(|value| factor * value).collect())
            }
        }
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
            let distance = self.distance(best.score, shapes.squared_norms[i], others.squared_norms[j]);
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
            let (a, b) = (shapes.squared_norms[i], others.squared_norms[j]);
            let product = if self.scale == Scale::Sizes { cosine * a.sqrt() * b.sqrt() } else { cosine };
            let score = if self.score == Score::Squares { product * product } else { product };
            self.distance(score, a, b)
        };
        Some((0..others.count()).into_par_iter().with_min_len(BOUNDS).map(bound).collect())
    }

    /// The symmetric matrix of all distances, row by row: `K²` numbers with zeros on the diagonal.
    ///
    /// `go_on` receives the fraction that is done and returns whether to continue; it is called between tiles, from any thread.
    /// Each pair is computed once, in tiles that do not depend on the number of threads, and neither do the bits.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`] once `go_on` returns false.
    pub fn matrix(
        &self,
        shapes: &PreparedShapes,
        go_on: &(dyn Fn(f64) -> bool + Sync),
    ) -> Result<Vec<f64>, AnalysisError> {
        let count = shapes.count();
        let mut matrix = vec![0.0; count * count];
        let tile = self.tile();
        let (done, tiles) = (std::sync::atomic::AtomicUsize::new(0), count.div_ceil(tile));
        let all = (tiles * (tiles + 1) / 2).max(1);
        matrix.par_chunks_mut(tile * count.max(1)).enumerate().try_for_each_init(
            || self.work(),
            |work, (band, rows)| {
                for column in band..tiles {
                    let before = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                    if !go_on(before as f64 / all as f64) {
                        return Err(AnalysisError::Interrupted);
                    }
                    let side = |k: usize| k * tile..((k + 1) * tile).min(count);
                    self.fill_tile(shapes, side(band), side(column), rows, work);
                }
                Ok(())
            },
        )?;
        mirror_upper(&mut matrix, count);
        Ok(matrix)
    }

    fn tile(&self) -> usize {
        match self.transform {
            Some(_) => TILE,
            None => (TILE_COLUMNS / self.columns).max(1),
        }
    }

    /// Writes the distances of one tile above the diagonal into the `rows` of its band.
    fn fill_tile(
        &self,
        shapes: &PreparedShapes,
        left: std::ops::Range<usize>,
        right: std::ops::Range<usize>,
        rows: &mut [f64],
        work: &mut Work,
    ) {
        let (count, norms) = (shapes.count(), &shapes.squared_norms);
        let products = shapes.laid.iter().map(|laid| match (&shapes.laid[0], laid) {
            (Columns::Signals(first), Columns::Signals(second)) => {
                let length = self.size * self.columns;
                let side = |all: &[f64], range: &std::ops::Range<usize>| {
                    all[range.start * length..range.end * length].to_vec()
                };
                let first = Matrix::from_vec(self.size, self.columns * left.len(), side(first, &left));
                Some(transpose_multiply_columns(&first, &side(second, &right)))
            }
            _ => None,
        });
        let products: Option<Vec<Matrix>> = products.collect();
        for i in left.clone() {
            for j in right.clone().filter(|&j| j > i) {
                let score = match &products {
                    Some(products) => {
                        let of = |product| self.score_in(product, i - left.start, j - right.start);
                        products.iter().map(of).fold(f64::NEG_INFINITY, f64::max)
                    }
                    None => self.largest_score(shapes, i, j, work),
                };
                rows[(i - left.start) * count + j] = self.distance(score, norms[i], norms[j]);
            }
        }
    }

    /// The score of shapes `i` and `j` of two tiles, from the products of all their columns.
    fn score_in(&self, products: &Matrix, i: usize, j: usize) -> f64 {
        let (row, column) = (i * self.columns, j * self.columns);
        let product = |terms: &Vec<Term>| -> f64 {
            terms.iter().map(|t| t.sign * products[(row + t.left, column + t.right)]).sum()
        };
        self.score_of(self.products.iter().map(product))
    }

    fn score_of(&self, mut products: impl Iterator<Item = f64>) -> f64 {
        match self.score {
            Score::Squares => products.map(|p| p * p).sum(),
            Score::Single => products.next().unwrap_or_default(),
            Score::Rotation => rotation_score(&products.collect::<Vec<f64>>()),
        }
    }

    /// The largest score of shapes `i` and `j` over all candidates, by FFT.
    fn largest_score(&self, shapes: &PreparedShapes, i: usize, j: usize, work: &mut Work) -> f64 {
        let score = |laid: &Columns| {
            self.scores(shapes, i, laid, j, work);
            largest(&work.scores)
        };
        shapes.laid.iter().map(score).fold(f64::NEG_INFINITY, f64::max)
    }

    /// The best score of shape `i` of `shapes` and shape `j` of `others`, with its placement.
    fn best(
        &self,
        shapes: &PreparedShapes,
        i: usize,
        others: &PreparedShapes,
        j: usize,
        work: &mut Work,
    ) -> Best {
        let mut best = Best::NONE;
        for (&candidate, laid) in self.matching.candidates().iter().zip(&others.laid) {
            self.scores(shapes, i, laid, j, work);
            for (shift, &score) in work.scores.iter().enumerate() {
                best.offer(score, Placement { shift: shift as u32, ..candidate });
            }
        }
        best
    }

    /// Fills `work.scores`: one score per start point of shape `j` in `laid`, or a single one if start points are not searched.
    fn scores(&self, shapes: &PreparedShapes, i: usize, laid: &Columns, j: usize, work: &mut Work) {
        match (&shapes.laid[0], laid, &self.transform) {
            (Columns::Spectra(first), Columns::Spectra(second), Some(transform)) => {
                let length = transform.spectrum_len(self.columns);
                let (first, second) = (chunk(first, i, length), chunk(second, j, length));
                match transform {
                    Transform::Real(fft) => self.scores_of_spectra(fft, first, second, work),
                    Transform::Complex(fft) => scores_of_complex_spectra(fft, first, second, work),
                    Transform::ComplexPair(fft) => scores_of_complex_pair(fft, first, second, work),
                }
            }
            (Columns::Signals(first), Columns::Signals(second), _) => {
                let length = self.size * self.columns;
                let (first, second) = (chunk(first, i, length), chunk(second, j, length));
                let product = |terms: &Vec<Term>| {
                    let column = |all, k| chunk(all, k, self.size);
                    let inner = |t: &Term| t.sign * dot(column(first, t.left), column(second, t.right));
                    terms.iter().map(inner).sum::<f64>()
                };
                work.scores[0] = self.score_of(self.products.iter().map(product));
            }
            _ => unreachable!("all shapes of a space are prepared alike"),
        }
    }

    /// `p(s) = F⁻¹ Σ ± conj(x̂) ŷ`: the products for every start point `s` of the second shape.
    fn scores_of_spectra(&self, fft: &RealFft, first: &[Complex64], second: &[Complex64], work: &mut Work) {
        let (n, length) = (fft.len(), fft.spectrum_len());
        let Work { scratch, spectrum, correlation, scores, products } = work;
        let Scratch::Real(scratch) = scratch else { unreachable!("all work of a space is of one kind") };
        for (k, terms) in self.products.iter().enumerate() {
            for (position, term) in terms.iter().enumerate() {
                let (left, right) = (chunk(first, term.left, length), chunk(second, term.right, length));
                // The first term of a product is not negative.
                if position == 0 {
                    multiply_conjugates(spectrum, left, right);
                    continue;
                }
                let add = |(sum, (x, y)): (&mut Complex64, (&Complex64, &Complex64))| {
                    *sum += term.sign * (x.conj() * y);
                };
                spectrum.iter_mut().zip(left.iter().zip(right)).for_each(add);
            }
            fft.inverse(spectrum, correlation, scratch);
            match self.score {
                Score::Squares if k == 0 => {
                    scores.iter_mut().zip(&*correlation).for_each(|(score, p)| *score = p * p);
                }
                Score::Squares => {
                    scores.iter_mut().zip(&*correlation).for_each(|(score, p)| *score += p * p);
                }
                Score::Single => scores.copy_from_slice(correlation),
                Score::Rotation => products[k * n..(k + 1) * n].copy_from_slice(correlation),
            }
        }
        if self.score == Score::Rotation {
            rotation_scores(products, scores);
        }
    }

    fn distance(&self, score: f64, first: f64, second: f64) -> f64 {
        let squared = match (self.score, self.scale) {
            (Score::Squares, Scale::Unit(largest)) => 1.0 - score / largest,
            (_, Scale::Unit(_)) => (1.0 - score) * (1.0 + score),
            (Score::Squares, Scale::Sizes) => first + second - 2.0 * score.sqrt(),
            (_, Scale::Sizes) => first + second - 2.0 * score,
        };
        squared.max(0.0).sqrt()
    }

    fn work(&self) -> Work {
        let (n, all) = match (&self.transform, self.score) {
            (None, _) => (1, 0),
            (Some(_), Score::Rotation) => (self.size, self.products.len()),
            (Some(_), _) => (self.size, 0),
        };
        let (scratch, spectrum) = match &self.transform {
            None => (Scratch::None, 0),
            Some(Transform::Real(fft)) => (Scratch::Real(fft.scratch()), fft.spectrum_len()),
            Some(Transform::Complex(fft)) => (Scratch::Complex(fft.scratch()), n),
            Some(Transform::ComplexPair(fft)) => (Scratch::Complex(fft.scratch()), 2 * n),
        };
        Work {
            scratch,
            spectrum: vec![Complex64::ZERO; spectrum],
            correlation: vec![0.0; n],
            scores: vec![0.0; n],
            products: vec![0.0; all * n],
        }
    }
}

/// `|p(s)|²` with `p(s) = F⁻¹ conj(ẑ₁) ẑ₂`, for every start point `s` of the second shape.
fn scores_of_complex_spectra(fft: &ComplexFft, first: &[Complex64], second: &[Complex64], work: &mut Work) {
    let Scratch::Complex(scratch) = &mut work.scratch else {
        unreachable!("all work of a space is of one kind")
    };
    multiply_conjugates(&mut work.spectrum, first, second);
    fft.inverse(&mut work.spectrum, scratch);
    squared_norms(&mut work.scores, &work.spectrum);
}

/// `|p(s)|² + |q(s)|²` with `p(s)` as above and `q(s)` the same of `z₁*` instead of `z₁`, for every start point `s`.
fn scores_of_complex_pair(fft: &ComplexFft, first: &[Complex64], second: &[Complex64], work: &mut Work) {
    let Scratch::Complex(scratch) = &mut work.scratch else {
        unreachable!("all work of a space is of one kind")
    };
    let (conjugated, plain) = work.spectrum.split_at_mut(fft.len());
    multiply_conjugates(conjugated, first, second);
    multiply_mirrored(plain, first, second);
    fft.inverse(&mut work.spectrum, scratch);
    let (conjugated, plain) = work.spectrum.split_at(fft.len());
    squared_norms(&mut work.scores, conjugated);
    add_squared_norms(&mut work.scores, plain);
}

impl PreparedShapes {
    /// Number of prepared shapes.
    pub fn count(&self) -> usize {
        self.squared_norms.len()
    }

    /// Reserves memory for further shapes.
    pub fn reserve(&mut self, shapes: usize) {
        let count = self.count().max(1);
        self.squared_norms.reserve_exact(shapes);
        for laid in &mut self.laid {
            match laid {
                Columns::Signals(all) => all.reserve_exact(all.len() / count * shapes),
                Columns::Spectra(all) => all.reserve_exact(all.len() / count * shapes),
            }
        }
        self.magnitudes.iter_mut().for_each(|all| all.reserve(shapes));
    }

    /// Appends the shapes of `more`, prepared by the same space.
    pub fn append(&mut self, more: Self) {
        self.squared_norms.extend(more.squared_norms);
        self.magnitudes.iter_mut().zip(more.magnitudes).for_each(|(all, more)| all.append(more));
        for (laid, more) in self.laid.iter_mut().zip(more.laid) {
            match (laid, more) {
                (Columns::Signals(all), Columns::Signals(more)) => all.extend(more),
                (Columns::Spectra(all), Columns::Spectra(more)) => all.extend(more),
                _ => unreachable!("all shapes of a space are prepared alike"),
            }
        }
    }
}

/// Number of columns of a class, the products whose squares sum to `tr(P₁P₂)` up to a factor, and the largest such sum.
fn class_products(class: &TransformationClass) -> (usize, Vec<Vec<Term>>, f64) {
    let d = class.dimension();
    match class.structure {
        // tr(P₁P₂) = d ‖Q₁ᵀQ₂‖², I = d²
        Structure::PerCoordinate => (d, each_with_each(d), d as f64),
        Structure::PerAxis => (d, (0..d).map(|c| vec![plus(c, c)]).collect(), d as f64),
        // |z₁* z₂|² of the unit vectors of both planes
        Structure::Complex => (2, complex_products(), 1.0),
        Structure::General => {
            let rank = class.matrices().len();
            let inner = |i: usize, j: usize| (0..d).map(|c| plus(i * d + c, j * d + c)).collect();
            let products = (0..rank).flat_map(|i| (0..rank).map(move |j| inner(i, j))).collect();
            (rank * d, products, rank as f64)
        }
    }
}

fn fit_products(fit: Fit) -> (Vec<Vec<Term>>, Score) {
    match (fit.rotates, fit.dimension) {
        (false, d) => (vec![(0..d).map(|c| plus(c, c)).collect()], Score::Single),
        // tr(RᵀH) is largest at |H₀₀ + H₁₁ + i(H₁₀ − H₀₁)|
        (true, 2) => (complex_products(), Score::Squares),
        (true, d) => (each_with_each(d), Score::Rotation),
    }
}

fn plus(left: usize, right: usize) -> Term {
    Term { left, right, sign: 1.0 }
}

/// `H`, row by row.
fn each_with_each(d: usize) -> Vec<Vec<Term>> {
    (0..d).flat_map(|c| (0..d).map(move |e| vec![plus(c, e)])).collect()
}

/// Real and imaginary part of `z₁* z₂`.
fn complex_products() -> Vec<Vec<Term>> {
    vec![vec![plus(0, 0), plus(1, 1)], vec![plus(0, 1), Term { sign: -1.0, ..plus(1, 0) }]]
}

/// Whether `M B M` belongs to the class for all its matrices `B`, where `M` mirrors the first coordinate.
fn is_mirrored_into_itself(class: &TransformationClass) -> bool {
    let d = class.dimension();
    let stacked = |matrix: &Matrix| Matrix::from_column_slice(d * d, 1, matrix.as_slice());
    let units: Vec<Matrix> = class.matrices().iter().map(|b| stacked(b) / b.norm()).collect();
    let columns: Vec<f64> = units.iter().flat_map(|column| column.iter().copied()).collect();
    let span = Matrix::from_vec(d * d, units.len(), columns).qr().q();
    units.iter().all(|column| {
        let mirrored = Matrix::from_fn(d * d, 1, |k, _| {
            let turns = (k % d == 0) != (k / d == 0);
            if turns { -column[(k, 0)] } else { column[(k, 0)] }
        });
        (&mirrored - &span * span.tr_mul(&mirrored)).norm() <= IN_SPAN
    })
}

/// `max tr(RᵀH)` for the `3 × 3` matrix `H`, given row by row.
fn rotation_score(products: &[f64]) -> f64 {
    let fit = Fit { dimension: 3, rotates: true, scaling: Scaling::None };
    best_correlation(&Matrix::from_row_slice(3, 3, products), fit)
}

/// Scores of all start points from their products, which hold one list of start points per product.
///
/// `tr(RᵀH) ≤ √3 ‖H‖`: a start point with a bound below the best score so far is not decomposed. Its score is the bound, so
/// it is never chosen.
fn rotation_scores(products: &[f64], scores: &mut [f64]) {
    let n = scores.len();
    let at = |s: usize| products.iter().skip(s).step_by(n);
    for (s, score) in scores.iter_mut().enumerate() {
        *score = (3.0 * at(s).map(|p| p * p).sum::<f64>()).sqrt();
    }
    let mut best = f64::NEG_INFINITY;
    for (s, score) in scores.iter_mut().enumerate() {
        if *score * (1.0 + TIE) < best {
            continue;
        }
        *score = rotation_score(&at(s).copied().collect::<Vec<f64>>());
        best = best.max(*score);
    }
}

fn spectra(fft: &RealFft, signals: &[f64]) -> Vec<Complex64> {
    let (n, length) = (fft.len(), fft.spectrum_len());
    let mut spectra = vec![Complex64::ZERO; signals.len() / n * length];
    let pairs = signals.par_chunks_exact(n).zip(spectra.par_chunks_exact_mut(length));
    pairs.with_min_len(TILE).for_each_init(
        || fft.scratch(),
        |scratch, (signal, spectrum)| fft.forward(signal, spectrum, scratch),
    );
    spectra
}

/// `n^{−1/2} F z` of every two columns `x` and `y`, with `z = scale (x + iy)`.
fn complex_spectra(fft: &ComplexFft, scale: f64, signals: &[f64]) -> Vec<Complex64> {
    let (n, factor) = (fft.len(), scale / (fft.len() as f64).sqrt());
    let mut spectra = vec![Complex64::ZERO; signals.len() / 2];
    let pairs = signals.par_chunks_exact(2 * n).zip(spectra.par_chunks_exact_mut(n));
    pairs.with_min_len(TILE).for_each_init(
        || fft.scratch(),
        |scratch, (signal, spectrum)| {
            let (x, y) = signal.split_at(n);
            let both = x.iter().zip(y);
            spectrum.iter_mut().zip(both).for_each(|(z, (x, y))| *z = factor * Complex64::new(*x, *y));
            fft.forward(spectrum, scratch);
        },
    );
    spectra
}

/// Piece `k` of a list divided into pieces of `length`.
fn chunk<T>(all: &[T], k: usize, length: usize) -> &[T] {
    &all[k * length..(k + 1) * length]
}

/// Copies the upper triangle to the lower one, tile by tile.
fn mirror_upper(matrix: &mut [f64], count: usize) {
    for row in (0..count).step_by(TILE) {
        for column in (0..=row).step_by(TILE) {
            for i in row..(row + TILE).min(count) {
                for j in column..(column + TILE).min(i) {
                    matrix[i * count + j] = matrix[j * count + i];
                }
            }
        }
    }
}
