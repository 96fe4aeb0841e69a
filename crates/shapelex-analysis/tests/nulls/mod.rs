//! Null cases of tests: groups of one mean shape whose scatter differs, and shapes of one mean whose scatter follows a number.
//!
//! The base shape has unit centroid size. Independent normal deviations of its control points have the standard deviation of the group;
//! then every shape is turned, scaled and moved at random.

pub(crate) mod sides;

use rand::rngs::ChaCha12Rng;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use shapelex_analysis::alignment::{Alignment, Method};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::inference::aligned::{AlignedShapes, StudySpace, frame_for};
use shapelex_analysis::inference::compare::compare;
use shapelex_analysis::inference::groups::Groups;
use shapelex_analysis::inference::permutation::Draws;
use shapelex_analysis::inference::regress::regress;
use shapelex_analysis::inference::variables::{Values, Variable, Variables};
use shapelex_analysis::matching::Matching;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::models::anova::{Model, Testing};
use shapelex_analysis::models::design::{Contrasts, Table, Values as ModelValues};
use shapelex_analysis::models::formula::{Formula, TermOrder};
use shapelex_analysis::models::subspaces::SumType;
use shapelex_analysis::tangent::LinearAlignment;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_geometry::surface::Topology;
use shapelex_numeric::dense::Matrix;

/// Root of the summed variances of the coordinates of the group that scatters more: 0.09 for each of 8 planar landmarks.
const ROUGHNESS: f64 = 0.36;

/// Relabellings of a test.
const PERMUTATIONS: usize = 199;

/// Kind of shape of a null case.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Landmarks,
    LandmarksInSpace,
    Curves,
    Surfaces,
}

impl Kind {
    pub(crate) const ALL: [Self; 4] = [Self::Landmarks, Self::LandmarksInSpace, Self::Curves, Self::Surfaces];

    fn representation(self) -> Representation {
        match self {
            Self::Landmarks => Representation::Landmarks { dimension: 2, points: 8 },
            Self::LandmarksInSpace => Representation::Landmarks { dimension: 3, points: 10 },
            Self::Curves => Representation::ClosedCurve {
                dimension: 2,
                control_points: 12,
                generator: GeneratorKind::Bspline { degree: 3 },
            },
            Self::Surfaces => Representation::Surface {
                topology: Topology::Torus,
                seam: Default::default(),
                control_points: [5, 4],
                generators: [GeneratorKind::Bspline { degree: 3 }, GeneratorKind::Bspline { degree: 3 }],
            },
        }
    }
}

/// Two groups of one mean shape, and how they are aligned.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Case {
    pub(crate) kind: Kind,
    /// Shapes of the group that scatters more, and of the other.
    pub(crate) sizes: [usize; 2],
    /// Ratio of the standard deviations.
    pub(crate) ratio: f64,
    /// The method by name; the default otherwise.
    pub(crate) alignment: Option<Alignment>,
}

/// Parts of the sets with p ≤ 0.05, and with a warning.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Alarms {
    pub(crate) distance: f64,
    pub(crate) pseudo_f: f64,
    pub(crate) hotelling: f64,
    pub(crate) studentised: f64,
    pub(crate) warned: f64,
    /// p ≤ 0.05 of the distance without a warning.
    pub(crate) silent: f64,
}

/// The space of a kind of shapes, and its base shape, coordinate-major.
struct Prepared {
    space: ShapeSpace,
    metric: Metric,
    base: Vec<f64>,
}

impl Prepared {
    fn new(kind: Kind) -> Self {
        let space = ShapeSpace::new(&kind.representation()).unwrap();
        let metric = Metric::of(&space);
        let mut random = ChaCha12Rng::seed_from_u64(7);
        let mut base: Vec<f64> = (0..metric.len()).map(|_| StandardNormal.sample(&mut random)).collect();
        metric.centre(&mut base);
        let size = base.iter().map(|x| x * x).sum::<f64>().sqrt();
        base.iter_mut().for_each(|x| *x /= size);
        Self { space, metric, base }
    }

    /// A shape of the base with deviations of this part of the usual ones, in a random pose.
    fn shape(&self, part: f64, random: &mut ChaCha12Rng) -> Vec<f64> {
        let deviation = part * ROUGHNESS / (self.metric.len() as f64).sqrt();
        let rough = around(&self.base, deviation, random);
        self.posed(&rough, random)
    }

