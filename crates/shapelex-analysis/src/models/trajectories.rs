//! Trajectories of groups: means at the levels of a factor, in order.
//!
//! ```text
//! length Σ_i ‖p_{i+1} − p_i‖,   direction: first principal direction of p_1 … p_k, towards the last point
//! shape: Procrustes distance of the k points at unit size, √(2 − 2 Σ σ_i), σ the singular values of XYᵀ        (k ≥ 3)
//! ```
//!
//! Residuals of the model without its last interaction of the groups and the points are exchanged.
//!
//! Sources: Collyer and Adams 2013; Adams and Collyer 2009.

use super::anova::{Model, Testing};
use super::compare::Nested;
use super::design::Table;
use super::error::ModelError;
use super::formula::Term;
use super::groups::GroupWeights;
use super::pairs::every_two;
use super::resample::{ExchangeRecord, ExchangedStatistic, Functions, Tested};
use crate::metric::Metric;
use crate::watch::Watch;
use shapelex_numeric::dense::{self, Matrix, symmetric_eigen};

/// Trajectories that are asked for.
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct TrajectoryOptions {
    /// Factors of the formula whose combinations are the groups.
    pub groups: Vec<String>,
    /// Factor of the formula whose levels, in their order, are the points.
    pub points: String,
    /// Formula of the null model. Default: the model without the interactions of most variables of groups and points.
    #[cfg_attr(feature = "serde", serde(default))]
    pub null: Option<String>,
}

/// Trajectories of groups.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct TrajectoriesRecord {
    /// Levels of the points, in order.
    pub points: Vec<String>,
    /// Formula of the null model.
    pub null: String,
    /// Exchanges of the tests.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub made: ExchangeRecord,
    /// The trajectories.
    pub groups: Vec<TrajectoryRecord>,
    /// Every two of them.
    pub pairs: Vec<TrajectoryPair>,
}

/// A trajectory.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct TrajectoryRecord {
    /// Levels of the factors, with colons between.
    pub name: String,
    /// Sum of the distances from each point to the next.
    pub length: f64,
    /// Means at the points as numbers.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub values: Option<Vec<f64>>,
    /// Control points of the means at the points, in the frame of the pooled mean.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub shapes: Option<Vec<Vec<Vec<f64>>>>,
    /// Displacements of the control points along the direction, of unit length.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub direction: Option<Vec<Vec<f64>>>,
}

/// Two trajectories beside each other.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct TrajectoryPair {
    /// Name of the first group.
    pub first: String,
    /// Name of the second group.
    pub second: String,
    /// Difference of the lengths.
    pub length_difference: ExchangedStatistic,
    /// Angle between the directions, in radians.
    pub angle: ExchangedStatistic,
    /// Distance of the trajectories at unit size, moved and turned onto each other; null for two points.
    pub shape: Option<ExchangedStatistic>,
}

/// A trajectory of points in columns.
#[derive(Debug, Clone)]
pub struct Trajectory {
    /// `R` of the points `X = QR` about their mean, which has all products of the points.
    factor: Matrix,
    /// Sum of the steps.
    pub length: f64,
    /// Unit vector of the first principal direction, towards the last point; zero for points that are all equal.
    pub direction: Vec<f64>,
}

impl Trajectory {
    /// The trajectory of points, one a column.
    pub fn new(points: &Matrix) -> Self {
        let step = |i: usize| (points.column(i) - points.column(i - 1)).norm();
        let length = (1..points.ncols()).map(step).sum();
        let mean = points.column_mean();
        let centred = Matrix::from_fn(points.nrows(), points.ncols(), |i, k| points[(i, k)] - mean[i]);
        let eigen = symmetric_eigen(&dense::transpose_multiply(&centred, &centred));
        let mut direction = &centred * eigen.eigenvectors.column(eigen.eigenvalues.imax());
        let (norm, last) = (direction.norm(), points.ncols() - 1);
        let towards = direction.dot(&(points.column(last) - points.column(0)));
        direction *= if norm > 0.0 { towards.signum() / norm } else { 0.0 };
        Self { factor: centred.qr().r(), length, direction: direction.iter().copied().collect() }
    }

    /// Angle between the directions of two trajectories, in radians.
    pub fn angle(&self, other: &Self) -> f64 {
        let product: f64 = self.direction.iter().zip(&other.direction).map(|(a, b)| a * b).sum();
        product.clamp(-1.0, 1.0).acos()
    }

    /// Procrustes distance of two trajectories at unit size.
    pub fn distance(&self, other: &Self) -> f64 {
        let sizes = self.factor.norm() * other.factor.norm();
        let products = dense::multiply(&self.factor, &other.factor.transpose());
        let along = dense::svd(products, false, false).map_or(0.0, |svd| svd.singular_values.sum());
        if sizes > 0.0 { (2.0 - 2.0 * along / sizes).max(0.0).sqrt() } else { 0.0 }
    }
}

