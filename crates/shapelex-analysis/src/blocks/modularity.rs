//! Modularity: whether the parts of a shape covary less with each other than within themselves.
//!
//! ```text
//! CR = √(‖S_12‖²/(‖S_11*‖ ‖S_22*‖))     the mean over all pairs of modules
//! ```
//!
//! `*` removes the `d × d` block of each point, which makes the ratio independent of the rotation of the frame; Adams (2016) removes the
//! diagonal alone, and then the ratio depends on the frame. Both are sums of the squared norms of the covariances of two points.
//!
//! Points of landmarks are exchanged between modules of the sizes given. Neighbouring control points of a curve covary by construction,
//! so the modules of a closed curve are shifted along it as they are.
//!
//! Source: Adams 2016.

use super::error::BlocksError;
use super::pls::MIN_SUBJECTS;
use super::records::{ModularityRecord, ModulePairRecord, ModuleRecord, Tail, TestedStatistic};
use crate::AnalysisError;
use crate::inference::permutation::Relabellings;
use crate::inference::span::centre_rows;
use crate::models::effect_size::Transform;
use crate::watch::{Counted, Watch};
use shapelex_geometry::capability::domain::Domain;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::kernels::dot;
use shapelex_numeric::parallel;

/// Differences below this part of the points are rounding, as for two blocks.
const ROUNDING: f64 = 1e-12;

/// Fewest points of a module: the covariances of a single point are all taken out.
pub const MIN_POINTS: usize = 2;

/// Form of the covariance ratio.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum CovarianceRatio {
    /// Without the covariances of the coordinates of a point with each other: independent of the frame.
    #[default]
    Invariant,
    /// Without the variances of coordinates alone, in the frame of the mean.
    Adams2016,
}

/// Exchange of points between modules.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PointExchange {
    /// Points between modules.
    Points,
    /// All modules along a closed curve.
    Shifts,
}

impl PointExchange {
    /// The exchange of the points of shapes with this domain.
    ///
    /// # Errors
    /// Open curves and surfaces, whose neighbouring points covary by construction and have no shift.
    pub fn of(domain: Domain) -> Result<Self, BlocksError> {
        match domain {
            Domain::Points => Ok(Self::Points),
            Domain::Line { closed: true } => Ok(Self::Shifts),
            _ => Err(BlocksError::Exchange(
                "expected landmarks or closed curves for a test, got shapes whose neighbouring control points covary by \
                 construction and cannot be exchanged: ask for 0 permutations",
            )),
        }
    }

    /// Name in answers.
    pub fn name(self) -> &'static str {
        match self {
            Self::Points => "points",
            Self::Shifts => "shifts",
        }
    }
}

/// Modules of points, and how they are tested.
#[derive(Debug, Clone, Copy)]
pub struct ModularityQuestion<'a> {
    /// Form of the ratio.
    pub cr: CovarianceRatio,
    /// Names of the modules.
    pub names: &'a [String],
    /// Module of each point; `names.len()` for points of none.
    pub labels: &'a [usize],
    /// Exchange of the test; `None` without a test.
    pub exchange: Option<PointExchange>,
    /// Number of permutations of points; shifts are all made.
    pub permutations: usize,
    /// Seed.
    pub seed: u64,
    /// Transformation of Z.
    pub transform: Transform,
    /// Given orders of the points, in place of drawn ones.
    pub given: Option<&'a [Vec<usize>]>,
}

/// The covariance ratio of modules of points (`d·N` coordinate-major numbers of each shape, one shape a column), with its test.
///
/// Cost: `n d² N²` multiply-adds for `n` shapes, and `N²` additions a permutation.
///
/// # Errors
/// Too few shapes; points of a module that do not vary; [`AnalysisError::Interrupted`] once `watch` stops.
pub fn modularity(
    points: &Matrix,
    dimension: usize,
    weights: &[f64],
    question: &ModularityQuestion<'_>,
    watch: &dyn Watch,
) -> Result<ModularityRecord, BlocksError> {
    if weights.len() < MIN_SUBJECTS {
        return Err(BlocksError::FewSubjects { found: weights.len(), needed: MIN_SUBJECTS });
    }
    let size = points.nrows() / dimension;
    let table = Table::new(points, dimension, weights, question.cr, watch)?;
    let (names, labels) = (question.names, question.labels);
    let ratios = table.ratios(labels, names.len());
    if let Some(module) = ratios.undefined {
        return Err(BlocksError::Constant { block: module, name: names[module].clone() });
    }
    let relabellings = Relabelled::new(question);
    let counted = Counted::new(watch, relabellings.count());
    let drawn = parallel::try_map(relabellings.count(), &|index| {
        counted.check()?;
        let found = table.ratios(&relabellings.labels(index), names.len()).mean;
        counted.worked(1);
        Ok::<_, AnalysisError>(found)
    })?;
    let ratio =
        TestedStatistic::of(ratios.mean, &drawn, relabellings.are_all(), question.transform, Tail::Lower);
    let pair = |&(first, second, value): &(usize, usize, f64)| ModulePairRecord {
        first: names[first].clone(),
        second: names[second].clone(),
        value,
    };
    let members = |module: usize| (0..size).filter(|&k| labels[k] == module).collect();
    Ok(ModularityRecord {
        cr: question.cr,
        ratio,
        pairs: ratios.pairs.iter().map(pair).collect(),
        modules: (0..names.len())
            .map(|module| ModuleRecord { name: names[module].clone(), points: members(module) })
            .collect(),
        exchanged: question.exchange.filter(|_| !drawn.is_empty()).map(|exchange| exchange.name().to_owned()),
        average: Vec::new(),
        warnings: Vec::new(),
    })
}

