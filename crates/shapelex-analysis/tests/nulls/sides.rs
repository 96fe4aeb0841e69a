//! Null cases of symmetry: faces of one mean shape, and left shapes beside right ones.

use super::{Prepared, ROUGHNESS, around};
use rand::SeedableRng;
use rand::rngs::ChaCha12Rng;
use rayon::prelude::*;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::symmetry::records::{SymmetryKind, SymmetryRecord};
use shapelex_analysis::symmetry::relabelling::Relabelling;
use shapelex_analysis::symmetry::sample::{Sides, SymmetryTesting};
use shapelex_analysis::symmetry::study::{SymmetryQuestion, symmetry};
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::representation::{Representation, ShapeSpace};

/// Exchanges of a test.
const PERMUTATIONS: usize = 199;
/// Individuals: their sides have 512 signs that differ.
const INDIVIDUALS: usize = 10;
/// Landmarks: eight in pairs, two on the midline.
const POINTS: usize = 10;
const PAIRS: [[usize; 2]; 4] = [[0, 1], [2, 3], [4, 5], [6, 7]];

/// A sample of sides without some effects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sided {
    /// Symmetric shapes measured twice, which differ by error alone: no term has an effect.
    ObjectOfError,
    /// The same whose individuals differ, and whose sides differ at random: only the sides on average do not.
    ObjectOfIndividuals,
    /// These measured once: the interaction is not tested.
    ObjectMeasuredOnce,
    /// Left and right shapes measured twice, which differ by error alone.
    MatchingOfError,
    /// The same whose individuals differ, and whose sides differ at random.
    MatchingOfIndividuals,
}

impl Sided {
    pub(crate) const ALL: [Self; 5] = [
        Self::ObjectOfError,
        Self::ObjectOfIndividuals,
        Self::ObjectMeasuredOnce,
        Self::MatchingOfError,
        Self::MatchingOfIndividuals,
    ];

    fn is_object(self) -> bool {
        !matches!(self, Self::MatchingOfError | Self::MatchingOfIndividuals)
    }

    fn measurements(self) -> usize {
        if self == Self::ObjectMeasuredOnce { 1 } else { 2 }
    }

    /// Whether a term has no effect.
    fn is_null(self, term: &str) -> bool {
        matches!(self, Self::ObjectOfError | Self::MatchingOfError) || term == "side"
    }
}

/// Coordinates of a symmetric face, coordinate-major.
fn face() -> Vec<f64> {
    let half = [[1.0, 0.0], [1.5, 1.0], [0.8, 2.0], [0.4, 2.6]];
    let both = half.iter().flat_map(|[x, y]| [[-x, *y], [*x, *y]]);
    let points: Vec<[f64; 2]> = both.chain([[0.0, -0.3], [0.0, 3.0]]).collect();
    let middle = points.iter().map(|point| point[1]).sum::<f64>() / POINTS as f64;
    let size = points.iter().map(|[x, y]| x * x + (y - middle).powi(2)).sum::<f64>().sqrt();
    (0..2)
        .flat_map(|c| points.iter().map(move |p| (p[c] - if c == 1 { middle } else { 0.0 }) / size))
        .collect()
}

/// Parts of the sets in which each term without an effect has p ≤ 0.05, by its name.
pub(crate) fn sided_alarms(case: Sided, sets: usize) -> Vec<(String, f64)> {
    let space = ShapeSpace::new(&Representation::Landmarks { dimension: 2, points: POINTS }).unwrap();
    let metric = Metric::of(&space);
    let prepared = Prepared { space, metric, base: face() };
    let alarms = |set: usize| -> Vec<(String, bool)> {
        let found = record(case, &prepared, set);
        let tested =
            found.table.terms.into_iter().filter(|term| term.row.p.is_some() && case.is_null(&term.row.term));
        tested.map(|term| (term.row.term, term.row.p.unwrap() <= 0.05)).collect()
    };
    let found: Vec<_> = (0..sets).into_par_iter().map(alarms).collect();
    let part = |i: usize| found.iter().filter(|terms| terms[i].1).count() as f64 / sets as f64;
    found[0].iter().enumerate().map(|(i, (term, _))| (term.clone(), part(i))).collect()
}

fn record(case: Sided, prepared: &Prepared, set: usize) -> SymmetryRecord {
    let mut random = ChaCha12Rng::seed_from_u64(9000 + set as u64);
    let relabelling = Relabelling::new(&prepared.space, &PAIRS).unwrap();
    let (mut shapes, mut individual, mut side, mut measured) = (Vec::new(), vec![], vec![], vec![]);
    let (sides, times) = (if case.is_object() { 1 } else { 2 }, case.measurements());
    let error = ROUGHNESS / (2.0 * POINTS as f64).sqrt();
    let spread = |part: f64| if case.is_null("individual") { 0.0 } else { part * error };
    for i in 0..INDIVIDUALS {
        let own = around(&prepared.base, spread(2.0), &mut random);
        for s in 0..sides {
            let own = around(&own, spread(1.0), &mut random);
            for _ in 0..times {
                let shape = prepared.posed(&around(&own, error, &mut random), &mut random);
                individual.push(i);
                side.push(s);
                measured.push(shapes.len());
                shapes.push(shape);
            }
        }
    }
    if case.is_object() {
        for k in 0..shapes.len() {
            let mut image = shapes[k].clone();
            relabelling.image(&mut image);
            shapes.push(image);
            individual.push(individual[k]);
            side.push(1);
            measured.push(k);
        }
    }
    let names: Vec<String> = (0..INDIVIDUALS).map(|i| format!("i{i}")).collect();
    let question = SymmetryQuestion {
        kind: if case.is_object() { SymmetryKind::Object } else { SymmetryKind::Matching },
        sides: Sides {
            names: &names,
            individual: &individual,
            side: &side,
            measured: case.is_object().then_some(&measured[..]),
        },
        relabelling: case.is_object().then_some(&relabelling),
        transformation: &Transformation::Named(ClassName::Similarity),
        testing: SymmetryTesting {
            permutations: PERMUTATIONS,
            seed: set as u64,
            ..SymmetryTesting::default()
        },
        samples: POINTS,
        maps: false,
    };
    prepared.aligned(None, shapes.concat(), |aligned| symmetry(aligned, &question, &Unwatched).unwrap())
}