impl Model {
    /// Trajectories of groups.
    ///
    /// # Errors
    /// Settings that do not fit the model; groups without shapes at a point; random parts; errors of the tests.
    pub fn trajectories(
        &self,
        options: &TrajectoryOptions,
        table: &Table,
        metric: Option<&Metric>,
        testing: &Testing<'_>,
        watch: &dyn Watch,
    ) -> Result<TrajectoriesRecord, ModelError> {
        self.check_fixed("trajectories")?;
        let (names, points, functions) = self.functions_of_trajectories(options, table)?;
        let null = self.null_of_trajectories(options, table)?;
        let (count, steps) = (names.len(), points.len());
        let of_groups = |vectors: &Matrix| -> Vec<Trajectory> {
            (0..count).map(|g| Trajectory::new(&vectors.columns(g * steps, steps).into_owned())).collect()
        };
        let two = every_two(count);
        let statistics = |vectors: &Matrix| -> Vec<f64> {
            let all = of_groups(vectors);
            let of = |&(a, b): &(usize, usize)| {
                let (a, b): (&Trajectory, &Trajectory) = (&all[a], &all[b]);
                let shape = (steps > 2).then(|| a.distance(b));
                [Some((a.length - b.length).abs()), Some(a.angle(b)), shape]
            };
            let found: Vec<[Option<f64>; 3]> = two.iter().map(of).collect();
            (0..3).flat_map(|i| found.iter().filter_map(move |values| values[i])).collect()
        };
        let tested = Tested { functions: &functions, null: &null, about_mean: true, statistics: &statistics };
        let (found, made) = self.exchanged(&tested, testing, watch)?.tests(testing.transform);
        let vectors = functions.vectors(self);
        let trajectories = of_groups(&vectors);
        let group = |(g, name): (usize, &String)| {
            let at = |i: usize| vectors.column(g * steps + i).iter().copied().collect::<Vec<f64>>();
            TrajectoryRecord {
                name: name.clone(),
                length: trajectories[g].length,
                values: metric.is_none().then(|| (0..steps).map(|i| at(i)[0]).collect()),
                shapes: metric.map(|metric| (0..steps).map(|i| metric.rows(&at(i))).collect()),
                direction: metric.map(|metric| metric.rows(&trajectories[g].direction)),
            }
        };
        Ok(TrajectoriesRecord {
            null: null.formula,
            made,
            groups: names.iter().enumerate().map(group).collect(),
            pairs: pairs_of(&names, &two, found),
            points,
        })
    }

    /// Names of groups and points, and the means of all their combinations.
    fn functions_of_trajectories(
        &self,
        options: &TrajectoryOptions,
        table: &Table,
    ) -> Result<(Vec<String>, Vec<String>, Functions), ModelError> {
        let groups = self.groups(&options.groups, "trajectories/groups")?;
        let points = self.groups(std::slice::from_ref(&options.points), "trajectories/points")?;
        let names: Vec<String> = options.groups.iter().chain([&options.points]).cloned().collect();
        let all = self.groups(&names, "trajectories/points")?;
        if all.count() != groups.count() * points.count() {
            let wanted =
                groups.names.iter().flat_map(|g| points.names.iter().map(move |p| format!("{g}:{p}")));
            let missing = wanted.into_iter().find(|name| !all.names.contains(name));
            let detail = format!(
                "expected shapes of every group at every point, got none of {}",
                missing.unwrap_or_default()
            );
            return Err(ModelError::Setting { field: "trajectories/points", detail });
        }
        let rows = self.mean_rows(&all, table, GroupWeights::Observed);
        let functions = Functions::new(self, all.names.clone(), &rows, "trajectories/groups")?;
        Ok((groups.names, points.names, functions))
    }

    fn null_of_trajectories(&self, options: &TrajectoryOptions, table: &Table) -> Result<Nested, ModelError> {
        if let Some(null) = &options.null {
            return self.given_null(null, table, "trajectories/null");
        }
        let groups = self.groups(&options.groups, "trajectories/groups")?;
        let points = self.groups(std::slice::from_ref(&options.points), "trajectories/points")?;
        let is_both =
            |term: &Term| term.0.iter().any(|v| groups.is_of(*v)) && term.0.iter().any(|v| points.is_of(*v));
        let both = self.design.formula.terms.iter().filter(|term| is_both(term));
        let Some(most) = both.map(Term::degree).max() else {
            let detail = "expected an interaction of the groups and the points in the formula, without which all trajectories are \
                          equal, got none";
            return Err(ModelError::Setting { field: "trajectories/points", detail: detail.into() });
        };
        self.without(|term| is_both(term) && term.degree() == most, "trajectories/null")
    }
}

/// Tests of pairs from those of all differences of lengths, all angles, and all shapes.
fn pairs_of(
    names: &[String],
    two: &[(usize, usize)],
    mut found: Vec<ExchangedStatistic>,
) -> Vec<TrajectoryPair> {
    found.chunks_mut(two.len()).for_each(|tests| ExchangedStatistic::correct(tests.iter_mut()));
    let at = |statistic: usize, i: usize| found.get(statistic * two.len() + i).cloned();
    let pair = |(i, &(a, b)): (usize, &(usize, usize))| TrajectoryPair {
        first: names[a].clone(),
        second: names[b].clone(),
        length_difference: at(0, i).unwrap_or_default(),
        angle: at(1, i).unwrap_or_default(),
        shape: at(2, i),
    };
    two.iter().enumerate().map(pair).collect()
}