    /// The shape in a random pose.
    fn posed(&self, rough: &[f64], random: &mut ChaCha12Rng) -> Vec<f64> {
        let d = self.metric.dimension();
        let count = self.metric.len() / d;
        let mut noise = || -> f64 { StandardNormal.sample(random) };
        let turn = rotation(d, &mut noise);
        let scale = (0.3 * noise()).exp();
        let shift: Vec<f64> = (0..d).map(|_| 5.0 * noise()).collect();
        let moved = |c: usize, i: usize| {
            shift[c] + scale * (0..d).map(|e| turn[c][e] * rough[e * count + i]).sum::<f64>()
        };
        (0..d).flat_map(|c| (0..count).map(move |i| (c, i))).map(|(c, i)| moved(c, i)).collect()
    }

    /// What `then` makes of the aligned shapes.
    fn aligned<T>(
        &self,
        alignment: Option<Alignment>,
        shapes: Vec<f64>,
        then: impl FnOnce(&AlignedShapes<'_>) -> T,
    ) -> T {
        let (class, d) = (Transformation::Named(ClassName::Similarity), self.metric.dimension());
        let chosen = LinearAlignment::of_test(&class, d, alignment, None).unwrap();
        let method = Method::new(&class, chosen.alignment, d).unwrap();
        let matching =
            Matching::new(&self.space, Correspondence::Landmarks, Direction::Given, Mirror::Forbid)
                .translating(method.translates());
        let study = StudySpace {
            space: &self.space,
            metric: &self.metric,
            method: &method,
            tangent: chosen.tangent,
            frame: frame_for(&class),
            matching: &matching,
        };
        let weights = vec![1.0; shapes.len() / self.metric.len()];
        then(&AlignedShapes::new(study, shapes, weights, &Unwatched).unwrap())
    }
}

/// A shape with independent deviations of its coordinates.
fn around(shape: &[f64], deviation: f64, random: &mut ChaCha12Rng) -> Vec<f64> {
    let mut noise = || -> f64 { StandardNormal.sample(random) };
    shape.iter().map(|x| x + deviation * noise()).collect()
}

/// A random rotation: axes of normal numbers, made orthonormal, of determinant one.
fn rotation(d: usize, noise: &mut impl FnMut() -> f64) -> Vec<Vec<f64>> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut axes: Vec<Vec<f64>> = Vec::new();
    while axes.len() < d {
        let mut axis: Vec<f64> = (0..d).map(|_| noise()).collect();
        for other in &axes {
            let along = dot(&axis, other);
            axis.iter_mut().zip(other).for_each(|(x, o)| *x -= along * o);
        }
        let length = dot(&axis, &axis).sqrt();
        axes.push(axis.iter().map(|x| x / length).collect());
    }
    let [a, b] = [&axes[0], &axes[1]];
    let determinant = match axes.get(2) {
        None => a[0] * b[1] - a[1] * b[0],
        Some(c) => dot(c, &[a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]),
    };
    axes[0].iter_mut().for_each(|x| *x *= determinant.signum());
    axes
}

/// Alarms of a case in so many sets.
pub(crate) fn alarms(case: &Case, sets: usize) -> Alarms {
    let prepared = Prepared::new(case.kind);
    let found: Vec<Alarms> = (0..sets).into_par_iter().map(|set| alarms_of(case, &prepared, set)).collect();
    let part = |of: fn(&Alarms) -> f64| found.iter().map(of).sum::<f64>() / sets as f64;
    Alarms {
        distance: part(|set| set.distance),
        pseudo_f: part(|set| set.pseudo_f),
        hotelling: part(|set| set.hotelling),
        studentised: part(|set| set.studentised),
        warned: part(|set| set.warned),
        silent: part(|set| set.silent),
    }
}

