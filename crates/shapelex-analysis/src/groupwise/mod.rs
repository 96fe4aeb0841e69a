//! Groupwise correspondence of shapes on a sphere, without a template.
//!
//! ```text
//! minimise  log det(S/n + δ I)   over γ_k and poses,   S = Σ_k (z_k − z̄)(z_k − z̄)ᵀ,   z_k = ⟨Y, R_k r_k∘γ_k⟩
//! ```
//!
//! Shapes are compared by the coefficients `z` of their points in spherical harmonics of the common parameter sphere: there the metric
//! of the area of the sphere is the identity, and no pole of a space counts more than another point. The scatter has the size `p` of
//! these coefficients, whatever the number of shapes. In each round all shapes are moved by one Gauss–Newton step of the objective;
//! the mean and the covariance follow. Degrees rise and the noise `δ` falls from stage to stage.
//!
//! The order of the shapes and the rotation of their parameters do not matter: the start depends on each shape alone, the fields of
//! one degree are mapped among themselves by rotations, and the common parameters end where the long axis of the mean is.
//!
//! * `domain` — functions on the parameter sphere; `start` — rotations; `member` — one shape; `model` — the distribution; `joint` —
//!   steps of all shapes together;
//! * [`Reference`] — the same for a new shape and a distribution that stays as it is.
//!
//! Sources: Davies, Twining and Taylor 2008 (description length over reparametrisations); Cates, Fletcher, Styner, Shenton and
//! Whitaker 2007 (entropy of the ensemble, a falling regularisation).

mod domain;
mod joint;
mod member;
mod model;
mod reference;
mod start;

use self::domain::Domain;
use self::member::{Member, Penalty, free};
use self::model::{Model, Spread};
pub use self::reference::Reference;
use super::watch::Watch;
use super::{AnalysisError, DEGENERATE};
use shapelex_geometry::reparametrisation::Reparametrisation;
use shapelex_geometry::reparametrisation::flow::Workspace;
use shapelex_geometry::reparametrisation::spherical::{Refit, Spherical};
use shapelex_geometry::rotation::Rotation;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::parallel;

/// Highest degree of the fields.
pub const MAX_DEGREE: usize = 6;
/// Default degree.
pub const DEGREE: usize = 4;
/// Default weight of the deformations.
pub const STIFFNESS: f64 = 10.0;
/// Smallest and largest weight of the deformations.
pub const STIFFNESS_RANGE: [f64; 2] = [1e-4, 1e4];

/// Most rounds in which all rotations are searched.
const SEARCHES: usize = 4;
/// Relative decrease of the sum of squares below which the search of rotations ends.
const SETTLED: f64 = 1e-2;
/// Default number of rounds of steps for every degree.
pub const ROUNDS: usize = 4;
/// Most rounds of steps for every degree.
pub const MAX_ROUNDS: usize = 20;
/// Noise `δ` at the beginning and at the end, relative to the total variance of the shapes with rotations only.
const NOISE: [f64; 2] = [1e-1, 1e-3];
/// Variance relative to the squared size of the mean below which shapes are equal.
const NO_VARIANCE: f64 = 1e-9;
/// Norm of a centred shape relative to its coordinates below which it has no extent.
const NO_EXTENT: f64 = 1e-9;
/// Choices of a groupwise correspondence.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GroupwiseOptions {
    /// Highest degree of the fields, at most [`MAX_DEGREE`]; 0 for rotations only.
    pub degree: usize,
    /// Steps of every shape for each degree, 1 to [`MAX_ROUNDS`].
    pub rounds: usize,
    /// Whether sizes are compared; otherwise every shape is scaled to unit area.
    pub sizes: bool,
    /// Weight of the squared displacement of the parameters (radians), relative to the total variance with rotations only.
    pub stiffness: f64,
}

/// A shape in correspondence.
#[derive(Debug, Clone)]
pub struct Corresponding {
    /// How its parameters were moved.
    pub map: Reparametrisation,
    /// The shape with its new parameters, in the pose in which it was given.
    pub refit: Refit,
    /// Smallest ratio of an area on the parameter sphere after the map to that before it; negative where the map folds.
    pub least_jacobian: f64,
}

/// Shapes in correspondence.
#[derive(Debug, Clone)]
pub struct Groupwise {
    /// The shapes, in order.
    pub members: Vec<Corresponding>,
    /// `Σ log(1 + λ/δ)` with rotations only and at the end, both at the last noise.
    pub entropy: [f64; 2],
    /// Total variance with rotations only and at the end.
    pub variance: [f64; 2],
}