/// Squared norms of the covariances of every two points; on the diagonal the counted part of a point with itself.
struct Table {
    size: usize,
    squares: Vec<f64>,
}

/// Covariance ratios of all pairs of modules.
struct Ratios {
    mean: f64,
    pairs: Vec<(usize, usize, f64)>,
    /// A module without covariances within.
    undefined: Option<usize>,
}

impl Table {
    fn new(
        points: &Matrix,
        dimension: usize,
        weights: &[f64],
        cr: CovarianceRatio,
        watch: &dyn Watch,
    ) -> Result<Self, AnalysisError> {
        let (mut rows, size) = (points.clone(), points.nrows() / dimension);
        centre_rows(&mut rows, weights);
        for (mut column, weight) in rows.column_iter_mut().zip(weights) {
            column.scale_mut(weight.sqrt());
        }
        // At unit scale, so that no square leaves the range of numbers. Shapes that differ by rounding do not vary.
        let largest = rows.amax();
        if largest > ROUNDING * points.amax() {
            rows.unscale_mut(largest);
        } else {
            rows.fill(0.0);
        }
        // Coordinates of a point as contiguous lists.
        let lists = rows.transpose();
        let of = |k: usize, c: usize| lists.column(c * size + k);
        let mut squares = vec![0.0; size * size];
        parallel::try_for_each_chunk(&mut squares, size, &|k, row| {
            watch.check()?;
            for (l, sum) in
                row.iter_mut().enumerate().filter(|(l, _)| *l != k || cr == CovarianceRatio::Adams2016)
            {
                for (a, b) in (0..dimension).flat_map(|a| (0..dimension).map(move |b| (a, b))) {
                    if l != k || a != b {
                        *sum += dot(of(k, a).as_slice(), of(l, b).as_slice()).powi(2);
                    }
                }
            }
            Ok::<_, AnalysisError>(())
        })?;
        Ok(Self { size, squares })
    }

    fn ratios(&self, labels: &[usize], count: usize) -> Ratios {
        let mut sums = vec![0.0; (count + 1) * (count + 1)];
        for (row, &own) in self.squares.chunks_exact(self.size).zip(labels) {
            let of_row = &mut sums[own * (count + 1)..(own + 1) * (count + 1)];
            row.iter().zip(labels).for_each(|(square, &other)| of_row[other] += square);
        }
        let sum = |a: usize, b: usize| sums[a * (count + 1) + b];
        let undefined = (0..count).find(|&a| !(sum(a, a) > 0.0));
        let all = (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b)));
        let pairs: Vec<(usize, usize, f64)> =
            all.map(|(a, b)| (a, b, (sum(a, b) / (sum(a, a) * sum(b, b)).sqrt()).sqrt())).collect();
        let mean = pairs.iter().map(|(_, _, ratio)| ratio).sum::<f64>() / pairs.len() as f64;
        Ratios { mean, pairs, undefined }
    }
}

/// Modules of the points in all exchanges.
enum Relabelled<'a> {
    None,
    Given {
        orders: &'a [Vec<usize>],
        labels: &'a [usize],
    },
    Drawn(Relabellings),
    /// Every shift along the curve, from that by one point on.
    Shifts(&'a [usize]),
}

impl<'a> Relabelled<'a> {
    fn new(question: &ModularityQuestion<'a>) -> Self {
        let ModularityQuestion { labels, names, exchange, permutations, seed, given, .. } = *question;
        match (given, exchange) {
            (Some(orders), _) => Self::Given { orders, labels },
            (None, Some(PointExchange::Shifts)) if permutations > 0 => Self::Shifts(labels),
            (None, Some(PointExchange::Points)) => {
                // Points of no module stay.
                let strata: Vec<usize> =
                    labels.iter().map(|&label| usize::from(label == names.len())).collect();
                Self::Drawn(Relabellings::new(labels.to_vec(), names.len() + 1, &strata, seed, permutations))
            }
            _ => Self::None,
        }
    }

    fn count(&self) -> usize {
        match self {
            Self::None => 0,
            Self::Given { orders, .. } => orders.len(),
            Self::Drawn(relabellings) => relabellings.draws(),
            Self::Shifts(labels) => labels.len(),
        }
    }

    fn are_all(&self) -> bool {
        match self {
            Self::Drawn(relabellings) => relabellings.hold_observed(),
            Self::Shifts(_) => true,
            Self::None | Self::Given { .. } => false,
        }
    }

    fn labels(&self, index: usize) -> Vec<usize> {
        match self {
            Self::None => Vec::new(),
            Self::Given { orders, labels } => orders[index].iter().map(|&from| labels[from]).collect(),
            Self::Drawn(relabellings) => {
                let mut labels = relabellings.observed().to_vec();
                relabellings.relabel(index, &mut labels);
                labels
            }
            Self::Shifts(labels) => {
                let mut moved = labels.to_vec();
                moved.rotate_left(index);
                moved
            }
        }
    }
}