fn alarms_of(case: &Case, prepared: &Prepared, set: usize) -> Alarms {
    let mut random = ChaCha12Rng::seed_from_u64(1000 + set as u64);
    let parts = [1.0, 1.0 / case.ratio];
    let labels: Vec<usize> = (0..2).flat_map(|g| std::iter::repeat_n(g, case.sizes[g])).collect();
    let shapes = labels.iter().flat_map(|&g| prepared.shape(parts[g], &mut random)).collect();
    let (names, strata) = (vec!["wide".into(), "narrow".into()], vec![0; labels.len()]);
    let groups = Groups { names, labels };
    let draws = Draws { strata: &strata, seed: set as u64, permutations: PERMUTATIONS };
    let places = prepared.space.representation().comparison_places();
    let found = prepared.aligned(case.alignment, shapes, |aligned| {
        compare(aligned, &groups, draws, places, &Unwatched).unwrap()
    });
    let pair = &found.pairs[0];
    let alarm = |p: Option<f64>| f64::from(u8::from(p.unwrap() <= 0.05));
    let warned = f64::from(u8::from(found.warnings.iter().any(|warning| warning.contains("scatter"))));
    let distance = alarm(pair.distance.test.p);
    Alarms {
        distance,
        pseudo_f: alarm(pair.pseudo_f.test.p),
        hotelling: alarm(pair.hotelling.test.p),
        studentised: alarm(pair.studentised.as_ref().unwrap().test.p),
        warned,
        silent: distance * (1.0 - warned),
    }
}

/// Parts of the sets in which 40 shapes of one mean depend on a number by p ≤ 0.05, and in which a warning says that their scatter follows it;
/// their deviations grow with it by `ratio`.
pub(crate) fn regression_alarms(
    kind: Kind,
    ratio: f64,
    alignment: Option<Alignment>,
    sets: usize,
) -> [f64; 2] {
    const SHAPES: usize = 40;
    let prepared = Prepared::new(kind);
    let alarm = |set: usize| {
        let mut random = ChaCha12Rng::seed_from_u64(1000 + set as u64);
        let ages: Vec<f64> = (0..SHAPES).map(|_| random.random::<f64>()).collect();
        let part = |age: f64| (1.0 + age * (ratio - 1.0)) / ratio;
        let shapes = ages.iter().flat_map(|&age| prepared.shape(part(age), &mut random)).collect();
        let attribute = Variable { name: "age".into(), values: Values::Numbers(ages.clone()) };
        let variables = Variables { covariates: Vec::new(), attribute };
        let draws = Draws { strata: &[0; SHAPES], seed: set as u64, permutations: PERMUTATIONS };
        prepared.aligned(alignment, shapes, |aligned| {
            let found = regress(aligned, &variables, draws, &Unwatched).unwrap();
            let warned =
                found.warnings.iter().any(|warning| warning.contains("median of the attribute scatter"));
            [found.record.test.p.unwrap() <= 0.05, warned]
        })
    };
    let found: Vec<[bool; 2]> = (0..sets).into_par_iter().map(alarm).collect();
    [0, 1].map(|which| found.iter().filter(|one| one[which]).count() as f64 / sets as f64)
}

/// A design of a linear model whose terms have no effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Layout {
    /// Two factors of equal cells.
    Balanced,
    /// Two factors of unequal cells, and a number that depends on one of them.
    Unbalanced,
    /// Years within sites, which differ; the error term of the sites.
    Nested,
    /// Subjects that differ, seen on three days, of two treatments.
    Repeated,
    /// Two factors of equal cells, one level of which scatters three times as much.
    UnequalScatter,
    /// Subjects of two treatments whose changes with age differ, seen at the same ages.
    Slopes,
    /// The same at ages of their own.
    OwnAges,
}

impl Layout {
    pub(crate) const ALL: [Self; 7] = [
        Self::Balanced,
        Self::Unbalanced,
        Self::Nested,
        Self::Repeated,
        Self::UnequalScatter,
        Self::Slopes,
        Self::OwnAges,
    ];