/// Usual number of times that [`correspond`] works on each shape, which [`Watch::worked`] counts.
pub fn rounds(options: &GroupwiseOptions) -> usize {
    2 + SEARCHES + options.degree * options.rounds
}

/// Multiply-adds of a search and all steps of one shape, measured.
pub fn shape_work(options: &GroupwiseOptions) -> f64 {
    let step = |degree: usize| 4.0e6 + 2.6e5 * (free(degree).len() as f64);
    SEARCHES as f64 * 1.2e7
        + (1..=options.degree).map(|degree| options.rounds as f64 * step(degree)).sum::<f64>()
}

/// Multiply-adds of the mean and covariance of `shapes` shapes, over all rounds: before each and for two trials.
pub fn model_work(shapes: usize, options: &GroupwiseOptions) -> f64 {
    let size = 3.0 * Domain::SIZE as f64;
    (SEARCHES + 3 * options.degree * options.rounds) as f64 * (shapes as f64 * size * size + size.powi(3))
}

/// Bytes for `shapes` shapes of `rows` control points: control points, points at the nodes, coefficients, the equations of a step, and
/// the refitted shapes.
pub fn bytes(shapes: usize, rows: usize, options: &GroupwiseOptions) -> f64 {
    let unknowns = if options.degree > 0 { 6 + free(options.degree).len() } else { 0 };
    let equations = unknowns * (3 * Domain::SIZE + 2 * unknowns);
    let each = 3 * (4 * rows + Domain::NODES + 4 * Domain::SIZE) + equations;
    let size = 3.0 * Domain::SIZE as f64;
    8.0 * (shapes as f64 * each as f64 + 6.0 * size * size + 4.0 * (Domain::NODES * Domain::SIZE) as f64)
}

/// Brings shapes into correspondence. Each is given by its control points, `N × 3`.
///
/// Cost: some 20 passes of 10 ms for each shape, linear in their number, and an eigendecomposition of size `p = 360` for each round.
/// The result does not depend on the number of threads, and on the order of the shapes and the rotation of their parameters only by
/// rounding and the error with which the space represents them.
///
/// # Errors
/// [`AnalysisError::TooFewShapes`] for fewer than two; [`AnalysisError::NoExtent`] for a point; [`AnalysisError::Degenerate`]
/// for a line or a flat shape;
/// [`AnalysisError::Interrupted`].
pub fn correspond(
    spherical: &Spherical,
    shapes: &[Matrix],
    options: &GroupwiseOptions,
    watch: &dyn Watch,
) -> Result<Groupwise, AnalysisError> {
    if shapes.len() < 2 {
        return Err(AnalysisError::TooFewShapes { found: shapes.len(), needed: 2 });
    }
    let domain = Domain::new();
    let mut members = settled(&domain, spherical, shapes, options.sizes, watch)?;
    rotate(&domain, &mut members, watch)?;
    let begin = spread_of(&members)?;
    let noise = deform(&domain, &mut members, &begin, options, watch)?;
    let end = spread_of(&members)?;
    let mean = mean_points(&domain, &members);
    let inner = start::axes(&domain, &mean).map(|[_, sphere]| Rotation::onto(sphere));
    let finish = |k: usize| {
        watch.check()?;
        let member = &members[k];
        let mut map = member.map.clone();
        map.inner = inner.unwrap_or(map.inner);
        let found = finished(&domain, spherical, member, map);
        watch.worked(1);
        Ok::<_, AnalysisError>(found)
    };
    let members = parallel::try_map(members.len(), &finish)?;
    let (entropy, variance) = ([begin.entropy(noise), end.entropy(noise)], [begin.total(), end.total()]);
    Ok(Groupwise { members, entropy, variance })
}

/// The shape of `member` under `map`, with its certificates.
fn finished(
    domain: &Domain,
    spherical: &Spherical,
    member: &Member,
    map: Reparametrisation,
) -> Corresponding {
    let mut work = Workspace::new(map.degree());
    let images: Vec<[f64; 3]> = domain.nodes.points.iter().map(|x| map.apply(*x, &mut work)).collect();
    let least_jacobian = domain.nodes.least_jacobian(&images);
    let refit = spherical.refit(&member.shape, &map);
    Corresponding { map, refit, least_jacobian }
}

/// Members where their first-order ellipsoids have their axes.
fn settled(
    domain: &Domain,
    spherical: &Spherical,
    shapes: &[Matrix],
    sizes: bool,
    watch: &dyn Watch,
) -> Result<Vec<Member>, AnalysisError> {
    let settle = |index: usize| {
        watch.check()?;
        let mut member =
            Member::new(domain, spherical.shape(&shapes[index])).map_err(|error| error.at(index))?;
        if !sizes {
            member.scale = member.area(domain).sqrt().recip();
        }
        member.settle(domain);
        watch.worked(1);
        Ok(member)
    };
    parallel::try_map(shapes.len(), &settle)
}

/// Alternates the mean with the rotations and poses that are nearest to it.
fn rotate(domain: &Domain, members: &mut [Member], watch: &dyn Watch) -> Result<(), AnalysisError> {
    for _ in 0..SEARCHES {
        let mean = mean_points(domain, members);
        let model = Model::isotropic(mean_of(members));
        let before: f64 = members.iter().map(|member| model.cost(&member.coefficients)).sum();
        let costs = parallel::map_each(members, &|member| {
            watch.check()?;
            let cost = member.search(domain, &mean, &model);
            watch.worked(1);
            Ok(cost)
        });
        let costs = costs.into_iter().collect::<Result<Vec<f64>, AnalysisError>>()?;
        if costs.iter().sum::<f64>() > (1.0 - SETTLED) * before {
            break;
        }
    }
    Ok(())
}

/// Steps of all coefficients: degrees rise, the noise falls. Costs are in parts of the noise, so that the weight of the deformations
/// falls with it. Returns the last noise.
fn deform(
    domain: &Domain,
    members: &mut [Member],
    begin: &Spread,
    options: &GroupwiseOptions,
    watch: &dyn Watch,
) -> Result<f64, AnalysisError> {
    let size: f64 = begin.mean.iter().map(|x| x * x).sum();
    // Equal shapes have no variance, and nothing to deform.
    let total = begin.total().max(NO_VARIANCE * size);
    let last = (options.degree * options.rounds).saturating_sub(1).max(1) as f64;
    let noise_at = |round: usize| {
        let share = NOISE[0] * (NOISE[1] / NOISE[0]).powf(round as f64 / last);
        share * total
    };
    let mut damping = joint::DAMPING;
    for degree in 1..=options.degree {
        let wanted = free(degree);
        members.iter_mut().for_each(|member| member.map = member.map.raised(degree));
        for round in (degree - 1) * options.rounds..degree * options.rounds {
            let noise = noise_at(round);
            let penalty = Penalty { weight: options.stiffness * total * noise / noise_at(0) };
            joint::step(domain, members, (noise, penalty), &wanted, &mut damping, watch)?;
            centre_fields(members);
            parallel::map_each(members, &|member| member.refresh(domain));
        }
    }
    Ok(noise_at(last as usize))
}

fn spread_of(members: &[Member]) -> Result<Spread, AnalysisError> {
    Spread::of(&members.iter().map(|member| &member.coefficients[..]).collect::<Vec<_>>())
}

/// Mean of the coefficients, summed in order.
fn mean_of(members: &[Member]) -> Vec<f64> {
    let count = members.len() as f64;
    let mut mean = vec![0.0; members.first().map_or(0, |member| member.coefficients.len())];
    for member in members {
        mean.iter_mut().zip(&member.coefficients).for_each(|(sum, x)| *sum += x / count);
    }
    mean
}

fn mean_points(domain: &Domain, members: &[Member]) -> Vec<[f64; 3]> {
    let placed = parallel::map(members.len(), &|k| members[k].placed(domain));
    let count = members.len() as f64;
    let mut mean = vec![[0.0; 3]; Domain::NODES];
    for points in placed {
        for (sum, point) in mean.iter_mut().zip(points) {
            (0..3).for_each(|c| sum[c] += point[c] / count);
        }
    }
    mean
}

/// Subtracts the mean of the coefficients: a map that all shapes share corresponds nothing.
fn centre_fields(members: &mut [Member]) {
    let Some(first) = members.first() else { return };
    let (degree, count) = (first.map.degree(), members.len() as f64);
    let mut mean = vec![0.0; first.map.coefficients().len()];
    for member in members.iter() {
        mean.iter_mut().zip(member.map.coefficients()).for_each(|(sum, a)| *sum += a / count);
    }
    for member in members {
        let centred = member.map.coefficients().iter().zip(&mean).map(|(a, mean)| a - mean).collect();
        member.map = member.map.with_coefficients(degree, centred);
    }
}