    fn formula(self) -> &'static str {
        match self {
            Self::Balanced | Self::UnequalScatter => "~ a*b",
            Self::Unbalanced => "~ a*b + t",
            Self::Nested => "~ site + (1 | site:year)",
            Self::Repeated => "~ treatment + day + (1 | subject)",
            Self::Slopes | Self::OwnAges => "~ age*treatment + (age | subject)",
        }
    }

    /// Attributes of the shapes, their groups of a common deviation, and the part of their own. Ten groups, five of each kind, have 126
    /// exchanges that differ: enough for a level near 5 %.
    fn made(self, random: &mut ChaCha12Rng) -> (Table, Vec<usize>, Vec<f64>) {
        let shapes = match self {
            Self::Nested | Self::Repeated => 30,
            Self::Slopes | Self::OwnAges => 40,
            _ => 24,
        };
        let text = |name: &str, of: &dyn Fn(usize) -> usize| {
            (name.to_owned(), ModelValues::Texts((0..shapes).map(|k| format!("{name}{}", of(k))).collect()))
        };
        let (attributes, groups): (Vec<_>, Vec<usize>) = match self {
            Self::Balanced | Self::UnequalScatter => {
                (vec![text("a", &|k| k % 2), text("b", &|k| k / 2 % 3)], (0..shapes).collect())
            }
            Self::Unbalanced => {
                let a = |k: usize| usize::from(k < 9);
                let numbers = (0..shapes).map(|k| a(k) as f64 + random.random::<f64>()).collect();
                let t = ("t".to_owned(), ModelValues::Numbers(numbers));
                (vec![text("a", &a), text("b", &|k| [0, 1, 1, 2, 0, 1, 1][k % 7]), t], (0..shapes).collect())
            }
            Self::Nested => {
                let (site, year) = (|k: usize| k / 15, |k: usize| k / 3);
                (vec![text("site", &site), text("year", &year)], (0..shapes).map(year).collect())
            }
            Self::Repeated => {
                let subject = |k: usize| k / 3;
                let treatment = |k: usize| usize::from(k / 3 < 5);
                let names =
                    vec![text("subject", &subject), text("day", &|k| k % 3), text("treatment", &treatment)];
                (names, (0..shapes).map(subject).collect())
            }
            Self::Slopes | Self::OwnAges => {
                let (subject, treatment) = (|k: usize| k / 4, |k: usize| usize::from(k / 4 < 5));
                let mut own = || if self == Self::OwnAges { random.random::<f64>() - 0.5 } else { 0.0 };
                let ages = (0..shapes).map(|k| (k % 4) as f64 - 1.5 + own()).collect();
                let age = ("age".to_owned(), ModelValues::Numbers(ages));
                let names = vec![text("subject", &subject), text("treatment", &treatment), age];
                (names, (0..shapes).map(subject).collect())
            }
        };
        let part = |k: usize| if self == Self::UnequalScatter && k.is_multiple_of(2) { 3.0 } else { 1.0 };
        let table = Table { attributes: attributes.into_iter().collect(), ..Table::default() };
        (table, groups, (0..shapes).map(part).collect())
    }
}

/// Parts of the sets in which each term of a model without effects has p ≤ 0.05, by its name.
pub(crate) fn model_alarms(layout: Layout, kind: SumType, sets: usize) -> Vec<(String, f64)> {
    const COORDINATES: usize = 10;
    let alarms = |set: usize| {
        let mut random = ChaCha12Rng::seed_from_u64(5000 + set as u64);
        let (table, groups, parts) = layout.made(&mut random);
        let count = groups.len();
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        // Coordinates of unequal scatter, and groups that differ as much as their members.
        let common: Vec<f64> = (0..COORDINATES * count).map(|_| normal()).collect();
        let own: Vec<f64> = (0..COORDINATES * count).map(|_| normal()).collect();
        // Changes with age that differ between the groups, and are zero on average.
        let slopes: Vec<f64> = (0..COORDINATES * count).map(|_| normal()).collect();
        let age = |k: usize| match table.attributes.get("age") {
            Some(ModelValues::Numbers(ages)) => ages[k],
            _ => 0.0,
        };
        let value = |i: usize, k: usize| {
            let group = i * count + groups[k];
            (common[group] + age(k) * slopes[group] + parts[k] * own[i * count + k]) / (1.0 + i as f64)
        };
        let vectors = Matrix::from_fn(COORDINATES, count, value);
        let formula = Formula::parse(layout.formula(), TermOrder::ByDegree).unwrap();
        let contrasts = if kind == SumType::III { Contrasts::Sum } else { Contrasts::Treatment };
        let model = Model::new(&formula, &table, contrasts, vectors, vec![1.0; count]).unwrap();
        let testing = Testing { kind, permutations: PERMUTATIONS, seed: set as u64, ..Testing::default() };
        let mut terms = model.anova(&testing, &Unwatched).unwrap().terms;
        // Groups that differ are found.
        terms.retain(|term| !term.term.starts_with('('));
        terms
    };
    let found: Vec<_> = (0..sets).into_par_iter().map(alarms).collect();
    let part =
        |i: usize| found.iter().filter(|terms| terms[i].p.unwrap() <= 0.05).count() as f64 / sets as f64;
    found[0].iter().enumerate().map(|(i, term)| (term.term.clone(), part(i))).collect()
}
